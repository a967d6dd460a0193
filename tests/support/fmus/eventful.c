/* An FMU (FMI 2.0, model exchange) with every kind of event, that minds the order in which its functions are called.

   x' = rate x + u;   where x rises above `level` it jumps to `after`;   every `period` the input is sampled. */
#include <math.h>
#include <stdlib.h>
#include "fmi2Functions.h"

enum { U, X, DX, SAMPLE, RATE, GAIN, PERIOD, LEVEL, AFTER, NOMINAL, START, REALS }; /* value references of reals */
enum { TROUBLE, EVENTS, CROSSINGS, SAMPLES, STEPS, INTEGERS };                     /* of integers */
enum { NONE, ENDLESS, CHATTER, UNDEFINED, DISCARDED, FAILED, FATAL, STEP_EVENT, STOP_AT_EVENT, STOP_AT_STEP };
enum { INSTANTIATED = 1, INITIALISATION = 2, EVENT = 4, CONTINUOUS = 8 };

typedef struct {
    fmi2Real real[REALS];
    fmi2Integer integer[INTEGERS];
    int mode, settled, above;
    double time, completed, flushed, event;
} State;

typedef struct {
    const fmi2CallbackFunctions *callbacks;
    State now;
    int dead;
} Instance;

int calls_after_fatal = 0;

static void start(Instance *it)
{
    const State fresh = {.real = {[RATE] = -1, [GAIN] = 1, [LEVEL] = 1e300, [NOMINAL] = 1, [START] = 1},
                         .mode = INSTANTIATED, .completed = -INFINITY, .flushed = -INFINITY};
    it->now = fresh;
}

static fmi2Status refuse(Instance *it, const char *what)
{
    calls_after_fatal += it->dead;
    it->callbacks->logger(it->callbacks->componentEnvironment, "eventful", fmi2Error, "logStatusError", "%s", what);
    return fmi2Error;
}

#define REQUIRE(condition)                   \
    do {                                     \
        if (it->dead || !(condition))         \
            return refuse(it, "not " #condition); \
    } while (0)

static int late(const State *s, int trouble) { return s->integer[TROUBLE] == trouble && s->time > 1; }

FMI2_Export const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }
FMI2_Export const char *fmi2GetVersion(void) { return fmi2Version; }
FMI2_Export fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String names[]) { return fmi2OK; }

