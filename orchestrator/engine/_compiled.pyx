# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The stepping loop of `loop.py` for FMUs alone: their functions are called by address, no Python object is touched.

`compiled.py` fills in what is to be stepped and turns a stop into the error of the Python loop. Every operation on a
value is the one that `loop.py` and `fmi.py` do, in the same order, so that the two agree to the last bit.
"""

cimport cython
from cpython.bytearray cimport PyByteArray_AS_STRING
from libc.stdint cimport (
    int8_t, int16_t, int32_t, int64_t, uint8_t, uint16_t, uint32_t, uint64_t, uintptr_t,
)
from libc.stdlib cimport free, realloc
from libc.string cimport memcpy, memmove, memset

from fractions import Fraction

cdef extern from *:
    """
    #include <math.h>
    #include <stdbool.h>
    #include <stddef.h>

    typedef int (*Access2)(void *, const unsigned int *, size_t, void *);
    typedef int (*Access3)(void *, const unsigned int *, size_t, void *, size_t);
    typedef int (*Step2)(void *, double, double, int);
    typedef int (*Asked2)(void *, int, int *);
    typedef int (*Reached2)(void *, int, double *);
    typedef int (*Step3)(void *, double, double, bool, void *, void *, void *, double *);
    typedef int (*Mode3)(void *);
    typedef int (*Tick3)(void *, const unsigned int *, size_t, const void *);
    typedef int (*Ticking3)(void *, const unsigned int *, size_t, void *);
    typedef int (*Intervals3)(void *, const unsigned int *, size_t, double *, int *);
    typedef int (*Update3)(void *, void *, void *, void *, void *, void *, double *);

    #ifdef __GNUC__
    #define fetch(address) __builtin_prefetch(address, 1)
    #define usually(condition) __builtin_expect(condition, 1)
    #else
    #define fetch(address)
    #define usually(condition) (condition)
    #endif

    #ifdef _WIN32
    #include <windows.h>
    static double now(void) {
        LARGE_INTEGER count, frequency;
        QueryPerformanceCounter(&count);
        QueryPerformanceFrequency(&frequency);
        return (double)count.QuadPart / (double)frequency.QuadPart;
    }
    #else
    #include <time.h>
    static double now(void) {
        struct timespec t;
        clock_gettime(CLOCK_MONOTONIC, &t);
        return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
    }
    #endif
    """
    ctypedef int (*Access2)(void *, const unsigned int *, size_t, void *) noexcept nogil
    ctypedef int (*Access3)(void *, const unsigned int *, size_t, void *, size_t) noexcept nogil
    ctypedef int (*Step2)(void *, double, double, int) noexcept nogil
    ctypedef int (*Step3)(void *, double, double, bint, void *, void *, void *, double *) noexcept nogil
    ctypedef int (*Mode3)(void *) noexcept nogil
    ctypedef int (*Tick3)(void *, const unsigned int *, size_t, const void *) noexcept nogil
    ctypedef int (*Ticking3)(void *, const unsigned int *, size_t, void *) noexcept nogil
    ctypedef int (*Intervals3)(void *, const unsigned int *, size_t, double *, int *) noexcept nogil
    ctypedef int (*Update3)(void *, void *, void *, void *, void *, void *, double *) noexcept nogil
    ctypedef int (*Asked2)(void *, int, int *) noexcept nogil
    ctypedef int (*Reached2)(void *, int, double *) noexcept nogil
    double rint(double) noexcept nogil
    double ldexp(double, int) noexcept nogil
    double fabs(double) noexcept nogil
    double INFINITY
    double now() noexcept nogil
    void fetch(const double *) noexcept nogil
    bint usually(bint) noexcept nogil

cpdef enum Storage:
    """How a value lies in memory, the usual ones first; FLAG is a truth value in a C int, BOOL one in a byte."""
    FLOAT64, INT32, FLAG, FLOAT32, BOOL, INT8, UINT8, INT16, UINT16, UINT32, INT64, UINT64

cpdef enum Stage:
    """Where in a component's step the loop stopped; RUNNING where it did not. MISFIT: an input fits not its type.
    VALUE: an output is not finite. ASKED: the FMU has asked to stop before. Of an event: ENTER, TICK, TICKING, UPDATE, INTERVALS, LEAVE where a function failed,
    INTERVAL where a clock is given none that it can have, ENDING where the FMU asks to stop, TURNS and EVENTS where
    there are too many, FLOODED in one step, STUCK where one ends early without getting on."""
    RUNNING, MISFIT, WRITE, STEP, READ, VALUE, ENTER, TICK, UPDATE, LEAVE, ENDING, TURNS, EVENTS, STUCK, FLOODED
    TICKING, INTERVALS, INTERVAL, ASKED

cpdef enum Interval:
    """How a clock that ticks by time comes by its next tick: at one interval, at one that the FMU may change, or each
    time as the FMU tells."""
    STEADY, TUNABLE, CHANGING, COUNTDOWN

ctypedef fused Whole:
    int8_t
    uint8_t
    int16_t
    uint16_t
    int32_t
    uint32_t
    int64_t
    uint64_t

cdef struct Value:
    Storage kind
    void *typed  # where the FMU has it
    double *plain  # where it is a float

cdef struct Values:  # sorted by kind
    const Value *of
    int doubles  # so many FLOAT64 come first
    int usual  # so many are FLOAT64, INT32 or FLAG
    int count

cdef struct Call:  # of a function that gets or sets values of one type
    void *function
    const unsigned int *references
    size_t count
    void *values
    size_t total  # of values; more than references where there are arrays among them
    int width  # of a value [bytes], where it is of a type that can be infinite

cdef struct Calls:
    const Call *of
    int count

cdef struct Part:  # inputs that are set together
    Values packed  # those that the FMU wants in another type or elsewhere
    Calls calls
    const int *places  # among the inputs
    int count
    bint discrete  # set in events only
    bint clocked  # set only when one of these ticks, a bit each
    uint64_t clocks

cdef struct Timed:  # a clock that ticks by time, as the `Timed` of Python
    Interval kind
    int place  # among the input clocks
    int64_t first  # tick n is at (first + n * step) / denominator, where floats are exact up to the `most`th
    int64_t step
    int64_t denominator
    int64_t most
    int64_t number  # of its next tick
    double next
    double last
    bint ticked

cdef struct Arrival:  # ticks on their way
    double time
    int64_t number  # of all that have been on their way, in order
    uint64_t clocks  # of the target, a bit each

cdef struct Route:  # from the output clocks of a node to input clocks of another
    const uint64_t *clocks  # of each output clock, those that it ticks, a bit each
    const Value *brought  # outputs that go with a tick
    const double *scale  # factor and offset of each
    const int *places  # each among the inputs of the target
    int count
    Arrival *waiting  # in order
    double *values  # `count` of each
    size_t first  # of those that wait
    size_t end
    size_t room

cdef struct Event:  # what a node has that is stepped from event to event
    Timed *timed
    int timed_count
    const unsigned int *references  # of its input clocks, in rising order
    int clock_count
    const unsigned int *outputs  # references of its output clocks
    int output_count
    Part *parts
    int part_count
    Route **arriving
    int arriving_count
    Route **leaving
    int leaving_count
    void *enter
    void *tick
    void *ticking
    void *update
    void *intervals
    void *leave
    double *given  # inputs as they are set: those of the step, or what comes with a tick
    double *before  # inputs of the step before
    double next_event
    bint due
    bint in_event
    unsigned int *named  # room for the references of some clocks
    uint8_t *active
    uint8_t *showing  # which output clocks tick
    uint8_t flags[5]
    double told
    int *asked  # places of those clocks that are asked for their intervals
    double *lengths
    int *qualifiers

cdef struct Rate:
    int64_t every
    int64_t next  # tick at which its nodes step next, and at which what they deferred arrives
    Values deferred

cdef struct Node:
    Rate *rate
    int version
    int inputs
    const double **sources
    const double *scale  # factors, then offsets; NULL where there are none
    double *held
    Values packed  # those of `held` that the FMU wants in another type or elsewhere
    Calls writing
    Calls reading
    bint asked  # to stop, at the end of the latest step
    void *instance
    void *step
    const uint64_t *watched  # its outputs, where all are of this type and side by side
    int watched_count
    double duration
    Values instant
    Values late  # its outputs that are not instant
    int64_t countdown  # steps to the next that is timed
    int64_t gap  # from the latest timed one
    int64_t calls
    int64_t warnings
    double seconds
    int64_t accounted  # steps that `seconds` stands for
    uint8_t *flags[3]
    double *reached
    void *has_asked  # FMI 2.0: function that says whether it asked to stop, and the one that says where
    void *has_reached
    Event *event  # NULL without
    void **instance_place  # where the instance is kept, which may be exchanged for a fresh one before a run

cdef enum:
    DISCARD = 2  # status of a step
    TERMINATED = 3  # what FMI 2.0 is asked for: whether the FMU wants to stop, and how far it came
    LAST_TIME = 2
    MOST_TURNS = 100  # of one event
    MOST_EVENTS = 1000  # at one time
    MOST_IN_STEP = 10000000
    CHANGED = 2  # qualifier of an interval that is new
    DIGITS = 15  # every number of so many decimal digits has a float of its own
    AHEAD = 16  # rows between the one that is written and the one whose memory is fetched into the cache

cdef uint64_t EXPONENT = 0x7FF0000000000000  # of a double: all of it is set where the value is not finite
cdef double ALMOST = 1 - 1e-9  # of a step that is whole but for rounding
cdef double TOGETHER = 1e-9  # times that differ by less than this share of a step are one
cdef double ROUNDING = 16 * 2.220446049250313e-16
cdef int64_t WHOLE = <int64_t>1 << 53  # every whole number below is a float
cdef double[DIGITS + 1] TENS
for _ten in range(DIGITS + 1):
    TENS[_ten] = 10.0 ** _ten
cdef double SLOW = 5e-6  # steps longer than this are all timed [s]


cdef double _reading_time() noexcept nogil:
    """What it takes to read the clock [s]."""
    cdef double least = 1.0, begun
    cdef int _
    for _ in range(200):
        begun = now()
        least = min(least, now() - begun)
    return least


cdef double READING = _reading_time()


cdef inline bint _pack_whole(Whole *typed, double plain) noexcept nogil:
    cdef bint signed = <Whole>-1 < 0
    cdef double value = rint(plain), beyond = ldexp(1.0, 8 * <int>sizeof(Whole) - signed)
    if not (-beyond if signed else 0.0) <= value < beyond:
        return False
    typed[0] = <Whole>value
    return True


cdef bint _pack(const Value *value) noexcept nogil:
    """An input into the memory of its type; False where it does not fit."""
    cdef double plain = value.plain[0]
    if value.kind == FLOAT64:
        (<double *>value.typed)[0] = plain
    elif value.kind == FLOAT32:
        (<float *>value.typed)[0] = <float>plain
    elif value.kind == FLAG:
        (<int *>value.typed)[0] = plain != 0.0
    elif value.kind == BOOL:
        (<uint8_t *>value.typed)[0] = plain != 0.0
    elif value.kind == INT8:
        return _pack_whole(<int8_t *>value.typed, plain)
    elif value.kind == UINT8:
        return _pack_whole(<uint8_t *>value.typed, plain)
    elif value.kind == INT16:
        return _pack_whole(<int16_t *>value.typed, plain)
    elif value.kind == UINT16:
        return _pack_whole(<uint16_t *>value.typed, plain)
    elif value.kind == INT32:
        return _pack_whole(<int32_t *>value.typed, plain)
    elif value.kind == UINT32:
        return _pack_whole(<uint32_t *>value.typed, plain)
    elif value.kind == INT64:
        return _pack_whole(<int64_t *>value.typed, plain)
    else:
        return _pack_whole(<uint64_t *>value.typed, plain)
    return True


cdef double _unpacked(const Value *value) noexcept nogil:
    """An output from the memory of its type."""
    if value.kind == FLOAT32:
        return (<float *>value.typed)[0]
    elif value.kind == BOOL:
        return (<uint8_t *>value.typed)[0] != 0
    elif value.kind == INT8:
        return (<int8_t *>value.typed)[0]
    elif value.kind == UINT8:
        return (<uint8_t *>value.typed)[0]
    elif value.kind == INT16:
        return (<int16_t *>value.typed)[0]
    elif value.kind == UINT16:
        return (<uint16_t *>value.typed)[0]
    elif value.kind == UINT32:
        return (<uint32_t *>value.typed)[0]
    elif value.kind == INT64:
        return <double>(<int64_t *>value.typed)[0]
    else:
        return <double>(<uint64_t *>value.typed)[0]


cdef inline void _unpack(const Values *values) noexcept nogil:
    """Let outputs hold."""
    cdef const Value *of = values.of
    cdef int i
    for i in range(values.doubles):
        of[i].plain[0] = (<double *>of[i].typed)[0]
    for i in range(values.doubles, values.usual):
        of[i].plain[0] = (<int32_t *>of[i].typed)[0]
    for i in range(values.usual, values.count):
        of[i].plain[0] = _unpacked(&of[i])


cdef inline int _call(const Node *node, const Call *call) noexcept nogil:
    if usually(node.version == 2):
        return (<Access2>call.function)(node.instance, call.references, call.count, call.values)
    return (<Access3>call.function)(node.instance, call.references, call.count, call.values, call.total)


cdef inline int _call_all(const Node *node, const Calls *calls) noexcept nogil:
    """The worst status."""
    cdef int worst, status, i
    if calls.count == 0:
        return 0
    worst = _call(node, &calls.of[0])
    for i in range(1, calls.count):
        status = _call(node, &calls.of[i])
        worst = max(worst, status)
    return worst


cdef inline bint _finite(const Node *node) noexcept nogil:
    """Whether all outputs are."""
    cdef uint64_t beyond = 0
    cdef int k
    if node.watched == NULL:
        return _got_finite(&node.reading)
    for k in range(node.watched_count):
        beyond |= (node.watched[k] & EXPONENT) == EXPONENT
    return beyond == 0


cdef bint _got_finite(const Calls *calls) noexcept nogil:
    """Whether all values that were got are finite."""
    cdef const Call *call
    cdef double zero = 0.0  # what is not finite makes it NaN
    cdef size_t k
    cdef int i
    for i in range(calls.count):
        call = &calls.of[i]
        if call.width == 8:
            for k in range(call.total):
                zero += 0.0 * (<double *>call.values)[k]
        elif call.width == 4:
            for k in range(call.total):
                zero += 0.0 * (<float *>call.values)[k]
    return zero == 0.0


@cython.final
cdef class Core:
    """A system in C: see `Loop` for what its parts mean. Memory is given by its address, and kept by who gives it.

    Attributes:
        tick: the next tick to take.
        recorded: rows written since the beginning.
        base: number of the row that lies first in the memory for rows.
        stage, status, failing: where a step stopped, with which status, in the node of which number.
        at, span: from when and by how much the step was that failed, or when the event [s].
        ticking: which clocks of the node ticked then, a bit each.
        part: which part of the node's inputs did not fit, -1 for all together.
        clock, interval: the place of a clock among those that tick by time, and what it was given [s].
    """

    cdef readonly int64_t tick
    cdef readonly int64_t recorded
    cdef public int64_t base
    cdef readonly int failing
    cdef readonly int status
    cdef readonly int stage
    cdef readonly double at
    cdef readonly double span
    cdef readonly uint64_t ticking
    cdef readonly int part
    cdef readonly int clock
    cdef readonly double interval
    cdef Route *routes
    cdef int route_count
    cdef int64_t sent  # ticks from one node to another
    cdef dict _timed  # number of a node -> its clocks in Python
    cdef object _raised
    cdef Node *nodes
    cdef Rate *rates
    cdef int node_count
    cdef int rate_count
    cdef list _kept  # owners of the memory that is pointed to
    cdef const double *stimuli
    cdef double *stimulus
    cdef int stimulus_count
    cdef int64_t hold
    cdef int64_t clock_first, clock_step, clock_denominator
    cdef const double **record_outputs
    cdef const double **record_inputs
    cdef int output_count
    cdef int input_count
    cdef double *row  # the next one
    cdef int64_t row_stride, column_stride
    cdef int64_t next_record  # tick of the next row
    cdef int64_t record_every
    cdef double deadline
    cdef bint late
    cdef bint finite  # outputs have to be
    cdef uint64_t dice

    def __init__(self, int capacity, list targets, int64_t hold, clock, list record_outputs, list record_inputs,
                 bint finite):
        self._kept, self.finite = [None], finite
        self._timed, self._raised = {}, None
        self.nodes = <Node *>self._room(capacity * sizeof(Node))
        self.rates = <Rate *>self._room(capacity * sizeof(Rate))
        self.stimulus_count, self.hold = len(targets), hold
        if targets:
            self.stimulus = <double *><uintptr_t>targets[0]
        self.output_count, self.record_outputs = len(record_outputs), self._addresses(record_outputs)
        self.input_count, self.record_inputs = len(record_inputs), self._addresses(record_inputs)
        self.clock_first, self.clock_step, self.clock_denominator = clock

    def add_rate(self, int64_t every, list deferred):
        """The next rate: its nodes step every so many ticks; their deferred outputs as (kind, typed, plain)."""
        cdef Rate *rate = &self.rates[self.rate_count]
        rate.every, rate.deferred = every, self._values(deferred)
        self.rate_count += 1

    def add_node(self, int rate, int version, uintptr_t instance, uintptr_t step, list flags, uintptr_t reached,
                 list asking, double duration, list sources, double[::1] scale, list held, list packed, list writing, list reading, list instant, list late):
        """The next node, of the rate of this number; packed, instant and late as (kind, typed, plain), writing and
        reading as (function, references, count, values, total, width)."""
        cdef Node *node = &self.nodes[self.node_count]
        cdef int i
        node.rate = &self.rates[rate]
        node.version, node.instance_place, node.step, node.duration = version, <void **>instance, <void *>step, duration
        node.reached = <double *>reached
        for i in range(len(flags)):
            node.flags[i] = <uint8_t *><uintptr_t>flags[i]
        if asking:
            node.has_asked, node.has_reached = <void *><uintptr_t>asking[0], <void *><uintptr_t>asking[1]
        node.inputs, node.sources = len(sources), self._addresses(sources)
        if held:
            node.held = <double *><uintptr_t>held[0]
        if scale is not None:
            self._kept.append(scale)
            node.scale = &scale[0]
        node.packed, node.instant, node.late = self._values(packed), self._values(instant), self._values(late)
        node.writing, node.reading = self._calls(writing), self._calls(reading)
        if node.reading.count == 1 and node.reading.of[0].width == sizeof(double):
            node.watched, node.watched_count = <uint64_t *>node.reading.of[0].values, node.reading.of[0].total
        self.node_count += 1

    def add_event(self, int number, list functions, list references, list timed, list outputs, list parts,
                  uintptr_t given):
        """Have a node be stepped from event to event: addresses of its functions; references of its input clocks, in
        rising order; (kind, place among those, `Timed`) of those that tick by time; references of its output clocks;
        its inputs by when they are set, as (packed, calls, places, discrete, clocked, mask); where they are as they
        are set."""
        cdef Node *node = &self.nodes[number]
        cdef Event *event = <Event *>self._room(sizeof(Event))
        cdef uintptr_t enter, tick, ticking, update, intervals, leave
        cdef int i
        enter, tick, ticking, update, intervals, leave = functions
        event.enter, event.tick, event.ticking = <void *>enter, <void *>tick, <void *>ticking
        event.update, event.intervals, event.leave = <void *>update, <void *>intervals, <void *>leave
        event.references, event.clock_count = self._numbers(references), len(references)
        event.outputs, event.output_count = self._numbers(outputs), len(outputs)
        event.showing = <uint8_t *>self._room(len(outputs))
        event.named = <unsigned int *>self._room(len(references) * sizeof(unsigned int))
        event.active = <uint8_t *>self._room(len(references))
        memset(event.active, 1, len(references))
        event.timed = <Timed *>self._room(len(timed) * sizeof(Timed))
        event.timed_count = len(timed)
        event.asked = <int *>self._room(len(timed) * sizeof(int))
        event.lengths = <double *>self._room(len(timed) * sizeof(double))
        event.qualifiers = <int *>self._room(len(timed) * sizeof(int))
        for i in range(len(timed)):
            event.timed[i].kind, event.timed[i].place = timed[i][:2]
        self._timed[number] = [clock for _, _, clock in timed]
        event.parts, event.part_count = <Part *>self._room(len(parts) * sizeof(Part)), len(parts)
        for i, (packed, calls, places, discrete, clocked, mask) in enumerate(parts):
            event.parts[i] = Part(self._values(packed), self._calls(calls), <const int *>self._numbers(places),
                                  len(places), discrete, clocked, mask)
        event.given = <double *>given
        event.before = <double *>self._room(node.inputs * sizeof(double))
        node.event = event

    def add_routes(self, list routes):
        """Have ticks go from node to node: (number of the one that gives, of the one that takes, which input clocks
        of this each output clock ticks, a bit each, and what goes along: (kind, typed, factor, offset, place))."""
        cdef Route *route
        cdef Value *brought
        cdef double *scale
        cdef uint64_t *masks
        cdef Storage kind
        cdef uintptr_t typed
        cdef int i, k
        for n in self._timed:
            self.nodes[<int>n].event.leaving = <Route **>self._room(len(routes) * sizeof(Route *))
            self.nodes[<int>n].event.arriving = <Route **>self._room(len(routes) * sizeof(Route *))
        self.routes = <Route *>self._room(len(routes) * sizeof(Route))
        for i, (source, target, clocks, along) in enumerate(routes):
            route = &self.routes[i]
            masks = <uint64_t *>self._room(len(clocks) * sizeof(uint64_t))
            for k in range(len(clocks)):
                masks[k] = clocks[k]
            brought = <Value *>self._room(len(along) * sizeof(Value))
            scale = <double *>self._room(2 * len(along) * sizeof(double))
            for k, (kind, typed, factor, offset, _) in enumerate(along):
                brought[k], scale[2 * k], scale[2 * k + 1] = Value(kind, <void *>typed, NULL), factor, offset
            route.clocks, route.brought, route.scale, route.count = masks, brought, scale, len(along)
            route.places = <const int *>self._numbers([place for *_, place in along])
            _join(&self.nodes[<int>source].event.leaving, &self.nodes[<int>source].event.leaving_count, route)
            _join(&self.nodes[<int>target].event.arriving, &self.nodes[<int>target].event.arriving_count, route)
            self.route_count += 1

    def expect(self, int number, double time, uint64_t clocks, list values):
        """Have a tick wait on the route of this number, with what goes along."""
        cdef Route *route = &self.routes[number]
        cdef int i
        if route.end == route.room and not _made_room(route):
            raise MemoryError
        route.waiting[route.end] = Arrival(time, self.sent, clocks)
        for i in range(route.count):
            route.values[route.end * route.count + i] = values[i]
        route.end += 1
        self.sent += 1

    def __dealloc__(self):
        for i in range(self.route_count):
            free(self.routes[i].waiting)
            free(self.routes[i].values)

    def load(self, int number, double next_event, bint due, bint in_event, list before):
        """Where the events of a node are: time of the next event [s], whether one is due, whether it is in event mode,
        and its inputs, none where the latest are those of the initialisation; and its clocks are where Python's are."""
        cdef Node *node = &self.nodes[number]
        cdef Event *event = node.event
        cdef int i
        for i in range(event.timed_count):
            _place(&event.timed[i], self._timed[number][i].position)
        event.next_event, event.due, event.in_event = next_event, due, in_event
        for i in range(node.inputs):
            event.before[i] = before[i] if before else node.held[i]

    def unload(self, int number):
        """Have Python's clocks be where those of a node are; time of its next event [s], whether one is due, and
        whether it is in event mode."""
        cdef Event *event = self.nodes[number].event
        for i in range(event.timed_count):
            self._timed[number][i].put(*_position(&event.timed[i]))
        return event.next_event, event.due, event.in_event

    def begin(self, const double[:, ::1] stimuli):
        """Back to the first tick, with a row of stimuli for every `hold` ticks."""
        cdef Node *node
        cdef int n
        self._kept[0] = stimuli
        if self.stimulus_count:
            self.stimuli = &stimuli[0, 0]
        self.tick = self.recorded = self.base = self.next_record = 0
        self.stage, self.part, self.sent = RUNNING, -1, 0
        for n in range(self.route_count):
            self.routes[n].first = self.routes[n].end = 0
        self.dice = 88172645463325252
        for n in range(self.rate_count):
            self.rates[n].next = 0
        for n in range(self.node_count):
            node = &self.nodes[n]
            node.gap = node.countdown = 1
            node.calls = node.warnings = node.accounted = 0
            node.seconds = 0.0
            node.asked = False

    def pass_on(self, bint writing):
        """Have the values that all nodes give hold, in order, each after it was given its inputs; False where one
        stopped."""
        cdef Node *node
        cdef int n
        for n in range(self.node_count):
            node = &self.nodes[n]
            node.instance = node.instance_place[0]
            if not ((not writing or _write(self, node, True)) and _read(self, node)):
                self.failing = n
                return False
            _unpack(&node.instant)
            _unpack(&node.late)
        return True

    cdef char *_room(self, size_t size):
        """Zeros that live as long as this."""
        cdef bytearray memory = bytearray(size)
        self._kept.append(memory)
        return PyByteArray_AS_STRING(memory)

    cdef const double **_addresses(self, list given):
        cdef uintptr_t *addresses = <uintptr_t *>self._room(len(given) * sizeof(uintptr_t))
        cdef int i
        for i in range(len(given)):
            addresses[i] = given[i]
        return <const double **>addresses

    cdef const unsigned int *_numbers(self, given):
        cdef unsigned int *numbers = <unsigned int *>self._room(len(given) * sizeof(unsigned int))
        cdef int i
        for i in range(len(given)):
            numbers[i] = given[i]
        return numbers

    cdef Values _values(self, list given):
        cdef Value *of = <Value *>self._room(len(given) * sizeof(Value))
        cdef Values values = Values(of, 0, 0, len(given))
        cdef Storage kind
        cdef uintptr_t typed, plain
        cdef int i
        for i, (kind, typed, plain) in enumerate(sorted(given)):
            of[i] = Value(kind, <void *>typed, <double *>plain)
            values.doubles += kind == FLOAT64
            values.usual += kind <= FLAG
        return values

    cdef Calls _calls(self, list given):
        cdef Call *of = <Call *>self._room(len(given) * sizeof(Call))
        cdef uintptr_t function, references, values
        cdef size_t count, total
        cdef int i, width
        for i, (function, references, count, values, total, width) in enumerate(given):
            of[i] = Call(<void *>function, <const unsigned int *>references, count, <void *>values, total, width)
        return Calls(of, len(given))

    def run(self, int64_t last, double budget, double[:, :] rows, int64_t record_every):
        """Step towards tick `last` until the rows are full or the budget [s] is used up, then to the tick's end."""
        cdef int64_t full = self.base + rows.shape[0]
        self.row_stride = rows.strides[0] // <int64_t>sizeof(double)
        self.column_stride = rows.strides[1] // <int64_t>sizeof(double)
        self.row = &rows[0, 0] + (self.recorded - self.base) * self.row_stride
        self.record_every = record_every
        with nogil:
            self.deadline = now() + budget
            self.late = False
            while self.tick < last and not self.late and self.recorded < full:
                if not _take_tick(self):
                    break
        if self._raised is not None:
            raised, self._raised = self._raised, None
            raise raised

    def statistics(self, int number):
        """(calls, seconds) of a node since the beginning, and its warnings since this was asked last."""
        cdef Node *node = &self.nodes[number]
        cdef double factor = <double>node.calls / <double>node.accounted if node.accounted else 0.0
        cdef int64_t warnings = node.warnings
        node.warnings = 0
        return node.calls, node.seconds * factor, warnings


