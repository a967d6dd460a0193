/* A bus after FMI-LS-BUS for CAN as an FMU, between two nodes: a terminal for each, with clocks that count down.

   What it receives it queues. The frame with the lowest identifier goes first, for as long as its bits take at the bit
   rate that a node has configured; then both clocks tick together, the sender has a confirmation and the other the
   frame. A clock that ticks alone, and what is asked for or given out of order, is an error. */
#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { NODES = 2, MOST = 64, FRAME = 32 };
enum { RX_DATA, TX_DATA, RX_CLOCK, TX_CLOCK, PER_NODE }; /* value references: 1 + 4 node + kind */
enum { CARRIED = 30 };
enum { INSTANTIATED = 1, INITIALISATION = 2, EVENT = 4, STEP = 8 };

typedef struct {
    unsigned char in[2048], out[2048], queue[MOST][FRAME];
    size_t in_size, out_size;
    int waiting;
    bool rx, tx;
} Node;
typedef struct {
    Node node[NODES];
    double interval, rate, carried;
    bool scheduled, fresh[NODES], evaluated;
    int mode;
    fmi3InstanceEnvironment environment;
    fmi3LogMessageCallback log;
} Bus;

static fmi3Status refuse(Bus *bus, const char *what)
{
    bus->log(bus->environment, fmi3Error, "logStatusError", what);
    return fmi3Error;
}
#define REQUIRE(condition)                         \
    do {                                           \
        if (!(condition))                          \
            return refuse(bus, "not " #condition); \
    } while (0)

static uint32_t number(const unsigned char *at) { return at[0] | at[1] << 8 | at[2] << 16 | (uint32_t)at[3] << 24; }
static void put(Node *node, uint32_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        node->out[node->out_size++] = (unsigned char)(value >> 8 * i);
}

static void start(Bus *bus)
{
    fmi3InstanceEnvironment environment = bus->environment;
    fmi3LogMessageCallback log = bus->log;
    memset(bus, 0, sizeof *bus);
    bus->environment = environment, bus->log = log, bus->mode = INSTANTIATED, bus->rate = 100000;
}

FMI3_Export const char *fmi3GetVersion(void) { return "3.0"; }
FMI3_Export fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean v,
    fmi3Boolean l, fmi3Boolean events, fmi3Boolean early, const fmi3ValueReference r[], size_t n,
    fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    if (!events)
        return NULL;
    Bus *bus = calloc(1, sizeof *bus);
    bus->environment = environment, bus->log = log;
    start(bus);
    return bus;
}
FMI3_Export void fmi3FreeInstance(fmi3Instance c) { free(c); }
FMI3_Export fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
FMI3_Export fmi3Status fmi3Reset(fmi3Instance c) { start(c); return fmi3OK; }
FMI3_Export fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String k[]) { return fmi3OK; }
static fmi3Status move(Bus *bus, int from, int to)
{
    REQUIRE(bus->mode == from);
    bus->mode = to;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 t, fmi3Float64 t0,
    fmi3Boolean sd, fmi3Float64 t1) { return move(c, INSTANTIATED, INITIALISATION); }
FMI3_Export fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return move(c, INITIALISATION, EVENT); }
FMI3_Export fmi3Status fmi3EnterEventMode(fmi3Instance c) { return move(c, STEP, EVENT); }
FMI3_Export fmi3Status fmi3EnterStepMode(fmi3Instance c) { return move(c, EVENT, STEP); }

