/* x' = u - k x by Euler steps (FMI 2.0, co-simulation); macros with statements put quirks into its functions. */
#include <fenv.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fmi2Functions.h"

#ifndef NUMBER
#define NUMBER double
#endif
#define QUIRK(name) do { name } while (0)
#ifndef ON_STEP
#define ON_STEP
#endif
#ifndef ON_RESET
#define ON_RESET start(m);
#endif
#ifndef ON_TERMINATE
#define ON_TERMINATE
#endif
#ifndef ON_SETUP
#define ON_SETUP
#endif
#ifndef ON_INITIALISED
#define ON_INITIALISED
#endif

enum { U, X, K, NUMBERS };

typedef struct {
    NUMBER number[NUMBERS];
    fmi2Boolean flag;
    double time;
    const fmi2CallbackFunctions *host;
    const char *name;
} Model;

int terminated = 0, instances = 0, broken = 0;

static void start(Model *m) { m->number[U] = 0; m->number[X] = 1; m->number[K] = 0.5; m->flag = fmi2False; m->time = 0; }
static void say(Model *m, const char *text) {
    m->host->logger(m->host->componentEnvironment, m->name, fmi2Warning, "logStatusWarning", "%s at %g", text, m->time);
}

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *host, fmi2Boolean visible, fmi2Boolean logging) {
    Model *m = calloc(1, sizeof *m);
    m->host = host; m->name = "quirks"; start(m); instances++;
    return m;
}
FMI2_Export void fmi2FreeInstance(fmi2Component c) { instances--; free(c); }
FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean hasTolerance, fmi2Real tolerance, fmi2Real begin,
                                           fmi2Boolean hasStop, fmi2Real stop) {
    Model *m = c; m->time = begin; QUIRK(ON_SETUP); return fmi2OK;
}
FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c) { return fmi2OK; }
FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c) { Model *m = c; QUIRK(ON_INITIALISED); (void)m; return fmi2OK; }
FMI2_Export fmi2Status fmi2Terminate(fmi2Component c) { Model *m = c; terminated++; QUIRK(ON_TERMINATE); (void)m; return fmi2OK; }
FMI2_Export fmi2Status fmi2Reset(fmi2Component c) { Model *m = c; QUIRK(ON_RESET); (void)m; return fmi2OK; }
FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->number[r[i]];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Real v[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->number[r[i]] = (NUMBER)v[i];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2Boolean v[]) {
    for (size_t i = 0; i < n; i++) v[i] = ((Model *)c)->flag;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference r[], size_t n, const fmi2Boolean v[]) {
    for (size_t i = 0; i < n; i++) ((Model *)c)->flag = v[i];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real h, fmi2Boolean keep) {
    Model *m = c;
    QUIRK(ON_STEP);
    m->number[X] += h * (m->number[U] - m->number[K] * m->number[X]);
    m->time = t + h;
    return fmi2OK;
}
#ifdef ASKS
FMI2_Export fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *v) { *v = fmi2True; return fmi2OK; }
FMI2_Export fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *v) { *v = ((Model *)c)->time; return fmi2OK; }
#endif
#ifdef ON_TEXT
FMI2_Export fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference r[], size_t n, fmi2String v[]) {
    Model *m = c; for (size_t i = 0; i < n; i++) v[i] = (ON_TEXT); return fmi2OK;
}
#endif
