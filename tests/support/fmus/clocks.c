/* An FMU (FMI 3.0, co-simulation and model exchange) with every kind of clock, that minds the order of its calls.

   Each input clock is counted; `sampled` is what `u` was when `tick` last ticked, `heard` what `w` was when `trigger`
   did, `kept` what `v` was when `tick` did. After 0.5 s there is the `trouble` that is asked for. `out` ticks with every `divisor`th tick of `tick`, `relay` with every one of `trigger` or `second`. `countdown` is set to
   `delay` by each tick of `trigger`. `changing` goes on after 1, 2, 4, ... times `growth`. At `alarm_at` a step ends
   early, and `alarm` ticks; it does so in the initialisation where that is over. At `event_at` there is an event that was told in advance. */
#include <math.h>
#include <stdlib.h>
#include "fmi3Functions.h"

enum { TICK = 1, TUNE, CHANGING, COUNTDOWN, TRIGGER, OUT, RELAY, ALARM, FIXED, SECOND, CLOCKS };
enum { U = 20, W, DIVISOR, DELAY, GROWTH, ALARM_AT, EVENT_AT, PERIOD, TROUBLE, V, SHIFT, REALS_END };
enum { SAMPLED = 40, HEARD, SEEN, LAST_TIME, GAUGE, KEPT, OUTPUTS_END };
enum { COUNTS = 60 }; /* Int32: how often the clock of COUNTS + reference ticked; COUNTS: events */
enum { NONE, UPDATE_FAILS, ENDS, ENDLESS, TICK_FAILS, STEP_FAILS, WARNS, STUCK, CROWDED, STOPS, ENTER_FAILS, LEAVE_FAILS,
    BEHIND, BEYOND, WHOLE };
enum { UNTOLD = -2 }; /* a shift that it refuses to tell */
enum { INSTANTIATED = 1, INITIALISATION = 2, EVENT = 4, STEP = 8 };

typedef struct {
    double real[OUTPUTS_END];
    int count[CLOCKS];
    bool active[CLOCKS], sounded;
    double time, countdown, changing;
    bool told_countdown, told_changing, told_period;
    int mode, settled;
} State;

typedef struct {
    State now;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
    bool events, early, exchange;
} Instance;

static void start(Instance *it)
{
    const State fresh = {.real = {[DIVISOR] = 3, [DELAY] = 0.25, [GROWTH] = 0.1, [ALARM_AT] = 1e300, [EVENT_AT] = 1e300,
                                  [PERIOD] = 0.2}, .mode = INSTANTIATED, .changing = 1};
    it->now = fresh;
}

static fmi3Status refuse(Instance *it, const char *what)
{
    it->log(it->environment, fmi3Error, "logStatusError", what);
    return fmi3Error;
}

#define REQUIRE(condition)                        \
    do {                                          \
        if (!(condition))                         \
            return refuse(it, "not " #condition); \
    } while (0)

static bool trouble(const Instance *it, int kind) { return it->now.real[TROUBLE] == kind && it->now.time > 0.5; }

FMI3_Export const char *fmi3GetVersion(void) { return "3.0"; }

static Instance *made(fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    Instance *it = calloc(1, sizeof *it);
    it->environment = environment;
    it->log = log;
    start(it);
    return it;
}

FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean v,
    fmi3Boolean l, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    Instance *it = made(environment, log);
    it->events = events;
    it->early = early;
    return it;
}

FMI3_Export fmi3Instance fmi3InstantiateModelExchange(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean v,
    fmi3Boolean l, fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    Instance *it = made(environment, log);
    it->events = it->exchange = true;
    return it;
}

FMI3_Export void fmi3FreeInstance(fmi3Instance c) { free(c); }
FMI3_Export fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
FMI3_Export fmi3Status fmi3Reset(fmi3Instance c) { start(c); return fmi3OK; }
FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String k[]) { return fmi3OK; }

FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 t, fmi3Float64 t0,
    fmi3Boolean sd, fmi3Float64 t1)
{
    Instance *it = c;
    REQUIRE(it->now.mode == INSTANTIATED);
    it->now.mode = INITIALISATION;
    it->now.time = t0;
    return fmi3OK;
}
static void sound(Instance *it)
{
    if (it->now.sounded || it->now.time < it->now.real[ALARM_AT])
        return;
    it->now.sounded = it->now.active[ALARM] = true;
}
FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    Instance *it = c;
    REQUIRE(it->now.mode == INITIALISATION);
    it->now.mode = it->events ? EVENT : STEP;
    it->now.settled = 0;
    sound(it);
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    Instance *it = c;
    REQUIRE(it->events && it->now.mode == STEP);
    REQUIRE(!trouble(it, ENTER_FAILS));
    it->now.mode = EVENT;
    it->now.settled = 0;
    it->now.count[0]++;
    sound(it);
    return fmi3OK;
}
static fmi3Status leave(Instance *it)
{
    REQUIRE(it->now.mode == EVENT && it->now.settled);
    REQUIRE(!trouble(it, LEAVE_FAILS));
    it->now.mode = STEP;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance c) { return leave(c); }
FMI3_Export fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance c) { return leave(c); }

