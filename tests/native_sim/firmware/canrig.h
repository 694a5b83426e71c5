/*
 * The calls of canrig.h for a program that runs on the emulated processor, where it has a CAN driver's side of the bus and a timer:
 * the controller that `canrig new controller` writes is a firmware with it, without a change.
 */
#ifndef CANRIG_H
#define CANRIG_H

#include "canrig_native_sim.h"
#include "processor.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

typedef struct {
    uint64_t time_ns;
    uint32_t id;
    uint8_t  length, flags;
    uint16_t reserved;
    uint8_t  data[64];
} canrig_frame;

typedef struct {
    uint32_t id, mask;
} canrig_filter;

#define CANRIG_EXACT(identifier) {(identifier), 0xC00007FFu}

typedef struct {
    const char          *name;
    const canrig_filter *filters;
    size_t               filters_count;
    const canrig_filter *silent;
    size_t               silent_count;
    unsigned             flags;
} canrig_options;

enum { CANRIG_STOP = 2, CANRIG_END };
#define CANRIG_NEVER UINT64_MAX

typedef struct {
    canrig_options options;
    canrig_filter  filters[8];
    int            has_stopped;
} canrig;

/* A frame that arrives, the timer and a tick wake the processor, and that is all that they do. */
static void canrig_woken_(void) {}

static int canrig_open(canrig *bus, const char *address, const canrig_options *options) {
    (void)address;
    if (options->filters_count > 8) return -22;
    bus->options = *options;
    memcpy(bus->filters, options->filters, options->filters_count * sizeof *options->filters);
    processor_connect(CANRIG_NATIVE_SIM_IRQ, canrig_woken_);
    processor_connect(TIMER_IRQ, canrig_woken_);
    processor_connect(TICK_IRQ, canrig_woken_);
    return 0;
}

static uint64_t canrig_now(const canrig *bus) { return (void)bus, 1000 * processor_microseconds(); }

static int canrig_accepts_(const canrig *bus, uint32_t id) {
    for (size_t i = 0; i < bus->options.filters_count; i++)
        if ((id & bus->filters[i].mask) == (bus->filters[i].id & bus->filters[i].mask)) return 1;
    return 0;
}

static int canrig_wait(canrig *bus, canrig_frame *frame, uint64_t until_ns) {
    canrig_native_sim_frame arrived;
    for (;;) {
        while (canrig_native_sim_receive(&arrived)) {
            if (!canrig_accepts_(bus, arrived.id)) continue;
            memset(frame, 0, sizeof *frame);
            frame->time_ns = canrig_now(bus);
            frame->id = arrived.id;
            frame->length = arrived.length;
            memcpy(frame->data, arrived.data, sizeof arrived.data);
            return 1;
        }
        if (canrig_native_sim_lost()) return fprintf(stderr, "firmware: frames are lost\n"), -5;
        if (canrig_native_sim_is_stopping() && !bus->has_stopped) return bus->has_stopped = 1, CANRIG_STOP;
        if (canrig_now(bus) >= until_ns) return 0;
        if (until_ns != CANRIG_NEVER) processor_set_timer((until_ns + 999) / 1000);
        processor_halt();
    }
}

static int canrig_send(canrig *bus, const canrig_frame *frame) {
    canrig_native_sim_frame out = {frame->id, frame->length, {0}};
    (void)bus;
    memcpy(out.data, frame->data, sizeof out.data);
    return canrig_native_sim_send(&out);
}

static void canrig_close(canrig *bus) {
    (void)bus;
    canrig_native_sim_leave();
}

#endif
