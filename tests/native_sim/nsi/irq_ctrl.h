/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef IRQ_CTRL_H
#define IRQ_CTRL_H

void hw_irq_ctrl_set_irq(unsigned int irq);

#endif
