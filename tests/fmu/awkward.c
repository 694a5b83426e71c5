/* An FMU of FMI 3.0 that does what FMUs may do, and what they must not: `y` is the integral of `u`, and `mode` says how it
 * misbehaves from 50 ms on. Built against the headers of FMPy, which looks for every function of FMI. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "fmi3FunctionTypes.h"

enum { U = 1, Y = 2, MODE = 3, COUNT = 4, VALVE = 5 };
enum { PLAIN, DISCARDS, EVENTS, HANGS, CRASHES, NOT_A_NUMBER, EXITS, TERMINATES, FAILS, REFUSES };

static const double FROM = 0.05, PERIOD = 0.0105;

typedef struct {
    double u, y, time, next_event;
    int mode, count, valve, events;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Model;

const char *fmi3GetVersion(void) { return "3.0"; }

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String resources, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t count, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    (void)name, (void)resources, (void)visible, (void)logging, (void)early, (void)required, (void)count, (void)update;
    if (strcmp(token, "awkward") != 0) {
        log(environment, fmi3Error, "error", "another FMU's token");
        return NULL;
    }
    Model *model = calloc(1, sizeof *model);
    model->events = events;
    model->next_event = PERIOD;
    model->environment = environment;
    model->log = log;
    return model;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean has_tolerance, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean has_stop, fmi3Float64 stop) {
    (void)has_tolerance, (void)tolerance, (void)has_stop, (void)stop;
    Model *model = instance;
    model->time = start;
    if (model->mode == REFUSES) {
        model->log(model->environment, fmi3Error, "error", "the mode is one that refuses");
        return fmi3Error;
    }
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance) { return (void)instance, fmi3OK; }
fmi3Status fmi3EnterEventMode(fmi3Instance instance) { return (void)instance, fmi3OK; }
fmi3Status fmi3EnterStepMode(fmi3Instance instance) { return (void)instance, fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance instance) { return (void)instance, fmi3OK; }
fmi3Status fmi3Reset(fmi3Instance instance) { return (void)instance, fmi3Error; }

/* In mode EVENTS each event takes away half of what was integrated. */
fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *again, fmi3Boolean *terminate, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *has_next, fmi3Float64 *next) {
    Model *model = instance;
    *again = *terminate = *nominals = *values = fmi3False;
    if (model->mode == EVENTS && model->time >= model->next_event - 1e-12) {
        model->y *= 0.5;
        model->count += 1;
        model->next_event += PERIOD;
    }
    *has_next = model->mode == EVENTS;
    *next = model->next_event;
    return fmi3OK;
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 time, fmi3Float64 duration, fmi3Boolean no_set, fmi3Boolean *event,
                      fmi3Boolean *terminate, fmi3Boolean *early, fmi3Float64 *last) {
    (void)no_set;
    Model *model = instance;
    *event = *terminate = *early = fmi3False;
    *last = time;
    if (time + duration > FROM) {
        switch (model->mode) {
        case HANGS:
            for (;;) sleep(1);
        case CRASHES:
            *(volatile int *)0 = 1;
            break;
        case EXITS:
            if (write(2, "no licence\n", 11)) exit(3);
            exit(3);
        case TERMINATES:
            *terminate = fmi3True;
            return fmi3OK;
        case FAILS:
            model->log(model->environment, fmi3Error, "error", "the solver did not converge");
            return fmi3Error;
        }
    }
    if (model->mode == DISCARDS && duration > 0.0003) return fmi3Discard;
    double end = time + duration;
    if (model->mode == EVENTS && model->events && model->next_event < end - 1e-12) {
        end = model->next_event;
        *early = fmi3True;
    }
    *event = model->mode == EVENTS && model->events && end >= model->next_event - 1e-12;
    model->y += (model->u + model->valve) * (end - time);
    if (model->mode == NOT_A_NUMBER && end > FROM) model->y = NAN;
    model->time = *last = end;
    return fmi3OK;
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[], size_t m) {
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (references[i] != U) return fmi3Error;
        ((Model *)instance)->u = values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Float64 values[], size_t m) {
    (void)m;
    Model *model = instance;
    for (size_t i = 0; i < n; i++) {
        if (references[i] == 0) values[i] = model->time;
        else if (references[i] == U) values[i] = model->u;
        else if (references[i] == Y) values[i] = model->y;
        else return fmi3Error;
    }
    return fmi3OK;
}

