/* A stand-in of the native simulator's header: what canrig_native_sim.c uses of it. */
#ifndef NSI_TRACING_H
#define NSI_TRACING_H

__attribute__((noreturn, format(printf, 1, 2))) void nsi_print_error_and_exit(const char *format, ...);
__attribute__((format(printf, 1, 2))) void nsi_print_warning(const char *format, ...);

#endif
