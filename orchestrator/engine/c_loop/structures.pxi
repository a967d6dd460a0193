# What the loop steps: components as C has them, the functions of FMUs, and the constants of the loop.

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
    there are too many, FLOODED in one step, STUCK where one ends early and not within it."""
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