cdef inline bint _take_tick(Core core) noexcept nogil:
    """Take a tick, to where the values of the next one have arrived; False where a step stopped."""
    cdef Rate *rate
    cdef double time = <double>(core.clock_first + core.tick * core.clock_step) / <double>core.clock_denominator
    cdef bint recorded = core.tick == core.next_record
    cdef int n
    if core.stimulus_count:
        memcpy(core.stimulus, core.stimuli + core.tick // core.hold * core.stimulus_count,
               core.stimulus_count * sizeof(double))
    if recorded:
        for n in range(core.output_count):
            core.row[n * core.column_stride] = core.record_outputs[n][0]
            fetch(core.row + n * core.column_stride + AHEAD)
    for n in range(core.node_count):
        if core.nodes[n].rate.next == core.tick and not _advance(core, &core.nodes[n], time):
            core.failing = n
            return False
    if recorded:
        for n in range(core.input_count):
            core.row[(core.output_count + n) * core.column_stride] = core.record_inputs[n][0]
        core.row += core.row_stride
        core.recorded += 1
        core.next_record += core.record_every
    core.tick += 1
    for n in range(core.rate_count):
        rate = &core.rates[n]
        if rate.next < core.tick:
            rate.next += rate.every
        if rate.next == core.tick:
            _unpack(&rate.deferred)
    return True


