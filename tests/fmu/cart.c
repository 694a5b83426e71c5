/* The library of an FMU of FMI 2.0: a current pulls a cart against a spring. `mode` says how it misbehaves from `from_seconds` on. It
 * needs no header: the tests in Rust build it with the C compiler that links them. */
#define _DEFAULT_SOURCE
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <unistd.h>

enum { CURRENT = 1, POSITION, SPEED, MASS, MODE, FROM, COUNT };
enum { PLAIN, DISCARDS, HANGS, CRASHES, NOT_A_NUMBER, EXITS, TERMINATES, FAILS, STOPS, IS_SLOW };
enum { OK, WARNING, DISCARD, ERROR };

typedef struct {
    double values[COUNT], time;
    int is_terminated;
} Model;

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *resources, const void *functions, int visible, int logging) {
    (void)name, (void)type, (void)guid, (void)resources, (void)functions, (void)visible, (void)logging;
    Model *model = calloc(1, sizeof *model);
    model->values[MASS] = 2.4;
    model->values[FROM] = 1.0;
    return model;
}

void fmi2FreeInstance(void *model) { free(model); }
int fmi2SetupExperiment(void *model, int has_tolerance, double tolerance, double start, int has_stop, double stop) {
    (void)model, (void)has_tolerance, (void)tolerance, (void)start, (void)has_stop, (void)stop;
    return OK;
}
int fmi2EnterInitializationMode(void *model) { return (void)model, OK; }
int fmi2ExitInitializationMode(void *model) { return (void)model, OK; }
int fmi2Terminate(void *model) { return (void)model, OK; }

int fmi2GetReal(void *instance, const unsigned references[], size_t count, double values[]) {
    Model *model = instance;
    for (size_t i = 0; i < count; i++) values[i] = references[i] ? model->values[references[i]] : model->time;
    return OK;
}

int fmi2SetReal(void *instance, const unsigned references[], size_t count, const double values[]) {
    Model *model = instance;
    for (size_t i = 0; i < count; i++) model->values[references[i]] = values[i];
    return OK;
}

int fmi2GetRealStatus(void *instance, int kind, double *value) {
    (void)kind;
    *value = ((Model *)instance)->time;
    return OK;
}

int fmi2GetBooleanStatus(void *instance, int kind, int *value) {
    (void)kind;
    *value = ((Model *)instance)->is_terminated;
    return OK;
}

int fmi2DoStep(void *instance, double time, double duration, int no_set) {
    (void)no_set;
    Model *model = instance;
    double *v = model->values;
    model->time = time;
    if (time + duration > v[FROM]) {
        switch ((int)v[MODE]) {
        case DISCARDS:
            if (duration > 0.0003) return DISCARD;
            break;
        case HANGS:
            for (;;) sleep(1);
        case CRASHES:
            *(volatile int *)0 = 1;
            break;
        case NOT_A_NUMBER:
            v[SPEED] = 0.0 / 0.0;
            break;
        case EXITS:
            fputs("no licence\n", stderr);
            exit(3);
        case TERMINATES:
            model->is_terminated = 1;
            return DISCARD;
        case FAILS:
            return ERROR;
        case STOPS:
            raise(SIGSTOP);
            break;
        case IS_SLOW:
            usleep(30000);
            break;
        }
    }
    int steps = (int)(duration / 1e-4) + 1;
    for (int i = 0; i < steps; i++) {
        double h = duration / steps;
        v[SPEED] += h * (32.4 * v[CURRENT] - 0.82 * v[SPEED] - 300.0 * v[POSITION]) / v[MASS];
        v[POSITION] += h * v[SPEED];
    }
    model->time = time + duration;
    return OK;
}
