/* The emulated processor of the stand-in, as its firmware sees it. */
#ifndef PROCESSOR_H
#define PROCESSOR_H

#include <stdint.h>

/* CANRIG_NATIVE_SIM_IRQ is another one. */
enum { TICK_IRQ = 0, TIMER_IRQ = 4 };

/* Runs `function` when the interrupt is raised; in the stand-in each is enabled from the start. */
void processor_connect(unsigned int irq, void (*function)(void));

/* Halts until an interrupt has been served. */
void processor_halt(void);

uint64_t processor_microseconds(void);

/* Raises TIMER_IRQ at a time, not before now. */
void processor_set_timer(uint64_t microseconds);

int firmware_main(void);

#endif
