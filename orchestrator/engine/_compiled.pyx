# cython: language_level=3, boundscheck=False, wraparound=False, cdivision=True, initializedcheck=False
"""The stepping loop of `loop.py` for FMUs alone: their functions are called by address, no Python object is touched.

`compiled.py` fills in what is to be stepped and turns a stop into the error of the Python loop. Every operation on a
value is the one that `loop.py` and `fmi.py` do, in the same order, so that the two agree to the last bit.
"""

cimport cython
from libc.stdint cimport (
    int8_t, int16_t, int32_t, int64_t, uint8_t, uint16_t, uint32_t, uint64_t, uintptr_t,
)
from libc.stdlib cimport calloc, free
from libc.string cimport memcpy

cdef extern from *:
    """
    #include <math.h>
    #include <stdbool.h>
    #include <stddef.h>

    typedef int (*Access2)(void *, const unsigned int *, size_t, void *);
    typedef int (*Access3)(void *, const unsigned int *, size_t, void *, size_t);
    typedef int (*Step2)(void *, double, double, int);
    typedef int (*Step3)(void *, double, double, bool, void *, void *, void *, double *);

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
    double rint(double) noexcept nogil
    double now() noexcept nogil

cpdef enum Kind:
    """How a value lies in memory; FLAG is a truth value in a C int, BOOL one in a byte."""
    FLOAT64, FLOAT32, INT8, UINT8, INT16, UINT16, INT32, UINT32, INT64, UINT64, FLAG, BOOL

cpdef enum Stage:
    """Where in a component's step the loop stopped; RUNNING where it did not. MISFIT: an input fits not its type."""
    RUNNING, MISFIT, WRITE, STEP, READ

ctypedef fused Whole:
    int8_t
    uint8_t
    int16_t
    uint16_t
    int32_t
    uint32_t
    int64_t
    uint64_t

cdef struct Group:
    Kind kind
    int count
    const unsigned int *references
    void *values
    void *access
    int *places  # NULL where the values are those of the whole channel, as float64
    double low, beyond

cdef struct Node:
    int version
    void *instance
    void *step
    uint8_t *flags[3]
    double *reached
    int inputs
    int *sources
    double *scale  # factors, then offsets; NULL where there are none
    double *held
    int outputs
    int first
    double *staged
    uint8_t *instant
    int deferred  # how many outputs are not instant
    int64_t every
    int64_t next  # tick of its next step, and of the arrival of what is staged
    bint waiting
    double duration
    int written
    int read
    Group *groups  # those written, then those read
    int64_t calls
    int64_t warnings
    double seconds
    int64_t accounted  # steps that `seconds` stands for
    int64_t gap  # steps from the last timed one to the next
    int64_t countdown

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


cdef inline bint _pack_whole(Whole *values, Group *group, const double *held) noexcept nogil:
    cdef int i
    cdef double value
    for i in range(group.count):
        value = rint(held[group.places[i]])
        if not group.low <= value < group.beyond:
            return False
        values[i] = <Whole>value
    return True


cdef inline void _unpack_whole(const Whole *values, Group *group, double *staged) noexcept nogil:
    cdef int i
    for i in range(group.count):
        staged[group.places[i]] = <double>values[i]


cdef bint _pack(Group *group, const double *held) noexcept nogil:
    """Inputs into the memory of their type; False where one does not fit."""
    cdef int i
    if group.places == NULL:
        return True
    if group.kind == FLOAT64:
        for i in range(group.count):
            (<double *>group.values)[i] = held[group.places[i]]
    elif group.kind == FLOAT32:
        for i in range(group.count):
            (<float *>group.values)[i] = <float>held[group.places[i]]
    elif group.kind == FLAG:
        for i in range(group.count):
            (<int *>group.values)[i] = held[group.places[i]] != 0.0
    elif group.kind == BOOL:
        for i in range(group.count):
            (<uint8_t *>group.values)[i] = held[group.places[i]] != 0.0
    elif group.kind == INT8:
        return _pack_whole(<int8_t *>group.values, group, held)
    elif group.kind == UINT8:
        return _pack_whole(<uint8_t *>group.values, group, held)
    elif group.kind == INT16:
        return _pack_whole(<int16_t *>group.values, group, held)
    elif group.kind == UINT16:
        return _pack_whole(<uint16_t *>group.values, group, held)
    elif group.kind == INT32:
        return _pack_whole(<int32_t *>group.values, group, held)
    elif group.kind == UINT32:
        return _pack_whole(<uint32_t *>group.values, group, held)
    elif group.kind == INT64:
        return _pack_whole(<int64_t *>group.values, group, held)
    else:
        return _pack_whole(<uint64_t *>group.values, group, held)
    return True