cdef inline bint _advance(Core core, Node *node, double time) noexcept nogil:
    """Take the step of a node that is due; False where it stopped."""
    cdef double begun = 0.0
    node.countdown -= 1
    if node.countdown == 0:
        begun = now()
    if not (_write(core, node, node.event == NULL) and _step(core, node, time) and _read(core, node)):
        return False
    node.calls += 1
    if node.countdown == 0:
        _time(core, node, begun)
    if node.instant.count:
        _unpack(&node.instant)
    if core.finite and not usually(_finite(node)):
        return _stop(core, VALUE, 0)
    return True


cdef inline bint _write(Core core, Node *node, bint everything) noexcept nogil:
    """Set the inputs; not those that wait for an event, unless `everything` is wanted."""
    cdef int i
    if node.inputs == 0:
        return True
    if node.scale == NULL:
        for i in range(node.inputs):
            node.held[i] = node.sources[i][0]
    else:
        for i in range(node.inputs):
            node.held[i] = node.scale[i] * node.sources[i][0] + node.scale[node.inputs + i]
    if usually(everything):
        return _give(core, node, &node.packed, &node.writing)
    memcpy(node.event.given, node.held, node.inputs * sizeof(double))
    for i in range(node.event.part_count):
        if not (node.event.parts[i].discrete or node.event.parts[i].clocked) and not _put(core, node, i):
            return False
    return True


