/*
 * canrig's bus in the runner of the native simulator. An event of its hardware scheduler, the last of its microsecond, waits on the
 * bus until the scheduler's next event while all processors are halted. A frame that arrives before moves the event to its time,
 * where it raises an interrupt. In real time (`embedded:/path`, `can0`) the same wait lets the simulation follow the clock.
 *
 *     target_sources(native_simulator INTERFACE canrig_native_sim.c)
 *
 * C99, no allocation. CANRIG_NATIVE_SIM_FILTERS are the frames that arrive, all of them without it.
 */
#include "canrig.h"

#include "canrig_native_sim.h"
#include "irq_ctrl.h"
#include "nsi_hws_models_if.h"
#include "nsi_main.h"
#include "nsi_tasks.h"
#include "nsi_tracing.h"

#ifndef CANRIG_NATIVE_SIM_FILTERS
#define CANRIG_NATIVE_SIM_FILTERS {0, 0}
#endif

enum { RING = 256, STOP_MICROSECONDS = 400000, RETRY_MICROSECONDS = 100 };

typedef struct {
    canrig_native_sim_frame frames[RING];
    unsigned                first, count;
} ring;

static canrig   bus;
static ring     arrived, queued;
static uint64_t timer;   /* of the event, in microseconds of the simulator */
static uint64_t zero_ns; /* time of the bus at time 0 of the simulator */
static uint64_t stop_by = NSI_NEVER;
static uint32_t lost;
static int      is_virtual, is_news, is_stopping, is_leaving;

static int push(ring *into, const canrig_native_sim_frame *frame) {
    if (into->count == RING) return 0;
    into->frames[(into->first + into->count++) % RING] = *frame;
    return 1;
}

static int pop(ring *from, canrig_native_sim_frame *frame) {
    if (!from->count) return 0;
    *frame = from->frames[from->first];
    from->first = (from->first + 1) % RING;
    from->count--;
    return 1;
}

static uint64_t bus_time(uint64_t microseconds) { return microseconds == NSI_NEVER ? CANRIG_NEVER : zero_ns + 1000 * microseconds; }

/* The first microsecond of the simulator in which everything has happened that the bus has seen. */
static uint64_t reached(void) { return (canrig_now(&bus) - zero_ns + 999) / 1000; }

static void set_timer(uint64_t microseconds) {
    timer = microseconds;
    nsi_hws_find_next_event();
}

/* Waits on the bus, and keeps what comes. */
static void wait_until(uint64_t microseconds) {
    canrig_frame            frame;
    canrig_native_sim_frame kept;
    int                     came = canrig_wait(&bus, &frame, bus_time(microseconds));
    /* A fault has halted the node, and the time of the simulator with it. */
    if (is_virtual && canrig_now(&bus) > bus_time(microseconds)) zero_ns = canrig_now(&bus) - 1000 * microseconds;
    if (came < 0) nsi_print_error_and_exit("canrig: the bus: %s\n", strerror(-came));
    if (came == CANRIG_END && !is_stopping) nsi_print_error_and_exit("canrig: the bus is gone\n");
    if (came == CANRIG_END) nsi_exit(0);
    if (came == CANRIG_STOP) {
        is_stopping = 1;
        stop_by = reached() + STOP_MICROSECONDS;
    }
    if (came == 1) {
        kept.id = frame.id;
        kept.length = frame.length;
        memcpy(kept.data, frame.data, sizeof kept.data);
        if (!push(&arrived, &kept) && !lost++) nsi_print_warning("canrig: frames are lost: %d wait, and nobody takes them\n", RING);
    }
    if (came) is_news = 1;
}

static void send_queued(void) {
    canrig_native_sim_frame frame;
    while (queued.count) {
        canrig_frame out = {0};
        frame = queued.frames[queued.first];
        out.id = frame.id;
        out.length = frame.length;
        memcpy(out.data, frame.data, sizeof frame.data);
        int sent = canrig_send(&bus, &out);
        if (sent == CANRIG_FULL) return;
        if (sent < 0) nsi_print_error_and_exit("canrig: sending 0x%X: %s\n", (unsigned)frame.id, strerror(-sent));
        pop(&queued, &frame);
    }
}

static void canrig_native_sim_event(void) {
    uint64_t now = nsi_hws_get_time(), next;
    while (canrig_now(&bus) < bus_time(now)) wait_until(now);
    send_queued();
    if (is_leaving || now >= stop_by) {
        canrig_close(&bus);
        nsi_exit(0);
    }
    if (is_news) {
        /* The processors first: here again when they have halted. */
        is_news = 0;
        timer = now;
        hw_irq_ctrl_set_irq(CANRIG_NATIVE_SIM_IRQ);
        nsi_hws_find_next_event();
        return;
    }
    set_timer(queued.count ? now + RETRY_MICROSECONDS : stop_by);
    next = nsi_hws_get_next_event_time();
    wait_until(next);
    set_timer(reached() > now ? reached() : now);
}

NSI_HW_EVENT(timer, canrig_native_sim_event, 999);

static void canrig_native_sim_open(void) {
    static const canrig_filter filters[] = {CANRIG_NATIVE_SIM_FILTERS};
    canrig_options             options = {"native_sim", filters, sizeof filters / sizeof *filters, NULL, 0, 0};
    const char                *address = getenv("CANRIG_BUS");
    if (!address) nsi_print_error_and_exit("canrig: CANRIG_BUS is not set; start this program by `canrig simulate SCENARIO -- PROGRAM`\n");
    int error = canrig_open(&bus, address, &options);
    if (error) nsi_print_error_and_exit("canrig: the bus \"%s\": %s\n", address, strerror(-error));
    is_virtual = !strncmp(address, "lockstep:", 9);
    zero_ns = canrig_now(&bus);
}

NSI_TASK(canrig_native_sim_open, HW_INIT, 100);

/* What follows is called from the emulated processor, while the thread of the hardware waits. */

int canrig_native_sim_send(const canrig_native_sim_frame *frame) {
    if (frame->length > 8 || frame->id & CAN_ERR_FLAG || (!(frame->id & CAN_EFF_FLAG) && (frame->id & CAN_EFF_MASK) > CAN_SFF_MASK)) return -1;
    if (!push(&queued, frame)) return 1;
    set_timer(nsi_hws_get_time());
    return 0;
}

int canrig_native_sim_receive(canrig_native_sim_frame *frame) { return pop(&arrived, frame); }

uint32_t canrig_native_sim_lost(void) { return lost; }

int canrig_native_sim_is_stopping(void) { return is_stopping; }

void canrig_native_sim_leave(void) {
    is_leaving = 1;
    set_timer(nsi_hws_get_time());
}