cdef void _unpack(Group *group, double *staged) noexcept nogil:
    """Outputs from the memory of their type."""
    cdef int i
    if group.places == NULL:
        return
    if group.kind == FLOAT64:
        for i in range(group.count):
            staged[group.places[i]] = (<double *>group.values)[i]
    elif group.kind == FLOAT32:
        for i in range(group.count):
            staged[group.places[i]] = (<float *>group.values)[i]
    elif group.kind == BOOL:
        for i in range(group.count):
            staged[group.places[i]] = (<uint8_t *>group.values)[i] != 0
    elif group.kind == INT8:
        _unpack_whole(<int8_t *>group.values, group, staged)
    elif group.kind == UINT8:
        _unpack_whole(<uint8_t *>group.values, group, staged)
    elif group.kind == INT16:
        _unpack_whole(<int16_t *>group.values, group, staged)
    elif group.kind == UINT16:
        _unpack_whole(<uint16_t *>group.values, group, staged)
    elif group.kind == INT32 or group.kind == FLAG:
        _unpack_whole(<int32_t *>group.values, group, staged)
    elif group.kind == UINT32:
        _unpack_whole(<uint32_t *>group.values, group, staged)
    elif group.kind == INT64:
        _unpack_whole(<int64_t *>group.values, group, staged)
    else:
        _unpack_whole(<uint64_t *>group.values, group, staged)


cdef inline int _access(Node *node, Group *group) noexcept nogil:
    if node.version == 2:
        return (<Access2>group.access)(node.instance, group.references, group.count, group.values)
    return (<Access3>group.access)(node.instance, group.references, group.count, group.values, group.count)


cdef inline int _access_all(Node *node, int first, int count) noexcept nogil:
    """The worst status of some groups."""
    cdef int g, status, worst
    if count == 0:
        return 0
    worst = _access(node, &node.groups[first])
    for g in range(first + 1, first + count):
        status = _access(node, &node.groups[g])
        worst = max(worst, status)
    return worst


cdef inline bint _passes(Node *node, int status) noexcept nogil:
    """Whether the loop goes on after this status; warnings are counted."""
    node.warnings += status == 1
    return status == 0 or status == 1


