/* A PID on the position error, with the derivative on the measurement and conditional integration.
 *
 *     cc -O2 -shared -fPIC -I include -o pid.so pid.c -lm
 */
#include <math.h>
#include <stdio.h>

#include "canrig_law.h"

enum { PROPORTIONAL, INTEGRAL, DERIVATIVE, WEIGHT, POLE, GAINS };
static const char *const names[GAINS] = {
    "proportional_amperes_per_metre", "integral_amperes_per_metre_second", "derivative_ampere_seconds_per_metre",
    "set_point_weight", "derivative_filter_radians_per_second",
};

typedef struct {
    double gains[GAINS], low, high, integral_amperes, position, filtered;
    int    has_started;
} pid;

size_t canrig_law_bytes(const canrig_law_setup *setup) {
    (void)setup;
    return sizeof(pid);
}

int canrig_law_init(void *state, const canrig_law_setup *setup, char why[256]) {
    pid *law = state;
    for (int gain = 0; gain < GAINS; gain++) {
        if (canrig_law_parameter(setup, names[gain], &law->gains[gain])) {
            snprintf(why, 256, "the parameter %s is missing", names[gain]);
            return 1;
        }
    }
    law->low = setup->mins[0];
    law->high = setup->maxs[0];
    return 0;
}

/* Reads position_metres and set_point_metres, writes the command, and integral_amperes as a term. */
int canrig_law_step(void *state, double time_seconds, double period_seconds, const double *reads, double *writes, double *terms) {
    (void)time_seconds;
    pid          *law = state;
    const double *gains = law->gains;
    if (isfinite(reads[0])) law->position = reads[0];
    if (!law->has_started) law->filtered = law->position;
    law->has_started = 1;
    double moved = (1.0 - exp(-gains[POLE] * period_seconds)) * (law->position - law->filtered);
    law->filtered += moved;
    double weighted = gains[WEIGHT] * reads[1];
    double current = gains[PROPORTIONAL] * (weighted - law->position) + law->integral_amperes - gains[DERIVATIVE] * (moved / period_seconds);
    double error = reads[1] - law->position;
    int    winds_up = (current >= law->high && error > 0.0) || (current <= law->low && error < 0.0);
    if (!winds_up) law->integral_amperes += gains[INTEGRAL] * error * period_seconds;
    writes[0] = current;
    terms[0] = law->integral_amperes;
    return 0;
}
