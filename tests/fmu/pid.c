/* The library of an FMU of FMI 2.0 and of FMI 3.0: the PID in C of the book as a controller. It needs no header of FMI. */
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>

#include "../../docs/examples/pid.c"

enum { POSITION = 1, SET_POINT, CURRENT, SUM, FIRST_GAIN, LOW = FIRST_GAIN + GAINS, HIGH, COUNT };

typedef struct {
    double values[COUNT], time;
    pid    law;
} model;

static void *made(void) { return calloc(1, sizeof(model)); }

static int begin(model *it) {
    for (int gain = 0; gain < GAINS; gain++) it->law.gains[gain] = it->values[FIRST_GAIN + gain];
    it->law.low = it->values[LOW];
    it->law.high = it->values[HIGH];
    return 0;
}

static int step(model *it, double time, double duration) {
    double reads[] = {it->values[POSITION], it->values[SET_POINT]};
    it->time = time + duration;
    return canrig_law_step(&it->law, time, duration, reads, &it->values[CURRENT], &it->values[SUM]);
}

static int get(model *it, const unsigned references[], size_t count, double values[]) {
    for (size_t i = 0; i < count; i++) values[i] = references[i] ? it->values[references[i]] : it->time;
    return 0;
}

static int set(model *it, const unsigned references[], size_t count, const double values[]) {
    for (size_t i = 0; i < count; i++) it->values[references[i]] = values[i];
    return 0;
}

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *functions, int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    return made();
}
void fmi2FreeInstance(void *it) { free(it); }
int  fmi2SetupExperiment(void *it, int has_tolerance, double tolerance, double start, int has_stop, double stop) {
    (void)it, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return 0;
}
int fmi2EnterInitializationMode(void *it) { return (void)it, 0; }
int fmi2ExitInitializationMode(void *it) { return begin(it); }
int fmi2Terminate(void *it) { return (void)it, 0; }
int fmi2GetReal(void *it, const unsigned references[], size_t count, double values[]) { return get(it, references, count, values); }
int fmi2SetReal(void *it, const unsigned references[], size_t count, const double values[]) { return set(it, references, count, values); }
int fmi2DoStep(void *it, double time, double duration, int no_set) { return (void)no_set, step(it, time, duration); }

void *fmi3InstantiateCoSimulation(const char *name, const char *token, const char *resources, bool visible, bool logging, bool events,
                                  bool early, const uint32_t *required, size_t count, const void *environment, const void *log,
                                  const void *update) {
    (void)name, (void)token, (void)resources, (void)visible, (void)logging, (void)events, (void)early, (void)required, (void)count;
    (void)environment, (void)log, (void)update;
    return made();
}
void fmi3FreeInstance(void *it) { free(it); }
int  fmi3EnterInitializationMode(void *it, bool has_tolerance, double tolerance, double start, bool has_stop, double stop) {
    (void)it, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return 0;
}
int fmi3ExitInitializationMode(void *it) { return begin(it); }
int fmi3Terminate(void *it) { return (void)it, 0; }
int fmi3EnterEventMode(void *it) { return (void)it, 0; }
int fmi3EnterStepMode(void *it) { return (void)it, 0; }
int fmi3UpdateDiscreteStates(void *it, bool *again, bool *ended, bool *nominals, bool *values, bool *has_next, double *next) {
    (void)it;
    *again = *ended = *nominals = *values = *has_next = false;
    *next = 0.0;
    return 0;
}
int fmi3GetFloat64(void *it, const uint32_t references[], size_t count, double values[], size_t room) {
    return (void)room, get(it, references, count, values);
}
int fmi3SetFloat64(void *it, const uint32_t references[], size_t count, const double values[], size_t room) {
    return (void)room, set(it, references, count, values);
}
int fmi3DoStep(void *it, double time, double duration, bool no_set, bool *events, bool *ended, bool *early, double *reached) {
    (void)no_set;
    *events = *ended = *early = false;
    *reached = time + duration;
    return step(it, time, duration);
}
