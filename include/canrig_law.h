/*
 * A control law in C for canrig: three functions of a shared library, which `[controller.library]` of a scenario names.
 *
 *     cc -O2 -shared -fPIC -o law.so law.c
 *
 * canrig calls them in a process that loads this library alone. C99, and C++ with `extern "C"`.
 */
#ifndef CANRIG_LAW_H
#define CANRIG_LAW_H

#include <stddef.h>
#include <stdint.h>
#include <string.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What the scenario says of the law; it stays where it is while the law plays. */
typedef struct {
    uint32_t           version;          /* 1 */
    uint32_t           reads_count;
    uint32_t           writes_count;
    uint32_t           terms_count;
    uint32_t           parameters_count;
    uint32_t           reserved;
    const char *const *reads;            /* names, in the scenario's order */
    const char *const *writes;
    const char *const *terms;
    const char *const *parameters;       /* names of the parameters */
    const double      *parameter_values; /* each with its value */
    const double      *mins;             /* what the drive of each of `writes` can be commanded, in its unit */
    const double      *maxs;
    double             period_seconds;   /* time between two cycles */
    uint64_t           seed;             /* of the run */
} canrig_law_setup;

/* Bytes of the law's memory, which canrig provides: aligned for any type, and zeroed. */
size_t canrig_law_bytes(const canrig_law_setup *setup);

/* Prepares the memory; 0, or anything else with a text in `why`. */
int canrig_law_init(void *state, const canrig_law_setup *setup, char why[256]);

/*
 * Writes what acts from the next cycle on: a value for each of `writes` and `terms`, in their order; 0, or anything else if the law
 * cannot go on. A position that the cycle did not bring is not a number.
 */
int canrig_law_step(void *state, double time_seconds, double period_seconds, const double *reads, double *writes, double *terms);

/* The value of a parameter; 0, or -1 if there is none of this name. */
static inline int canrig_law_parameter(const canrig_law_setup *setup, const char *name, double *value) {
    for (uint32_t place = 0; place < setup->parameters_count; place++) {
        if (strcmp(setup->parameters[place], name) == 0) {
            *value = setup->parameter_values[place];
            return 0;
        }
    }
    return -1;
}

#ifdef __cplusplus
}
#endif

#endif