FMI3_Export fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock on[])
{
    Instance *it = c;
    REQUIRE(it->now.mode == EVENT);
    REQUIRE(!trouble(it, TICK_FAILS));
    for (size_t i = 0; i < n; i++) {
        REQUIRE(r[i] >= TICK && (r[i] <= TRIGGER || r[i] >= FIXED) && on[i]);
        REQUIRE(!it->now.active[r[i]]);
        it->now.active[r[i]] = true;
        it->now.count[r[i]]++;
        it->now.real[LAST_TIME] = it->now.time;
    }
    State *s = &it->now;
    s->active[OUT] = s->active[TICK] && s->count[TICK] % (int)s->real[DIVISOR] == 0;
    s->active[RELAY] = s->active[TRIGGER] || s->active[SECOND];
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock on[])
{
    Instance *it = c;
    REQUIRE(it->now.mode == EVENT);
    for (size_t i = 0; i < n; i++)
        on[i] = it->now.active[r[i]];
    return fmi3OK;
}
static void sample(State *s)
{
    if (s->active[TICK])
        s->real[SAMPLED] = s->real[U], s->real[KEPT] = s->real[V];
    if (s->active[TRIGGER])
        s->real[HEARD] = s->real[W];
}
FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ending,
    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *known, fmi3Float64 *next)
{
    Instance *it = c;
    State *s = &it->now;
    REQUIRE(s->mode == EVENT);
    REQUIRE(!trouble(it, UPDATE_FAILS));
    sample(s);
    if (s->active[TRIGGER])
        s->countdown = s->real[DELAY], s->told_countdown = false;
    if (s->active[CHANGING])
        s->changing *= 2, s->told_changing = false;
    for (int i = 0; i < CLOCKS; i++)
        s->active[i] = false;
    if (s->time >= s->real[EVENT_AT]) {
        s->real[SEEN] = s->time;
        s->real[EVENT_AT] = 1e300;
    }
    *nominals = *values = false;
    *again = trouble(it, ENDLESS);
    *ending = trouble(it, ENDS);
    *known = s->real[EVENT_AT] < 1e300;
    *next = s->real[EVENT_AT];
    if (trouble(it, CROWDED))
        *known = true, *next = s->time;
    s->settled = 1;
    return trouble(it, WARNS) ? fmi3Warning : fmi3OK;
}
FMI3_Export fmi3Status fmi3GetShiftDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 shifts[])
{
    Instance *it = c;
    REQUIRE(it->now.mode == INITIALISATION);
    if (it->now.real[SHIFT] == UNTOLD)
        return fmi3Error;
    for (size_t i = 0; i < n; i++) {
        REQUIRE(r[i] == FIXED || r[i] == TUNE);
        shifts[i] = it->now.real[SHIFT];
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n,
    fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    Instance *it = c;
    State *s = &it->now;
    REQUIRE(s->mode == EVENT);
    for (size_t i = 0; i < n; i++) {
        bool *told = r[i] == COUNTDOWN ? &s->told_countdown : r[i] == CHANGING ? &s->told_changing : &s->told_period;
        REQUIRE(r[i] == COUNTDOWN || r[i] == CHANGING || r[i] == TUNE || r[i] == FIXED);
        intervals[i] = r[i] == COUNTDOWN ? s->countdown : r[i] == CHANGING ? s->changing * s->real[GROWTH] / 2 : s->real[PERIOD];
        bool fresh = r[i] == COUNTDOWN ? s->count[TRIGGER] && !*told : !*told || r[i] == FIXED;
        qualifiers[i] = fresh ? fmi3IntervalChanged : fmi3IntervalUnchanged;
        if (fresh)
            *told = true;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no, fmi3Boolean *event,
    fmi3Boolean *ending, fmi3Boolean *early, fmi3Float64 *last)
{
    Instance *it = c;
    State *s = &it->now;
    REQUIRE(s->mode == STEP && size > 0 && fabs(s->time - time) < 1e-9);
    REQUIRE(!trouble(it, STEP_FAILS));
    *last = time;
    if (trouble(it, STUCK)) {
        *early = true;
        return fmi3OK;
    }
    *event = *ending = *early = false;
    s->time = time + size;
    if (it->early && time < s->real[ALARM_AT] && s->real[ALARM_AT] < s->time) {
        s->time = s->real[ALARM_AT];
        *event = *early = true;
    }
    s->real[GAUGE] = s->time;
    *last = s->time;
    *ending = trouble(it, STOPS);
    if (trouble(it, BEHIND) || trouble(it, BEYOND))
        *event = *early = true, *last += trouble(it, BEYOND) ? 1 : -1;
    if (trouble(it, WHOLE))
        *early = true;
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 time)
{
    ((Instance *)c)->now.time = ((Instance *)c)->now.real[GAUGE] = time;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n) { *n = 0; return fmi3OK; }
FMI3_Export fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n) { *n = 0; return fmi3OK; }

FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m)
{
    Instance *it = c;
    for (size_t i = 0; i < n; i++) {
        REQUIRE(r[i] >= U && r[i] < REALS_END);
        REQUIRE(it->now.mode != STEP); /* all are discrete */
        REQUIRE(r[i] != W || it->now.mode == INITIALISATION || it->now.mode == INSTANTIATED || it->now.active[TRIGGER]);
        REQUIRE(r[i] != V || it->now.mode == INITIALISATION || it->now.mode == INSTANTIATED || it->now.active[TICK]);
        it->now.told_period = it->now.told_period && r[i] != PERIOD;
        it->now.real[r[i]] = v[i];
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{
    Instance *it = c;
    sample(&it->now);
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] == 0 ? it->now.time : it->now.real[r[i]];
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetInt32(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Int32 v[], size_t m)
{
    for (size_t i = 0; i < n; i++)
        v[i] = ((Instance *)c)->now.count[r[i] - COUNTS];
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *s)
{
    if (!*s)
        *s = malloc(sizeof(State));
    *(State *)*s = ((Instance *)c)->now;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState s) { ((Instance *)c)->now = *(State *)s; return fmi3OK; }
FMI3_Export fmi3Status fmi3FreeFMUState(fmi3Instance c, fmi3FMUState *s) { free(*s); *s = NULL; return fmi3OK; }