cdef inline bint _give(Core core, Node *node, const Values *packed, const Calls *calls) noexcept nogil:
    """Have the FMU take inputs."""
    cdef int i
    for i in range(packed.count):
        if not _pack(&packed.of[i]):
            return _stop(core, MISFIT, 0)
    return _passes(core, node, WRITE, _call_all(node, calls))


cdef inline bint _put(Core core, Node *node, int number) noexcept nogil:
    """Have the FMU take a part of the inputs."""
    core.part = number
    if not _give(core, node, &node.event.parts[number].packed, &node.event.parts[number].calls):
        return False
    core.part = -1
    return True


cdef inline bint _step(Core core, Node *node, double time) noexcept nogil:
    core.at, core.span = time, node.duration
    if node.asked:
        return _stop(core, ASKED, 0)
    if node.event != NULL:
        return _step_by_events(core, node, time)
    return _do_step(core, node, time, node.duration)


cdef inline bint _do_step(Core core, Node *node, double time, double duration) noexcept nogil:
    """One call of its step function."""
    cdef int status
    cdef bint ended
    if node.version == 2:
        status = (<Step2>node.step)(node.instance, time, duration, 1)
        ended = status == DISCARD
    else:
        status = (<Step3>node.step)(node.instance, time, duration, True, node.flags[0], node.flags[1],
                                    node.flags[2], node.reached)
        ended = node.flags[1][0] or (node.flags[2][0] and node.event == NULL)
    if usually(not ended):
        return _passes(core, node, STEP, status)
    if not _whole(node, time, duration, status):
        return _stop(core, STEP, status)
    node.asked = True
    return True


