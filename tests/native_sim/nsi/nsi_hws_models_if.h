/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef NSI_HWS_MODELS_IF_H
#define NSI_HWS_MODELS_IF_H

#include "nsi_hw_scheduler.h"

void nsi_add_event(uint64_t *timer, void (*function)(void), int priority);

#define NSI_HW_EVENT(timer, function, priority) \
    __attribute__((constructor)) static void nsi_add_##function(void) { nsi_add_event(&timer, function, priority); } \
    struct nsi_semicolon

#endif
