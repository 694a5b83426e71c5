/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef NSI_HW_SCHEDULER_H
#define NSI_HW_SCHEDULER_H

#include <stdint.h>

#define NSI_NEVER UINT64_MAX

uint64_t nsi_hws_get_time(void);
uint64_t nsi_hws_get_next_event_time(void);
void     nsi_hws_find_next_event(void);

#endif
