/* A network FMU after FMI-LS-BUS for CAN that minds the order of its calls.

   Every `period` it sends a frame with the identifier `id` and a count as data, the first at `first`: when its clock
   Tx_Clock is ticked (a countdown) or, `triggered`, when the step is over in which it is due. In the beginning it
   configures a bit `rate`, if not 0, and that its frames are given back, where `discard`. With `spoil` its second frame
   is an operation that there is not. From the time `hangs` on, if not 0, no step ends. What it receives it counts. */
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
#include "fmi3Functions.h"

enum { RX_DATA = 1, TX_DATA, RX_CLOCK, TX_CLOCK };
enum { PERIOD = 10, FIRST, ID, RATE, DISCARD, SPOIL, TRIGGERED, HANGS, PARAMETERS };
enum { NOTIFIED = 20 };
enum { RECEIVED = 30, LAST_ID, LAST_TIME, CONFIRMED, LOST, COMPLAINTS, OUTPUTS };
enum { INSTANTIATED = 1, INITIALISATION = 2, EVENT = 4, STEP = 8 };

typedef struct {
    double real[OUTPUTS]; /* by reference */
    bool notified, rx, tx, shown, told, taken;
    unsigned char out[4096], in[4096];
    size_t out_size, in_size;
    double time;
    int sent, mode;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Instance;

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

static void start(Instance *it)
{
    fmi3InstanceEnvironment environment = it->environment;
    fmi3LogMessageCallback log = it->log;
    memset(it, 0, sizeof *it);
    it->environment = environment, it->log = log, it->mode = INSTANTIATED;
    it->real[PERIOD] = it->real[FIRST] = 0.1, it->real[ID] = 0x100;
}

static void put(Instance *it, uint32_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        it->out[it->out_size++] = (unsigned char)(value >> 8 * i);
}
static uint32_t number(const unsigned char *at) { return at[0] | at[1] << 8 | at[2] << 16 | (uint32_t)at[3] << 24; }

static void configure(Instance *it)
{
    if (it->real[RATE])
        put(it, 0x40, 4), put(it, 13, 4), put(it, 1, 1), put(it, (uint32_t)it->real[RATE], 4);
    if (it->real[DISCARD])
        put(it, 0x40, 4), put(it, 10, 4), put(it, 4, 1), put(it, 2, 1);
}
static void transmit(Instance *it)
{
    const bool spoilt = it->real[SPOIL] && it->sent == 1;
    put(it, spoilt ? 0x99 : 0x10, 4), put(it, 18, 4), put(it, (uint32_t)it->real[ID], 4), put(it, 0, 2), put(it, 2, 2);
    put(it, (uint32_t)it->sent++, 2);
}
static double due(const Instance *it) { return it->real[FIRST] + it->sent * it->real[PERIOD]; }

FMI3_Export const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean v,
    fmi3Boolean l, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    if (!events)
        return NULL;
    Instance *it = calloc(1, sizeof *it);
    it->environment = environment, it->log = log;
    start(it);
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
    REQUIRE(it->mode == INSTANTIATED);
    it->mode = INITIALISATION, it->time = t0;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance c)
{
    Instance *it = c;
    REQUIRE(it->mode == INITIALISATION);
    it->mode = EVENT;
    configure(it);
    it->tx = it->real[TRIGGERED] && it->out_size;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance c)
{
    Instance *it = c;
    REQUIRE(it->mode == STEP);
    it->mode = EVENT;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance c)
{
    Instance *it = c;
    REQUIRE(it->mode == EVENT);
    it->mode = STEP;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock on[])
{
    Instance *it = c;
    REQUIRE(it->mode == EVENT);
    for (size_t i = 0; i < n; i++) {
        REQUIRE(on[i] && (r[i] == RX_CLOCK || (r[i] == TX_CLOCK && !it->real[TRIGGERED])));
        bool *active = r[i] == RX_CLOCK ? &it->rx : &it->tx;
        REQUIRE(!*active);
        *active = true;
        if (r[i] == TX_CLOCK) {
            REQUIRE(fabs(it->time - due(it)) < 1e-9);
            transmit(it);
            it->told = false;
        }
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Clock on[])
{
    Instance *it = c;
    REQUIRE(it->mode == EVENT);
    for (size_t i = 0; i < n; i++) /* once an activation, as FMI 3.0 has it; the data stay until the event ends */
        on[i] = it->tx && !it->shown;
    it->shown = it->tx;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, size_t sizes[],
    fmi3Binary values[], size_t m)
{
    Instance *it = c;
    REQUIRE(n == 1 && r[0] == TX_DATA && it->mode == EVENT && it->tx);
    REQUIRE(!it->taken); /* as some that make their operations when they are asked for them */
    it->taken = true;
    sizes[0] = it->out_size, values[0] = it->out;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, const size_t sizes[],
    const fmi3Binary values[], size_t m)
{
    Instance *it = c;
    REQUIRE(n == 1 && r[0] == RX_DATA && it->mode == EVENT && it->rx && sizes[0] <= 64);
    memcpy(it->in, values[0], it->in_size = sizes[0]);
    return fmi3OK;
}
static void receive(Instance *it)
{
    for (size_t at = 0; at < it->in_size; at += number(it->in + at + 4)) {
        const uint32_t code = number(it->in + at);
        const int place = code == 0x10 ? RECEIVED : code == 0x20 ? CONFIRMED : code == 0x30 ? LOST : COMPLAINTS;
        it->real[place]++;
        if (place == RECEIVED)
            it->real[LAST_ID] = number(it->in + at + 8), it->real[LAST_TIME] = it->time;
    }
}
FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ending,
    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *known, fmi3Float64 *next)
{
    Instance *it = c;
    REQUIRE(it->mode == EVENT);
    if (it->rx)
        receive(it);
    if (it->tx)
        it->out_size = 0;
    it->rx = it->tx = it->shown = it->taken = false, it->in_size = 0;
    *again = *ending = *nominals = *values = *known = false;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n,
    fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    Instance *it = c;
    REQUIRE(it->mode == EVENT && n == 1 && r[0] == TX_CLOCK);
    qualifiers[0] = it->told ? fmi3IntervalUnchanged : fmi3IntervalChanged;
    intervals[0] = due(it) - it->time;
    it->told = true;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no, fmi3Boolean *event,
    fmi3Boolean *ending, fmi3Boolean *early, fmi3Float64 *last)
{
    Instance *it = c;
    REQUIRE(it->mode == STEP && size > 0 && fabs(it->time - time) < 1e-9);
    while (it->real[HANGS] && time >= it->real[HANGS])
        pause();
    it->time = *last = time + size;
    while (it->real[TRIGGERED] && due(it) <= it->time + 1e-9)
        transmit(it);
    it->tx = *event = it->real[TRIGGERED] && it->out_size;
    *ending = *early = false;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Float64 v[], size_t m)
{
    Instance *it = c;
    for (size_t i = 0; i < n; i++) {
        REQUIRE(r[i] >= PERIOD && r[i] < PARAMETERS && it->mode == INSTANTIATED);
        it->real[r[i]] = v[i];
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] ? ((Instance *)c)->real[r[i]] : ((Instance *)c)->time;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Boolean v[], size_t m)
{
    ((Instance *)c)->notified = v[0];
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Boolean v[], size_t m)
{
    Instance *it = c;
    REQUIRE(it->notified || it->mode < EVENT); /* as some that say nothing of a parameter which nobody has set */
    v[0] = it->notified;
    return fmi3OK;
}