cdef bint _step_by_events(Core core, Node *node, double time) noexcept nogil:
    """A step from event to event, as `ClockedSlave.step` has it."""
    cdef Event *event = node.event
    cdef double end = time + node.duration, at = time, target, first = 0.0
    cdef double together = max(TOGETHER * node.duration, ROUNDING * fabs(end))
    cdef int i, events = 0, all_events = 0
    event.due = event.due or _changed(node)
    memcpy(event.before, node.held, node.inputs * sizeof(double))
    while at < end - together and not node.asked:
        while event.due or _next(event) <= at + together:
            if events == 0 or at - first > together:
                first, events = at, 0
            events += 1
            core.at = at
            all_events += 1
            if all_events > MOST_IN_STEP:
                return _stop(core, FLOODED, 0)
            if events == MOST_EVENTS:
                return _stop(core, EVENTS, 0)
            if not _event(core, node, at, at + together):
                return False
        target = _next(event)
        if not target < end - together:
            target = end
        core.at, core.span = at, target - at
        if not _do_step(core, node, at, core.span):
            return False
        if node.flags[2][0] and not node.asked:
            if not (node.flags[0][0] or node.reached[0] > at):
                return _stop(core, STUCK, 0)
            target = min(node.reached[0], target)
        event.due = event.due or node.flags[0][0]
        at = target
    return True