@cython.final
cdef class Core:
    """A system in C: see `Loop` for what its parts mean.

    Attributes:
        tick: the next tick to take.
        recorded: rows written since the beginning.
        base: number of the row that lies first in the memory for rows.
        stage, status, failing: where a step stopped, with which status, in the node of which number.
    """

    cdef readonly int64_t tick
    cdef readonly int64_t recorded
    cdef public int64_t base
    cdef readonly int failing
    cdef readonly int status
    cdef readonly int stage
    cdef Node *nodes
    cdef int count
    cdef int capacity
    cdef list _kept  # owners of the memory that is pointed to
    cdef double *values
    cdef const double *stimuli
    cdef int stimulus_count
    cdef int first_stimulus
    cdef int64_t hold
    cdef int64_t clock_first, clock_each, clock_denominator
    cdef const int *record_slots
    cdef int slot_count
    cdef const int *record_inputs  # (node, input) pairs
    cdef int input_count
    cdef double *row
    cdef int64_t next_record  # tick of the next row
    cdef double deadline
    cdef bint late
    cdef uint64_t dice

    def __cinit__(self, int capacity, *arguments):
        self.nodes = <Node *>calloc(max(capacity, 1), sizeof(Node))
        if self.nodes == NULL:
            raise MemoryError
        self.capacity = capacity
        self._kept = []

    def __init__(self, int capacity, double[::1] values, stimuli, clock, int[::1] record_slots,
                 int[:, ::1] record_inputs):
        cdef const double[:, ::1] samples
        samples, self.first_stimulus, self.hold = stimuli
        self._kept += [values, samples, record_slots, record_inputs]
        self.stimulus_count = samples.shape[1]
        self.slot_count, self.input_count = record_slots.shape[0], record_inputs.shape[0]
        self.values = &values[0] if values.shape[0] else NULL
        self.stimuli = &samples[0, 0] if samples.shape[1] else NULL
        self.record_slots = &record_slots[0] if self.slot_count else NULL
        self.record_inputs = &record_inputs[0, 0] if self.input_count else NULL
        self.clock_first, self.clock_each, self.clock_denominator = clock
        self.dice = 88172645463325252

    def __dealloc__(self):
        cdef int n
        for n in range(self.count):
            free(self.nodes[n].groups)
        free(self.nodes)

    def add(self, int version, uintptr_t instance, uintptr_t step, flags, int64_t every, double duration,
            int[::1] sources, scale, uintptr_t held, int first, uint8_t[::1] instant, uintptr_t staged, written, read):
        """The next node; groups are (kind, count, references, values, access, places or None, low, beyond)."""
        if self.count == self.capacity:
            raise IndexError("no room for another node")
        cdef Node *node = &self.nodes[self.count]
        cdef double[::1] factors
        cdef int i
        self._kept += [sources, scale, instant]
        node.version, node.instance, node.step = version, <void *>instance, <void *>step
        if version == 3:
            for i in range(3):
                node.flags[i] = <uint8_t *><uintptr_t>flags[i]
            node.reached = <double *><uintptr_t>flags[3]
        node.every, node.duration = every, duration
        node.inputs = len(sources)
        node.sources = &sources[0] if node.inputs else NULL
        if scale is not None:
            factors = scale
            node.scale = &factors[0]
        node.held, node.staged = <double *>held, <double *>staged
        node.outputs, node.first = len(instant), first
        node.instant = &instant[0] if node.outputs else NULL
        for i in range(node.outputs):
            node.deferred += not instant[i]
        node.gap = node.countdown = 1
        node.groups = <Group *>calloc(max(len(written) + len(read), 1), sizeof(Group))
        if node.groups == NULL:
            raise MemoryError
        self.count += 1
        for group in written:
            self._group(&node.groups[node.written], group)
            node.written += 1
        for group in read:
            self._group(&node.groups[node.written + node.read], group)
            node.read += 1

    cdef _group(self, Group *group, given):
        cdef int[::1] places
        group.kind = given[0]
        group.count = given[1]
        group.references = <const unsigned int *><uintptr_t>given[2]
        group.values = <void *><uintptr_t>given[3]
        group.access = <void *><uintptr_t>given[4]
        if given[5] is not None:
            places = given[5]
            group.places = &places[0]
        group.low, group.beyond = given[6], given[7]
        self._kept.append(given)

    def run(self, int64_t last, double budget, double[:, ::1] rows, int64_t record_every):
        """Step towards tick `last` until the rows are full or the budget [s] is used up, then to the tick's end."""
        cdef int64_t columns = rows.shape[1], full = self.base + rows.shape[0]
        self.row = &rows[0, 0] + (self.recorded - self.base) * columns if columns else NULL
        with nogil:
            self.deadline = now() + budget
            self.late = False
            while self.tick < last and not self.late and self.recorded < full:
                if not self._take_tick():
                    break
                if self.tick == self.next_record:
                    self.next_record += record_every
                    self.recorded += 1
                    self.row += columns
                self.tick += 1

    def statistics(self, int number):
        """(calls, seconds, warnings) of a node since the beginning."""
        cdef Node *node = &self.nodes[number]
        cdef double factor = <double>node.calls / <double>node.accounted if node.accounted else 0.0
        return node.calls, node.seconds * factor, node.warnings

    def arrival(self, int number):
        """The tick at which what a node has staged arrives; None where nothing waits."""
        cdef Node *node = &self.nodes[number]
        return node.next if node.waiting and node.deferred else None

    cdef inline bint _take_tick(self) noexcept nogil:
        cdef Node *node
        cdef double time
        cdef int n
        self._arrive()
        if self.tick == self.next_record:
            for n in range(self.slot_count):
                self.row[n] = self.values[self.record_slots[n]]
        time = <double>(self.clock_first + self.tick * self.clock_each) / <double>self.clock_denominator
        for n in range(self.count):
            node = &self.nodes[n]
            if node.next == self.tick and not self._advance(node, time):
                self.failing = n
                return False
        if self.tick == self.next_record:
            for n in range(self.input_count):
                node = &self.nodes[self.record_inputs[2 * n]]
                self.row[self.slot_count + n] = node.held[self.record_inputs[2 * n + 1]]
        return True

    cdef inline void _arrive(self) noexcept nogil:
        cdef Node *node
        cdef int n, i
        for n in range(self.count):
            node = &self.nodes[n]
            if node.waiting and node.next == self.tick:
                node.waiting = False
                if node.deferred == node.outputs:
                    memcpy(self.values + node.first, node.staged, node.outputs * sizeof(double))
                else:
                    for i in range(node.outputs):
                        if not node.instant[i]:
                            self.values[node.first + i] = node.staged[i]
        if self.stimulus_count:
            memcpy(self.values + self.first_stimulus, self.stimuli + self.tick // self.hold * self.stimulus_count,
                   self.stimulus_count * sizeof(double))

    cdef inline bint _advance(self, Node *node, double time) noexcept nogil:
        """Take the step of a node that is due; False where it stopped."""
        cdef double begun = 0.0
        cdef int i
        node.countdown -= 1
        if node.countdown == 0:
            begun = now()
        if not (self._write(node) and self._step(node, time) and self._read(node)):
            return False
        node.calls += 1
        if node.countdown == 0:
            self._time(node, begun)
        if node.deferred < node.outputs:
            for i in range(node.outputs):
                if node.instant[i]:
                    self.values[node.first + i] = node.staged[i]
        node.waiting = node.deferred > 0
        node.next = self.tick + node.every
        return True

    cdef void _time(self, Node *node, double begun) noexcept nogil:
        """Let a timed step stand for those since the last timed one, and choose the next at random.

        Slow steps are all timed; of fast ones one in 17 to 48.
        """
        cdef double ended = now(), spent = ended - begun
        node.seconds += max(spent - READING, 0.0) * <double>node.gap
        node.accounted += node.gap
        self.dice ^= self.dice << 13
        self.dice ^= self.dice >> 7
        self.dice ^= self.dice << 17
        node.gap = 1 if spent > SLOW else 17 + <int64_t>(self.dice & 31)
        node.countdown = node.gap
        self.late = self.late or ended > self.deadline

    cdef inline bint _write(self, Node *node) noexcept nogil:
        cdef int i
        if node.inputs == 0:
            return True
        if node.scale == NULL:
            for i in range(node.inputs):
                node.held[i] = self.values[node.sources[i]]
        else:
            for i in range(node.inputs):
                node.held[i] = node.scale[i] * self.values[node.sources[i]] + node.scale[node.inputs + i]
        for i in range(node.written):
            if not _pack(&node.groups[i], node.held):
                self.stage = MISFIT
                return False
        self.status = _access_all(node, 0, node.written)
        self.stage = WRITE
        return _passes(node, self.status)

    cdef inline bint _step(self, Node *node, double time) noexcept nogil:
        self.stage = STEP
        if node.version == 2:
            self.status = (<Step2>node.step)(node.instance, time, node.duration, 1)
            return _passes(node, self.status)
        self.status = (<Step3>node.step)(node.instance, time, node.duration, True, node.flags[0], node.flags[1],
                                         node.flags[2], node.reached)
        if node.flags[1][0] or node.flags[2][0]:
            return False
        return _passes(node, self.status)

    cdef inline bint _read(self, Node *node) noexcept nogil:
        cdef int i
        self.status = _access_all(node, node.written, node.read)
        self.stage = READ
        if not _passes(node, self.status):
            return False
        for i in range(node.written, node.written + node.read):
            _unpack(&node.groups[i], node.staged)
        self.stage = RUNNING
        return True