static int first(const Bus *bus)
{
    int found = -1;
    for (int i = 0; i < NODES; i++)
        if (bus->node[i].waiting
            && (found < 0 || number(bus->node[i].queue[0] + 8) < number(bus->node[found].queue[0] + 8)))
            found = i;
    return found;
}
static void carry(Bus *bus)
{
    const int sender = first(bus);
    if (sender < 0)
        return;
    const unsigned char *frame = bus->node[sender].queue[0];
    for (int i = 0; i < NODES; i++) {
        Node *node = &bus->node[i];
        if (i == sender)
            put(node, 0x20, 4), put(node, 12, 4), put(node, number(frame + 8), 4);
        else
            memcpy(node->out + node->out_size, frame, number(frame + 4)), node->out_size += number(frame + 4);
    }
    memmove(bus->node[sender].queue, bus->node[sender].queue + 1, (size_t)--bus->node[sender].waiting * FRAME);
    bus->carried++;
}
static fmi3Status evaluate(Bus *bus)
{
    REQUIRE(bus->node[0].tx == bus->node[1].tx);
    if (bus->evaluated)
        return fmi3OK;
    bus->evaluated = true;
    for (int i = 0; i < NODES; i++) {
        Node *node = &bus->node[i];
        for (size_t at = 0; node->rx && at < node->in_size; at += number(node->in + at + 4)) {
            const uint32_t code = number(node->in + at), size = number(node->in + at + 4);
            REQUIRE(size >= 8 && size <= node->in_size - at);
            if (code == 0x40 && node->in[at + 8] == 1)
                bus->rate = number(node->in + at + 9);
            if (code == 0x10) {
                REQUIRE(size <= FRAME && node->waiting < MOST);
                memcpy(node->queue[node->waiting++], node->in + at, size);
            }
        }
    }
    if (bus->node[0].tx)
        carry(bus), bus->scheduled = false;
    const int next = first(bus);
    if (!bus->scheduled && next >= 0) {
        const unsigned length = number(bus->node[next].queue[0] + 4) - 16;
        bus->interval = (44 + 8.0 * length) / bus->rate;
        bus->scheduled = bus->fresh[0] = bus->fresh[1] = true;
    }
    return fmi3OK;
}

FMI3_Export fmi3Status fmi3SetClock(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3Clock on[])
{
    Bus *bus = c;
    REQUIRE(bus->mode == EVENT && !bus->evaluated);
    for (size_t i = 0; i < n; i++) {
        const int kind = (r[i] - 1) % PER_NODE;
        REQUIRE(on[i] && (kind == RX_CLOCK || kind == TX_CLOCK));
        *(kind == RX_CLOCK ? &bus->node[(r[i] - 1) / PER_NODE].rx : &bus->node[(r[i] - 1) / PER_NODE].tx) = true;
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, size_t sizes[],
    fmi3Binary values[], size_t m)
{
    Bus *bus = c;
    for (size_t i = 0; i < n; i++) {
        Node *node = &bus->node[(r[i] - 1) / PER_NODE];
        REQUIRE(bus->mode == EVENT && node->tx && (r[i] - 1) % PER_NODE == TX_DATA);
        if (evaluate(bus) != fmi3OK)
            return fmi3Error;
        sizes[i] = node->out_size, values[i] = node->out;
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3SetBinary(fmi3Instance c, const fmi3ValueReference r[], size_t n, const size_t sizes[],
    const fmi3Binary values[], size_t m)
{
    Bus *bus = c;
    for (size_t i = 0; i < n; i++) {
        Node *node = &bus->node[(r[i] - 1) / PER_NODE];
        REQUIRE(bus->mode == EVENT && node->rx && (r[i] - 1) % PER_NODE == RX_DATA && sizes[i] <= sizeof node->in);
        memcpy(node->in, values[i], node->in_size = sizes[i]);
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *again, fmi3Boolean *ending,
    fmi3Boolean *nominals, fmi3Boolean *values, fmi3Boolean *known, fmi3Float64 *next)
{
    Bus *bus = c;
    REQUIRE(bus->mode == EVENT);
    if (evaluate(bus) != fmi3OK)
        return fmi3Error;
    for (int i = 0; i < NODES; i++) {
        Node *node = &bus->node[i];
        node->rx = node->tx = false, node->in_size = node->out_size = 0;
    }
    bus->evaluated = false;
    *again = *ending = *nominals = *values = *known = false;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetIntervalDecimal(fmi3Instance c, const fmi3ValueReference r[], size_t n,
    fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    Bus *bus = c;
    for (size_t i = 0; i < n; i++) {
        REQUIRE(bus->mode == EVENT && (r[i] - 1) % PER_NODE == TX_CLOCK);
        bool *fresh = &bus->fresh[(r[i] - 1) / PER_NODE];
        qualifiers[i] = *fresh ? fmi3IntervalChanged : bus->scheduled ? fmi3IntervalUnchanged : fmi3IntervalNotYetKnown;
        intervals[i] = bus->interval;
        *fresh = false;
    }
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 time, fmi3Float64 size, fmi3Boolean no, fmi3Boolean *event,
    fmi3Boolean *ending, fmi3Boolean *early, fmi3Float64 *last)
{
    Bus *bus = c;
    REQUIRE(bus->mode == STEP);
    *last = time + size;
    *event = *ending = *early = false;
    return fmi3OK;
}
FMI3_Export fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3Float64 v[], size_t m)
{
    for (size_t i = 0; i < n; i++)
        v[i] = r[i] == CARRIED ? ((Bus *)c)->carried : 0.0;
    return fmi3OK;
}