cdef inline bint _changed(const Node *node) noexcept nogil:
    """Whether a discrete input without a clock is another than in the step before."""
    cdef const Part *part
    cdef int i, k
    for i in range(node.event.part_count):
        part = &node.event.parts[i]
        if part.discrete and not part.clocked:
            for k in range(part.count):
                if node.held[part.places[k]] != node.event.before[part.places[k]]:
                    return True
    return False


cdef inline double _next(const Event *event) noexcept nogil:
    """Time of its next event that is known."""
    cdef double time = event.next_event
    cdef const Route *route = _first(event)
    cdef int i
    for i in range(event.timed_count):
        time = min(time, event.timed[i].next)
    return time if route == NULL else min(time, route.waiting[route.first].time)


cdef inline Route *_first(const Event *event) noexcept nogil:
    """Where the next tick from another node waits, of those of one time the one that was sent first; NULL where none
    does."""
    cdef Route *found = NULL
    cdef Route *route
    cdef Arrival *one
    cdef Arrival *best
    cdef int i
    for i in range(event.arriving_count):
        route = event.arriving[i]
        if route.first == route.end:
            continue
        if found != NULL:
            one, best = &route.waiting[route.first], &found.waiting[found.first]
            if one.time > best.time or (one.time == best.time and one.number > best.number):
                continue
        found = route
    return found