FMI2_Export fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                                          const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    if (type != fmi2ModelExchange)
        return NULL;
    Instance *it = calloc(1, sizeof *it);
    it->callbacks = callbacks;
    start(it);
    return it;
}
FMI2_Export void fmi2FreeInstance(fmi2Component c) { free(c); }
FMI2_Export fmi2Status fmi2Terminate(fmi2Component c) { return fmi2OK; }
FMI2_Export fmi2Status fmi2Reset(fmi2Component c)
{
    start(c);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean td, fmi2Real t, fmi2Real t0, fmi2Boolean sd, fmi2Real t1)
{
    Instance *it = c;
    REQUIRE(it->now.mode == INSTANTIATED && td && t > 0);
    it->now.time = t0;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    Instance *it = c;
    REQUIRE(it->now.mode == INSTANTIATED);
    it->now.mode = INITIALISATION;
    it->now.real[X] = it->now.real[START];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    Instance *it = c;
    REQUIRE(it->now.mode == INITIALISATION);
    it->now.mode = EVENT;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    Instance *it = c;
    REQUIRE(it->now.mode == CONTINUOUS);
    it->now.mode = EVENT;
    it->now.settled = 0;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Instance *it = c;
    State *s = &it->now;
    REQUIRE(it->now.mode == EVENT);
    const fmi2EventInfo nothing = {0};
    *info = nothing;
    info->newDiscreteStatesNeeded = s->integer[TROUBLE] == ENDLESS;
    info->terminateSimulation = late(s, STOP_AT_EVENT);
    const double period = s->real[PERIOD];
    REQUIRE(period <= 0 || s->time - s->integer[SAMPLES] * period < 1e-10);
    if (period > 0 && s->time >= s->integer[SAMPLES] * period) {
        s->real[SAMPLE] = s->real[GAIN] * s->real[U];
        s->integer[SAMPLES]++;
        info->newDiscreteStatesNeeded = fmi2True; /* once more: what was sampled may change other things */
    }
    if (s->real[X] > s->real[LEVEL]) {
        s->real[X] = s->real[AFTER];
        s->integer[CROSSINGS]++;
        info->valuesOfContinuousStatesChanged = info->newDiscreteStatesNeeded = fmi2True;
    }
    info->nextEventTimeDefined = period > 0;
    info->nextEventTime = s->integer[SAMPLES] * period;
    s->settled = !info->newDiscreteStatesNeeded;
    s->event = s->time;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    Instance *it = c;
    REQUIRE(it->now.mode == EVENT && it->now.settled);
    it->now.mode = CONTINUOUS;
    it->now.completed = it->now.time;
    it->now.integer[EVENTS]++;
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean final, fmi2Boolean *event, fmi2Boolean *stop)
{
    Instance *it = c;
    REQUIRE(it->now.mode == CONTINUOUS && it->now.time >= it->now.completed);
    it->now.completed = it->now.time;
    it->now.integer[STEPS]++;
    if (final)
        it->now.flushed = it->now.time;
    *event = it->now.integer[TROUBLE] == STEP_EVENT && it->now.integer[STEPS] % 10 == 0;
    *stop = late(&it->now, STOP_AT_STEP);
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    Instance *it = c;
    REQUIRE(it->now.mode == CONTINUOUS && time >= it->now.completed);
    it->now.time = time;
    it->dead = late(&it->now, FATAL);
    return it->dead ? fmi2Fatal : fmi2OK;
}
FMI2_Export fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t n)
{
    Instance *it = c;
    REQUIRE(it->now.mode == CONTINUOUS && n == 1 && isfinite(x[0]));
    it->now.real[X] = x[0];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Instance *it = c;
    REQUIRE(it->now.mode & (EVENT | CONTINUOUS) && n == 1);
    x[0] = it->now.real[X];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x[], size_t n)
{
    Instance *it = c;
    REQUIRE(it->now.mode & (EVENT | CONTINUOUS) && n == 1);
    x[0] = it->now.real[NOMINAL];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    Instance *it = c;
    const State *s = &it->now;
    REQUIRE(it->now.mode & (EVENT | CONTINUOUS) && n == 1);
    dx[0] = late(s, UNDEFINED) ? NAN : s->real[RATE] * s->real[X] + s->real[U];
    if (late(s, FAILED))
        return refuse(it, "no rate for you");
    return late(s, DISCARDED) ? fmi2Discard : fmi2OK;
}
FMI2_Export fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real z[], size_t n)
{
    Instance *it = c;
    const State *s = &it->now;
    REQUIRE(it->now.mode == CONTINUOUS && n == 1);
    z[0] = s->integer[TROUBLE] == CHATTER && s->event > 1 ? (s->time > s->event ? -1 : 1) : s->real[X] - s->real[LEVEL];
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Real v[])
{
    State *s = &((Instance *)c)->now;
    s->real[DX] = s->real[RATE] * s->real[X] + s->real[U];
    for (size_t i = 0; i < n; i++)
        v[i] = s->real[vr[i]];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Real v[])
{
    Instance *it = c;
    REQUIRE(it->now.mode != CONTINUOUS);
    for (size_t i = 0; i < n; i++)
        it->now.real[vr[i]] = v[i];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, fmi2Integer v[])
{
    for (size_t i = 0; i < n; i++)
        v[i] = ((Instance *)c)->now.integer[vr[i]];
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t n, const fmi2Integer v[])
{
    for (size_t i = 0; i < n; i++)
        ((Instance *)c)->now.integer[vr[i]] = v[i];
    return fmi2OK;
}

FMI2_Export fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    *state = malloc(sizeof(State));
    *(State *)*state = ((Instance *)c)->now;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    Instance *it = c;
    REQUIRE(((State *)state)->time >= it->now.flushed);
    it->now = *(State *)state;
    return fmi2OK;
}
FMI2_Export fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    free(*state);
    *state = NULL;
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
