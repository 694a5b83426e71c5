/*
 * A stand-in of the native simulator: its scheduler of hardware events, an interrupt controller, a tick, a timer, and a processor that
 * is a thread. As there, either the thread of the hardware runs or that of the processor, and time passes while the processor is halted.
 */
#include "irq_ctrl.h"
#include "nsi_hws_models_if.h"
#include "nsi_main.h"
#include "nsi_tasks.h"
#include "nsi_tracing.h"
#include "processor.h"

#include <pthread.h>
#include <semaphore.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

enum { IRQS = 32, EVENTS = 5, TICK_MICROSECONDS = 10000, IDLE_MICROSECONDS = 137 };

static struct {
    uint64_t *timer;
    void (*function)(void);
    int priority;
} events[EVENTS];
static size_t   count, next;
static uint64_t now;
static void (*hw_init)(void);

/* Keeps them by their priority. */
void nsi_add_event(uint64_t *timer, void (*function)(void), int priority) {
    if (count == EVENTS) nsi_print_error_and_exit("more than %d events\n", EVENTS);
    size_t at = count++;
    for (; at > 0 && events[at - 1].priority > priority; at--) events[at] = events[at - 1];
    events[at].timer = timer;
    events[at].function = function;
    events[at].priority = priority;
}

void nsi_add_hw_init(void (*function)(void)) { hw_init = function; }

uint64_t nsi_hws_get_time(void) { return now; }

uint64_t nsi_hws_get_next_event_time(void) { return *events[next].timer; }

void nsi_hws_find_next_event(void) {
    next = 0;
    for (size_t i = 1; i < count; i++)
        if (*events[i].timer < *events[next].timer) next = i;
}

void nsi_exit(int exit_code) { exit(exit_code); }

void nsi_print_warning(const char *format, ...) {
    va_list words;
    va_start(words, format);
    vfprintf(stderr, format, words);
    va_end(words);
}

void nsi_print_error_and_exit(const char *format, ...) {
    va_list words;
    va_start(words, format);
    vfprintf(stderr, format, words);
    va_end(words);
    nsi_exit(1);
}

/* The processor, and its interrupts. */

static sem_t    hardware_may_go_on, processor_may_go_on;
static uint64_t irq_timer = NSI_NEVER;
static uint32_t raised;
static void (*handlers[IRQS])(void);

static void wait_for(sem_t *semaphore) {
    while (sem_wait(semaphore)) {}
}

static void wake_processor(void) {
    sem_post(&processor_may_go_on);
    wait_for(&hardware_may_go_on);
}

static void *run_processor(void *unused) {
    (void)unused;
    wait_for(&processor_may_go_on);
    int code = firmware_main();
    if (code) nsi_print_error_and_exit("the firmware ended in %d\n", code);
    for (;;) processor_halt();
}

void processor_connect(unsigned int irq, void (*function)(void)) { handlers[irq] = function; }

uint64_t processor_microseconds(void) { return now; }

void processor_halt(void) {
    sem_post(&hardware_may_go_on);
    wait_for(&processor_may_go_on);
    for (unsigned int irq = 0; irq < IRQS; irq++) {
        if (!(raised & 1u << irq)) continue;
        raised &= ~(1u << irq);
        if (handlers[irq]) handlers[irq]();
    }
}

/* Wakes the processor in this microsecond, when the event that raised it has returned. */
void hw_irq_ctrl_set_irq(unsigned int irq) {
    raised |= 1u << irq;
    irq_timer = now;
    nsi_hws_find_next_event();
}

static void irq_event(void) {
    irq_timer = NSI_NEVER;
    wake_processor();
    nsi_hws_find_next_event();
}

NSI_HW_EVENT(irq_timer, irq_event, 900);

/* The tick of a kernel, a timer, and an event that nobody hears. */

static uint64_t tick_timer = TICK_MICROSECONDS, one_shot_timer = NSI_NEVER, idle_timer;

static void tick_event(void) {
    tick_timer += TICK_MICROSECONDS;
    hw_irq_ctrl_set_irq(TICK_IRQ);
}

static void one_shot_event(void) {
    one_shot_timer = NSI_NEVER;
    hw_irq_ctrl_set_irq(TIMER_IRQ);
}

static void idle_event(void) { idle_timer += IDLE_MICROSECONDS; }

NSI_HW_EVENT(tick_timer, tick_event, 0);
NSI_HW_EVENT(one_shot_timer, one_shot_event, 1);
NSI_HW_EVENT(idle_timer, idle_event, 100);

void processor_set_timer(uint64_t microseconds) {
    one_shot_timer = microseconds < now ? now : microseconds;
    nsi_hws_find_next_event();
}

int main(void) {
    pthread_t thread;
    if (hw_init) hw_init();
    nsi_hws_find_next_event();
    if (sem_init(&hardware_may_go_on, 0, 0) || sem_init(&processor_may_go_on, 0, 0) || pthread_create(&thread, NULL, run_processor, NULL))
        nsi_print_error_and_exit("no thread for the processor\n");
    wake_processor();
    for (;;) {
        if (*events[next].timer < now) nsi_print_error_and_exit("an event lies in the past\n");
        now = *events[next].timer;
        events[next].function();
        nsi_hws_find_next_event();
    }
}
