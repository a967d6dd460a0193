/* An FMU (FMI 3.0, co-simulation) that tells of its own steps: a level that follows its input by explicit Euler steps.
   Before each it tells of a trial that it discards, with another level. A periodic clock resets its counter of ticks. */
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { INPUT = 1, LEVEL, RATE, TROUBLE, ASKED, TICK, TICKS };
enum { NONE, BACKWARDS, BEYOND, NO_VALUES, SILENT, TWICE };

typedef struct {
    double input, level, rate, trial;
    int trouble, ticks, fails;
    int asked;                                   /* value references that the importer has asked for */
    fmi3InstanceEnvironment environment;
    fmi3IntermediateUpdateCallback update;
} Between;

static void start(Between *b) {
    b->input = 1.0, b->level = 0.0, b->rate = 1.0, b->trouble = b->ticks = b->fails = 0;
}

FMI3_Export const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance i, fmi3Boolean on, size_t n, const fmi3String c[]) { return fmi3OK; }

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
    fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference asked[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Between *b = calloc(1, sizeof *b);
    start(b);
    b->environment = environment, b->update = update;
    for (size_t i = 0; i < n; i++) b->asked = 10 * b->asked + (int)asked[i];
    return b;
}
FMI3_Export void fmi3FreeInstance(fmi3Instance i) { free(i); }
FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance i, fmi3Boolean td, double t, double t0, fmi3Boolean sd, double t1) { return fmi3OK; }
FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance i) { return fmi3OK; }
FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance i) { return fmi3OK; }
FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance i) { return fmi3OK; }
FMI3_Export fmi3Status fmi3Terminate(fmi3Instance i) { return fmi3OK; }
FMI3_Export fmi3Status fmi3Reset(fmi3Instance i) { start(i); return fmi3OK; }
FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance i, fmi3Boolean *again, fmi3Boolean *end, fmi3Boolean *nominals,
    fmi3Boolean *values, fmi3Boolean *known, double *next) {
    *again = *end = *nominals = *values = *known = fmi3False;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetClock(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Clock v[]) {
    for (size_t k = 0; k < n; k++) ((Between *)i)->ticks += v[k];
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, const double v[], size_t m) {
    Between *b = i;
    for (size_t k = 0; k < n; k++) *(r[k] == INPUT ? &b->input : r[k] == LEVEL ? &b->level : &b->rate) = v[k];
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance i, const fmi3ValueReference r[], size_t n, double v[], size_t m) {
    Between *b = i;
    for (size_t k = 0; k < n; k++) v[k] = r[k] == INPUT ? b->input : r[k] == LEVEL ? b->level + b->trial : b->rate;
    return b->fails ? fmi3Error : fmi3OK;
}
FMI3_Export fmi3Status fmi3SetInt32(fmi3Instance i, const fmi3ValueReference r[], size_t n, const fmi3Int32 v[], size_t m) {
    for (size_t k = 0; k < n; k++) ((Between *)i)->trouble = v[k];
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetInt32(fmi3Instance i, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t m) {
    Between *b = i;
    for (size_t k = 0; k < n; k++) v[k] = r[k] == TROUBLE ? b->trouble : r[k] == ASKED ? b->asked : b->ticks;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetFMUState(fmi3Instance i, fmi3FMUState *s) {
    if (!*s) *s = malloc(sizeof(Between));
    memcpy(*s, i, sizeof(Between));
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetFMUState(fmi3Instance i, fmi3FMUState s) { memcpy(i, s, sizeof(Between)); return fmi3OK; }
FMI3_Export fmi3Status fmi3FreeFMUState(fmi3Instance i, fmi3FMUState *s) { free(*s); *s = NULL; return fmi3OK; }

static int tell(Between *b, double time, fmi3Boolean finished) {
    fmi3Boolean early = fmi3True;                /* an importer that wants none has to say so */
    double at = 0.0;
    if (!b->update || b->trouble == SILENT) return 1;
    b->update(b->environment, time, fmi3True, fmi3True, finished, fmi3True, &early, &at);
    return !early;
}

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance i, double t, double h, fmi3Boolean nosave, fmi3Boolean *event,
    fmi3Boolean *end, fmi3Boolean *early, double *reached) {
    Between *b = i;
    int count = 4;
    *event = *end = *early = fmi3False, *reached = t + h;
    for (int k = 1; k <= count; k++) {
        b->trial = 1000.0;
        if (!tell(b, t + h * k / count, fmi3False)) return fmi3Error;
        b->trial = 0.0;
        b->level += h / count * b->rate * (b->input - b->level);
        b->fails = b->trouble == NO_VALUES;
        double at = b->trouble == BACKWARDS ? t + h - h * k / count : b->trouble == BEYOND ? t + 2 * h : t + h * k / count;
        if (!tell(b, at, fmi3True) || (b->trouble == TWICE && !tell(b, at, fmi3True))) return fmi3Error;
        b->fails = 0;
    }
    return fmi3OK;
}
