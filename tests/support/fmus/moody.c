/* An FMU (FMI 2.0, co-simulation) that misbehaves on request, to test how importers take it. */
#include <stdio.h>
#include <stdlib.h>
#include "fmi2Functions.h"

enum { INPUT, OUTPUT, STUBBORN, NUMBERS };                       /* value references of reals */
enum { STEP, SETUP, ENTER, EXIT, GET, SET, RESET, SAVE, STATUSES }; /* value references of integers: status returned by */

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    fmi2Real number[NUMBERS];
    fmi2Integer status[STATUSES];
    fmi2Boolean terminated;
    int fatal;
} Moody;

int calls_after_fatal = 0;
int instances = 0;

static void start(Moody *m) {
    for (int i = 0; i < NUMBERS; i++) m->number[i] = 1.0;
    for (int i = 0; i < STATUSES; i++) m->status[i] = fmi2OK;
    m->terminated = fmi2False;
}

static fmi2Status answer(fmi2Component c, int place, const char *name) {
    Moody *m = c;
    fmi2Status status = (fmi2Status)m->status[place];
    calls_after_fatal += m->fatal;
    m->fatal = m->fatal || status == fmi2Fatal;
    if (status != fmi2OK)
        m->callbacks->logger(m->callbacks->componentEnvironment, "moody", status, "logStatusError",
                             "%s said %d,\n\t%.3f times %s", name, (int)status, 2.5, "no");
    return status;
}

FMI2_Export const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
FMI2_Export const char *fmi2GetVersion(void) { return fmi2Version; }
FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging) {
    if (name[0] == '_') {
        callbacks->logger(callbacks->componentEnvironment, name, fmi2Error, "logStatusError", "no licence for '%s'", name);
        return NULL;
    }
    Moody *m = calloc(1, sizeof *m);
    m->callbacks = callbacks;
    start(m);
    instances++;
    return m;
}

FMI2_Export void fmi2FreeInstance(fmi2Component c) {
    calls_after_fatal += ((Moody *)c)->fatal;
    instances--;
    free(c);
}

FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real t, fmi2Real t0, fmi2Boolean sd, fmi2Real t1) { return answer(c, SETUP, "setup"); }
FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return answer(c, ENTER, "enter"); }
FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c) { return answer(c, EXIT, "exit"); }
FMI2_Export fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
FMI2_Export fmi2Status fmi2Reset(fmi2Component c) {
    fmi2Status status = answer(c, RESET, "reset");
    start(c);
    return status;
}

FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep) {
    Moody *m = c;
    m->number[OUTPUT] = m->number[INPUT];
    m->terminated = t >= 5.0;
    return m->terminated ? fmi2Discard : answer(c, STEP, "step");
}
FMI2_Export fmi2Status fmi2CancelStep(fmi2Component c) { return fmi2OK; }

FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) v[i] = ((Moody *)c)->number[vr[i]];
    return answer(c, GET, "get");
}
FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++)
        if (vr[i] != STUBBORN) ((Moody *)c)->number[vr[i]] = v[i];
    return answer(c, SET, "set");
}
FMI2_Export fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) v[i] = ((Moody *)c)->status[vr[i]];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[]) {
    for (size_t i = 0; i < n; i++) ((Moody *)c)->status[vr[i]] = v[i];
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state) {
    *state = malloc(1);
    return answer(c, SAVE, "save");
}
FMI2_Export fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state) { return answer(c, SAVE, "restore"); }
FMI2_Export fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state) {
    free(*state);
    *state = NULL;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value) {
    *value = ((Moody *)c)->terminated;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value) {
    *value = 5.0;
    return fmi2OK;
}

#define UNUSED(name, ...) FMI2_Export fmi2Status name(fmi2Component c, __VA_ARGS__) { return fmi2Error; }
UNUSED(fmi2GetBoolean, const fmi2ValueReference vr[], size_t n, fmi2Boolean v[])
UNUSED(fmi2GetString, const fmi2ValueReference vr[], size_t n, fmi2String v[])
UNUSED(fmi2SetBoolean, const fmi2ValueReference vr[], size_t n, const fmi2Boolean v[])
UNUSED(fmi2SetString, const fmi2ValueReference vr[], size_t n, const fmi2String v[])
UNUSED(fmi2SerializedFMUstateSize, fmi2FMUstate s, size_t *n)
UNUSED(fmi2SerializeFMUstate, fmi2FMUstate s, fmi2Byte b[], size_t n)
UNUSED(fmi2DeSerializeFMUstate, const fmi2Byte b[], size_t n, fmi2FMUstate *s)
UNUSED(fmi2GetDirectionalDerivative, const fmi2ValueReference z[], size_t nz, const fmi2ValueReference v[], size_t nv, const fmi2Real dv[], fmi2Real dz[])
UNUSED(fmi2SetRealInputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], const fmi2Real v[])
UNUSED(fmi2GetRealOutputDerivatives, const fmi2ValueReference vr[], size_t n, const fmi2Integer order[], fmi2Real v[])
UNUSED(fmi2GetStatus, const fmi2StatusKind kind, fmi2Status *value)
UNUSED(fmi2GetIntegerStatus, const fmi2StatusKind kind, fmi2Integer *value)
UNUSED(fmi2GetStringStatus, const fmi2StatusKind kind, fmi2String *value)
