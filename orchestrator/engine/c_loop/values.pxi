# Values between the loop, whose all are floats, and the memory of FMUs.

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
