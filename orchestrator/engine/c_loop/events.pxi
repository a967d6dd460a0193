# Steps from event to event, and clocks, as `clocked_slave.py` and `ticking/` have them.

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
            if not _gets_on(node, at, target, together):
                return _stop(core, STUCK, 0)
            target = min(node.reached[0], target)
        event.due = event.due or node.flags[0][0]
        at = target
    return True


cdef inline bint _gets_on(const Node *node, double at, double target, double together) noexcept nogil:
    """Whether a step that ended early did so within it; with an event that may be at once."""
    cdef double reached = node.reached[0]
    return (reached > at or (node.flags[0][0] and reached >= at - together)) and reached <= target + together


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
