/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef NSI_TASKS_H
#define NSI_TASKS_H

void nsi_add_hw_init(void (*function)(void));

/* Of the levels there is HW_INIT only. */
#define NSI_TASK(function, level, priority) NSI_TASK_##level(function)
#define NSI_TASK_HW_INIT(function) \
    __attribute__((constructor)) static void nsi_add_##function(void) { nsi_add_hw_init(function); } \
    struct nsi_semicolon

#endif
