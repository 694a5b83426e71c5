/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef NSI_MAIN_H
#define NSI_MAIN_H

__attribute__((noreturn)) void nsi_exit(int exit_code);

#endif
