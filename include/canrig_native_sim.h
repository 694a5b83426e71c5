/*
 * canrig's bus for a program of Zephyr on native_sim, in virtual time: what a CAN driver calls. `canrig_native_sim.c` is the other
 * side, in the runner of the native simulator. This header needs nothing from the host, as code on the emulated processor does.
 * The book has the page ("Zephyr on native_sim").
 */
#ifndef CANRIG_NATIVE_SIM_H
#define CANRIG_NATIVE_SIM_H

#include <stdint.h>

/* The interrupt that is raised when a frame has arrived, and when the run is to end. */
#ifndef CANRIG_NATIVE_SIM_IRQ
#define CANRIG_NATIVE_SIM_IRQ 3
#endif

/* In `id`, as in the kernel's frames. */
#define CANRIG_NATIVE_SIM_EXTENDED 0x80000000u
#define CANRIG_NATIVE_SIM_REMOTE 0x40000000u

typedef struct {
    uint32_t id;
    uint8_t  length, data[8];
} canrig_native_sim_frame;

/* Queues a frame, which is sent before time goes on: 0, 1 if there is no room until then, or -1 for a frame that CAN does not have. */
int canrig_native_sim_send(const canrig_native_sim_frame *frame);

/* Takes the earliest frame that has arrived: 1, or 0 if there is none. */
int canrig_native_sim_receive(canrig_native_sim_frame *frame);

/* Frames that arrived and were lost, because nobody had taken those before. */
uint32_t canrig_native_sim_lost(void);

/* 1 as soon as the run is to end: bring the outputs to a safe state, then leave. 0.4 s are left for that. */
int canrig_native_sim_is_stopping(void);

/* Leaves the bus and ends the program, with what was queued before, as soon as the processor halts. */
void canrig_native_sim_leave(void);

#endif