cdef bint _event(Core core, Node *node, double time, double until) noexcept nogil:
    """An event, as `ClockedSlave._event` has it, with the clocks that tick up to a time."""
    cdef Event *event = node.event
    cdef uint64_t ticking = _due(core, node, until)
    cdef int i, turn
    memcpy(event.given, node.held, node.inputs * sizeof(double))
    ticking |= _arrived(event, until)
    event.due = False
    if not event.in_event:
        if not _passes(core, node, ENTER, (<Mode3>event.enter)(node.instance)):
            return False
        event.in_event = True
    for turn in range(MOST_TURNS):
        if ticking and not _tick(core, node, ticking):
            return False
        for i in range(event.part_count):
            if (not event.parts[i].clocked or event.parts[i].clocks & ticking) and not _put(core, node, i):
                return False
        if event.output_count and not _tell(core, node, time):
            return False
        if not _passes(core, node, UPDATE, (<Update3>event.update)(
                node.instance, &event.flags[0], &event.flags[1], &event.flags[2], &event.flags[3], &event.flags[4],
                &event.told)):
            return False
        if not _learn(core, node, time, ticking):
            return False
        if event.flags[1]:
            return _stop(core, ENDING, 0)
        ticking = _due(core, node, time)
        if not (event.flags[0] or ticking):
            break
    else:
        return _stop(core, TURNS, 0)
    event.next_event = event.told if event.flags[4] else INFINITY
    if not _passes(core, node, LEAVE, (<Mode3>event.leave)(node.instance)):
        return False
    event.in_event = False
    return True


cdef inline uint64_t _due(Core core, Node *node, double until) noexcept nogil:
    """Which clocks tick by time up to a time, a bit each; the next of each is the one after that."""
    cdef Event *event = node.event
    cdef uint64_t ticking = 0
    cdef Timed *clock
    cdef int i
    for i in range(event.timed_count):
        clock = &event.timed[i]
        if not clock.next <= until:
            continue
        ticking |= <uint64_t>1 << clock.place
        if clock.kind <= TUNABLE and clock.number >= clock.most:
            _have(core, node, i, TICKED, 0.0)
            continue
        clock.last, clock.ticked = clock.next, True
        if clock.kind <= TUNABLE:
            clock.number += 1
            clock.next = <double>(clock.first + clock.number * clock.step) / <double>clock.denominator
        else:
            clock.next = INFINITY
    return ticking


cdef inline uint64_t _arrived(Event *event, double until) noexcept nogil:
    """Which clocks the first tick from another node ticks, a bit each; what comes along with it is given. None where
    it is later than a time."""
    cdef Route *route = _first(event)
    cdef Arrival *one
    cdef int i
    if route == NULL or route.waiting[route.first].time > until:
        return 0
    one = &route.waiting[route.first]
    for i in range(route.count):
        event.given[route.places[i]] = route.values[route.first * route.count + i]
    route.first += 1
    return one.clocks


cdef bint _tick(Core core, Node *node, uint64_t ticking) noexcept nogil:
    """Have these clocks tick."""
    cdef Event *event = node.event
    cdef size_t count = 0
    cdef int i
    core.ticking = ticking
    for i in range(event.clock_count):
        if ticking >> i & 1:
            event.named[count] = event.references[i]
            count += 1
    return _passes(core, node, TICK, (<Tick3>event.tick)(node.instance, event.named, count, event.active))


cdef bint _tell(Core core, Node *node, double time) noexcept nogil:
    """Send the ticks of output clocks on their way, with the outputs of now."""
    cdef Event *event = node.event
    cdef bint any_ticks = False
    cdef uint64_t clocks
    cdef int i, k
    if not _passes(core, node, TICKING, (<Ticking3>event.ticking)(
            node.instance, event.outputs, event.output_count, event.showing)):
        return False
    for i in range(event.output_count):
        any_ticks |= event.showing[i] != 0
    if not any_ticks:
        return True
    if not _read(core, node):
        return False
    for k in range(event.leaving_count):
        clocks = 0
        for i in range(event.output_count):
            if event.showing[i]:
                clocks |= event.leaving[k].clocks[i]
        if clocks:
            _send(core, event.leaving[k], time, clocks)
    return True


cdef void _send(Core core, Route *route, double time, uint64_t clocks) noexcept nogil:
    """Have a tick wait at the end of a route."""
    cdef const Value *value
    cdef int i
    if route.end == route.room and not _made_room(route):
        _raise(core, MemoryError)
        return
    route.waiting[route.end] = Arrival(time, core.sent, clocks)
    for i in range(route.count):
        value = &route.brought[i]
        route.values[route.end * route.count + i] = route.scale[2 * i] * _plain(value) + route.scale[2 * i + 1]
    route.end += 1
    core.sent += 1


cdef inline double _plain(const Value *value) noexcept nogil:
    if value.kind == FLOAT64:
        return (<double *>value.typed)[0]
    if value.kind <= FLAG:
        return (<int32_t *>value.typed)[0]
    return _unpacked(value)


cdef bint _made_room(Route *route) noexcept nogil:
    """Make room at the end of a route: where half of it is passed by moving up, else by more."""
    cdef size_t left = route.end - route.first, room = route.room
    cdef Arrival *waiting = route.waiting
    cdef double *values = route.values
    if route.first == 0 or route.first < route.room // 2:
        room = 2 * room + 16
        waiting = <Arrival *>realloc(waiting, room * sizeof(Arrival))
        if waiting == NULL:
            return False
        route.waiting = waiting
        values = <double *>realloc(values, room * (route.count + 1) * sizeof(double))
        if values == NULL:
            return False
        route.values, route.room = values, room
    memmove(waiting, waiting + route.first, left * sizeof(Arrival))
    memmove(values, values + route.first * route.count, left * route.count * sizeof(double))
    route.first, route.end = 0, left
    return True


