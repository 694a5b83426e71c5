/* The processor of the stand-in on the native simulator itself: its CPU emulation, its interrupt controller, its linker script. */
#include "processor.h"

#include "irq_ctrl.h"
#include "nce_if.h"
#include "nsi_cpu_if.h"
#include "nsi_hws_models_if.h"
#include "nsi_main.h"

enum { IRQS = 32, TICK_MICROSECONDS = 10000 };

static void *emulation;
static void (*handlers[IRQS])(void);
static uint64_t tick_timer = TICK_MICROSECONDS, one_shot_timer = NSI_NEVER;

static void tick_event(void) {
    tick_timer += TICK_MICROSECONDS;
    hw_irq_ctrl_set_irq(TICK_IRQ);
}

static void one_shot_event(void) {
    one_shot_timer = NSI_NEVER;
    hw_irq_ctrl_set_irq(TIMER_IRQ);
}

NSI_HW_EVENT(tick_timer, tick_event, 0);
NSI_HW_EVENT(one_shot_timer, one_shot_event, 1);

void processor_set_timer(uint64_t microseconds) {
    uint64_t now = nsi_hws_get_time();
    one_shot_timer = microseconds < now ? now : microseconds;
    nsi_hws_find_next_event();
}

uint64_t processor_microseconds(void) { return nsi_hws_get_time(); }

void processor_connect(unsigned int irq, void (*function)(void)) {
    handlers[irq] = function;
    hw_irq_ctrl_prio_set(irq, 1);
    hw_irq_ctrl_enable_irq(irq);
}

static void serve(void) {
    for (int irq = hw_irq_ctrl_get_highest_prio_irq(); irq >= 0; irq = hw_irq_ctrl_get_highest_prio_irq()) {
        hw_irq_ctrl_clear_irq((unsigned int)irq);
        if (handlers[irq]) handlers[irq]();
    }
}

void processor_halt(void) {
    nce_halt_cpu(emulation);
    serve();
}

static void boot(void) {
    int code = firmware_main();
    if (code) nsi_exit(code);
    for (;;) processor_halt();
}

void nsif_cpu0_boot(void) {
    emulation = nce_init();
    nce_boot_cpu(emulation, boot);
}

int nsif_cpu0_cleanup(void) {
    nce_terminate(emulation);
    return 0;
}

void nsif_cpu0_irq_raised(void) { nce_wake_cpu(emulation); }

void nsif_cpu0_irq_raised_from_sw(void) { serve(); }
