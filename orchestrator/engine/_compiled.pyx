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

include "c_loop/structures.pxi"
include "c_loop/values.pxi"


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
    node.asked = node.version == 2 or node.flags[1][0]
    return True


include "c_loop/events.pxi"


cdef bint _whole(Node *node, double time, double duration, int status) noexcept nogil:
    """Whether a step that the FMU ended, as one that asks to stop may, came to its end."""
    cdef int asked = 0
    if node.version == 2:
        if node.has_asked == NULL:
            return False
        node.reached[0] = time
        (<Asked2>node.has_asked)(node.instance, TERMINATED, &asked)
        (<Reached2>node.has_reached)(node.instance, LAST_TIME, node.reached)
    else:
        asked = status < DISCARD
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