fmi3Status fmi3SetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n, const fmi3Int32 values[], size_t m) {
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (references[i] != MODE) return fmi3Error;
        ((Model *)instance)->mode = values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetInt32(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Int32 values[], size_t m) {
    (void)m;
    Model *model = instance;
    for (size_t i = 0; i < n; i++) {
        if (references[i] == MODE) values[i] = model->mode;
        else if (references[i] == COUNT) values[i] = model->count;
        else return fmi3Error;
    }
    return fmi3OK;
}

fmi3Status fmi3SetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t n, const fmi3Boolean values[], size_t m) {
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (references[i] != VALVE) return fmi3Error;
        ((Model *)instance)->valve = values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference references[], size_t n, fmi3Boolean values[], size_t m) {
    (void)m;
    for (size_t i = 0; i < n; i++) {
        if (references[i] != VALVE) return fmi3Error;
        values[i] = ((Model *)instance)->valve;
    }
    return fmi3OK;
}

#define NOT_SERVED(name) fmi3Status fmi3##name(void) { return fmi3Error; }
NOT_SERVED(ActivateModelPartition)
NOT_SERVED(CompletedIntegratorStep)
NOT_SERVED(DeserializeFMUState)
NOT_SERVED(EnterConfigurationMode)
NOT_SERVED(EnterContinuousTimeMode)
NOT_SERVED(EvaluateDiscreteStates)
NOT_SERVED(ExitConfigurationMode)
NOT_SERVED(FreeFMUState)
NOT_SERVED(GetAdjointDerivative)
NOT_SERVED(GetBinary)
NOT_SERVED(GetClock)
NOT_SERVED(GetContinuousStateDerivatives)
NOT_SERVED(GetContinuousStates)
NOT_SERVED(GetDirectionalDerivative)
NOT_SERVED(GetEventIndicators)
NOT_SERVED(GetFMUState)
NOT_SERVED(GetFloat32)
NOT_SERVED(GetInt16)
NOT_SERVED(GetInt64)
NOT_SERVED(GetInt8)
NOT_SERVED(GetIntervalDecimal)
NOT_SERVED(GetIntervalFraction)
NOT_SERVED(GetNominalsOfContinuousStates)
NOT_SERVED(GetNumberOfContinuousStates)
NOT_SERVED(GetNumberOfEventIndicators)
NOT_SERVED(GetNumberOfVariableDependencies)
NOT_SERVED(GetOutputDerivatives)
NOT_SERVED(GetShiftDecimal)
NOT_SERVED(GetShiftFraction)
NOT_SERVED(GetString)
NOT_SERVED(GetUInt16)
NOT_SERVED(GetUInt32)
NOT_SERVED(GetUInt64)
NOT_SERVED(GetUInt8)
NOT_SERVED(GetVariableDependencies)
NOT_SERVED(InstantiateModelExchange)
NOT_SERVED(InstantiateScheduledExecution)
NOT_SERVED(SerializeFMUState)
NOT_SERVED(SerializedFMUStateSize)
NOT_SERVED(SetBinary)
NOT_SERVED(SetClock)
NOT_SERVED(SetContinuousStates)
NOT_SERVED(SetDebugLogging)
NOT_SERVED(SetFMUState)
NOT_SERVED(SetFloat32)
NOT_SERVED(SetInt16)
NOT_SERVED(SetInt64)
NOT_SERVED(SetInt8)
NOT_SERVED(SetIntervalDecimal)
NOT_SERVED(SetIntervalFraction)
NOT_SERVED(SetShiftDecimal)
NOT_SERVED(SetShiftFraction)
NOT_SERVED(SetString)
NOT_SERVED(SetTime)
NOT_SERVED(SetUInt16)
NOT_SERVED(SetUInt32)
NOT_SERVED(SetUInt64)
NOT_SERVED(SetUInt8)