cdef bint _learn(Core core, Node *node, double time, uint64_t ticked) noexcept nogil:
    """Ask for the intervals that may be new."""
    cdef Event *event = node.event
    cdef int i, count = 0
    cdef Interval kind
    cdef double length
    for i in range(event.timed_count):
        kind = event.timed[i].kind
        if kind == COUNTDOWN or kind == TUNABLE or (kind == CHANGING and ticked >> event.timed[i].place & 1):
            event.asked[count], event.named[count] = i, event.references[event.timed[i].place]
            event.lengths[count], event.qualifiers[count] = 0.0, 0
            count += 1
    if count == 0:
        return True
    if not _passes(core, node, INTERVALS, (<Intervals3>event.intervals)(
            node.instance, event.named, count, event.lengths, event.qualifiers)):
        return False
    for i in range(count):
        if event.qualifiers[i] == CHANGED:
            length, kind = event.lengths[i], event.timed[event.asked[i]].kind
            if not (0.0 <= length < INFINITY) or (length == 0.0 and kind == TUNABLE):
                core.clock, core.interval = event.asked[i], length
                return _stop(core, INTERVAL, 0)
            _take(core, node, event.asked[i], length, time)
    return True


cdef void _take(Core core, Node *node, int number, double interval, double now) noexcept nogil:
    """Give a clock the interval that the FMU tells [s] at a time [s]."""
    cdef Timed *clock = &node.event.timed[number]
    if clock.kind == TUNABLE or not _add(clock.last if clock.kind == CHANGING else now, interval, &clock.next):
        _have(core, node, number, interval, now)


cdef bint _add(double one, double other, double *total) noexcept nogil:
    """The sum of two numbers as they are written in decimals, correctly rounded; False where it needs more digits than
    floats have."""
    cdef double wholes[2]
    cdef int places[2]
    cdef int most
    if not (_decimal(one, &wholes[0], &places[0]) and _decimal(other, &wholes[1], &places[1])):
        return False
    most = max(places[0], places[1])
    wholes[0], wholes[1] = wholes[0] * TENS[most - places[0]], wholes[1] * TENS[most - places[1]]
    if not max(max(fabs(wholes[0]), fabs(wholes[1])), fabs(wholes[0] + wholes[1])) < <double>WHOLE:
        return False
    total[0] = (wholes[0] + wholes[1]) / TENS[most]
    return True


cdef inline bint _decimal(double value, double *whole, int *places) noexcept nogil:
    """A number as whole / 10 ** places, of up to 15 digits; False where it has more."""
    cdef int k
    for k in range(DIGITS + 1):
        whole[0] = rint(value * TENS[k])
        if not fabs(whole[0]) < TENS[DIGITS]:
            return False
        if whole[0] / TENS[k] == value:
            places[0] = k
            return True
    return False


cdef double TICKED = -1.0  # instead of an interval


cdef void _have(Core core, Node *node, int number, double interval, double now) noexcept with gil:
    """Have Python's clock tick, or take an interval, which needs more digits than floats have."""
    cdef Timed *clock = &node.event.timed[number]
    cdef object timed = core._timed[node - core.nodes][number]
    while True:
        try:
            timed.put(*_position(clock))
            if interval == TICKED:
                timed.tick()
            else:
                timed.told(Fraction(repr(interval)), now)
            _place(clock, timed.position)
            return
        except KeyboardInterrupt as wish:  # raised when the tick is over
            core._raised, core.late = wish, True
        except BaseException as problem:
            core._raised, core.late, clock.next = problem, True, INFINITY
            return


cdef void _raise(Core core, kind) noexcept with gil:
    """Have it raised when the tick is over."""
    core._raised, core.late = kind(), True


cdef tuple _position(const Timed *clock):
    """What changes of a clock, as Python's has it."""
    return clock.number, clock.next, clock.last, clock.ticked


cdef _place(Timed *clock, position):
    """Have a clock be where Python's is."""
    first, step, denominator, clock.number, clock.next, clock.last, clock.ticked = position
    clock.most = -1
    if abs(first) < WHOLE and 0 < denominator < WHOLE and step < WHOLE:
        clock.first, clock.step, clock.denominator = first, step, denominator
        clock.most = (WHOLE - 1 - abs(first)) // step


cdef void _join(Route ***list_of, int *count, Route *route) noexcept:
    list_of[0][count[0]] = route
    count[0] += 1


cdef bint _whole(Node *node, double time, double duration, int status) noexcept nogil:
    """Whether a step that the FMU ended because it asks to stop came to its end."""
    cdef int asked = 0
    if node.version == 2:
        if node.has_asked == NULL:
            return False
        node.reached[0] = time
        (<Asked2>node.has_asked)(node.instance, TERMINATED, &asked)
        (<Reached2>node.has_reached)(node.instance, LAST_TIME, node.reached)
    else:
        asked = status < DISCARD and node.flags[1][0]
    return asked and node.reached[0] >= time + duration * ALMOST


cdef inline bint _read(Core core, Node *node) noexcept nogil:
    return _passes(core, node, READ, _call_all(node, &node.reading))


cdef inline bint _passes(Core core, Node *node, Stage stage, int status) noexcept nogil:
    """Whether the loop goes on after this status; warnings are counted."""
    if status == 0:
        return True
    if status == 1:
        node.warnings += 1
        return True
    return _stop(core, stage, status)


cdef bint _stop(Core core, Stage stage, int status) noexcept nogil:
    core.stage, core.status = stage, status
    return False


cdef void _time(Core core, Node *node, double begun) noexcept nogil:
    """Let a timed step stand for those since the last timed one, and choose the next at random.

    Slow steps are all timed; of fast ones one in 17 to 48.
    """
    cdef double ended = now(), spent = ended - begun
    node.seconds += max(spent - READING, 0.0) * <double>node.gap
    node.accounted += node.gap
    core.dice ^= core.dice << 13
    core.dice ^= core.dice >> 7
    core.dice ^= core.dice << 17
    node.gap = 1 if spent > SLOW else 17 + <int64_t>(core.dice & 31)
    node.countdown = node.gap
    core.late = core.late or ended > core.deadline
