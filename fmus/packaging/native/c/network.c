#include "network.h"

#include <string.h>

typedef struct {
    int reference, lowest, length, big_endian, is_signed, is_float, presence; /* -1: none; without reference: of no variable */
    double gain, bias, low, high;
} BusSignal;

typedef struct { /* the selector's place, its values in bus_values, and in what it is there itself; -1: always */
    int lowest, length, big_endian, is_signed, first, count, above;
} BusPresence;

typedef struct {
    const char *name;
    uint32_t id, mask;
    int extended, fd, length, first, count, modulus; /* signals, and values of the counter */
    int check, covered, polynomial, start, sealed, data_id; /* of the checksum, over so many bytes; -1: none */
    int pages;
    uint64_t period; /* [ns], 0: it is received */
    const unsigned char *rest; /* of all pages, one after the other */
} BusFrame;

#include "layout_network.h"

enum { CODE_FRAME = 0x10, CODE_FD_FRAME = 0x11, HEAD = 8 };

/* Numbers in bytes, the lowest first */

static void put(Network *bus, uint64_t value, int bytes)
{
    for (int i = 0; i < bytes; i++)
        bus->out[bus->out_size++] = (unsigned char)(value >> (8 * i) & 0xFFu);
}

static uint32_t number(const unsigned char *at, int bytes)
{
    uint32_t value = 0;
    for (int i = bytes - 1; i >= 0; i--)
        value = value << 8 | at[i];
    return value;
}

/* Bits of frames */

static int place_of(const BusSignal *signal, int bit)
{
    if (!signal->big_endian)
        return signal->lowest + bit;
    const int from_front = signal->lowest - bit; /* counted from the first byte's highest bit */
    return (from_front / 8) * 8 + 7 - from_front % 8;
}

static void insert(unsigned char *data, const BusSignal *signal, uint64_t raw)
{
    for (int bit = 0; bit < signal->length; bit++) {
        const int place = place_of(signal, bit);
        const unsigned mask = 1u << (place % 8);
        data[place / 8] = (unsigned char)((raw >> bit & 1u) ? data[place / 8] | mask : data[place / 8] & ~mask);
    }
}

static uint64_t extract(const unsigned char *data, const BusSignal *signal)
{
    uint64_t raw = 0;
    for (int bit = 0; bit < signal->length; bit++) {
        const int place = place_of(signal, bit);
        raw |= (uint64_t)(data[place / 8] >> (place % 8) & 1) << bit;
    }
    return raw;
}

static uint64_t float_bits(double value, int length)
{
    uint64_t raw = 0;
    const float single = (float)value;
    if (length == 64) {
        memcpy(&raw, &value, sizeof value);
    } else {
        uint32_t bits;
        memcpy(&bits, &single, sizeof single);
        raw = bits;
    }
    return raw;
}

static double raw_of(const BusSignal *signal, uint64_t bits)
{
    if (signal->is_float && signal->length == 64) {
        double value;
        memcpy(&value, &bits, sizeof value);
        return value;
    }
    if (signal->is_float) {
        const uint32_t low = (uint32_t)bits;
        float value;
        memcpy(&value, &low, sizeof value);
        return (double)value;
    }
    if (signal->is_signed && signal->length < 64 && bits >> (signal->length - 1))
        bits |= ~UINT64_C(0) << signal->length;
    return signal->is_signed ? (double)(int64_t)bits : (double)bits;
}

static int present(const unsigned char *data, int number)
{
    for (; number >= 0; number = bus_presences[number].above) {
        const BusPresence *one = &bus_presences[number];
        const BusSignal selector = {-1, one->lowest, one->length, one->big_endian, one->is_signed, 0, -1, 1, 0, 0, 0};
        const double raw = raw_of(&selector, extract(data, &selector));
        int i = 0;
        while (i < one->count && bus_values[one->first + i] != raw)
            i++;
        if (i == one->count)
            return 0;
    }
    return 1;
}

static uint64_t bits_of(const BusSignal *signal, double raw)
{
    if (signal->is_float)
        return float_bits(raw, signal->length);
    raw = floor(raw + 0.5);
    if (raw < 0)
        return (uint64_t)(int64_t)raw;
    return raw >= 18446744073709551615.0 ? UINT64_MAX : (uint64_t)raw;
}

static unsigned char checksum(const BusFrame *frame, const unsigned char *data)
{
    unsigned value = (unsigned)frame->start;
    const int first = frame->data_id < 0 ? 0 : -2;
    for (int i = first; i < frame->covered; i++) {
        if (i == frame->check)
            continue;
        value ^= i < 0 ? (unsigned)frame->data_id >> (i == -2 ? 0 : 8) & 0xFFu : data[i];
        for (int bit = 0; bit < 8; bit++)
            value = (value << 1 ^ (value & 0x80u ? (unsigned)frame->polynomial : 0u)) & 0xFFu;
    }
    return (unsigned char)(value ^ (unsigned)frame->sealed);
}

/* Sending */

static double due(const Network *bus, const Instance *it, int frame)
{
    return it->now.start + bus->sent[frame] * (double)bus_frames[frame].period * 1e-9;
}

static void limited(Network *bus, Instance *it, const BusFrame *frame, const BusSignal *signal, double value)
{
    if (!bus->limited)
        instance_warn(it, "'%s' is %g, which frame '%s' cannot hold: it is limited, as others may be",
                      model_variables[signal->reference].name, value, frame->name);
    bus->limited = 1;
}

static void send(Network *bus, Instance *it, int number_of_frame)
{
    const BusFrame *frame = &bus_frames[number_of_frame];
    unsigned char data[64];
    memcpy(data, frame->rest + bus->count[number_of_frame] % (unsigned)frame->pages * (unsigned)frame->length,
           (size_t)frame->length);
    for (int i = frame->first; i < frame->first + frame->count; i++) {
        const BusSignal *signal = &bus_signals[i];
        double value = 0, raw;
        if (!present(data, signal->presence))
            continue;
        if (signal->reference < 0) {
            insert(data, signal, bits_of(signal, signal->low));
            continue;
        }
        instance_get(it, (unsigned)signal->reference, REAL | INTEGER | BOOLEAN | ENUMERATION, &value);
        if (!isfinite(value)) {
            instance_warn(it, "'%s' is %g: frame '%s' is not sent", model_variables[signal->reference].name, value,
                          frame->name);
            return;
        }
        raw = (value - signal->bias) / signal->gain;
        if (raw < signal->low - 0.5 || raw > signal->high + 0.5)
            limited(bus, it, frame, signal, value);
        raw = raw < signal->low ? signal->low : raw > signal->high ? signal->high : raw;
        insert(data, signal, bits_of(signal, raw));
    }
    if (frame->modulus)
        insert(data, &bus_counters[number_of_frame], bus->count[number_of_frame] % (unsigned)frame->modulus);
    if (frame->check >= 0)
        data[frame->check] = checksum(frame, data);
    put(bus, frame->fd ? CODE_FD_FRAME : CODE_FRAME, 4);
    put(bus, (uint64_t)(HEAD + 8 + frame->fd + frame->length), 4);
    put(bus, frame->id, 4);
    put(bus, (uint64_t)frame->extended, 1);
    put(bus, (uint64_t)frame->fd, 1); /* of CAN FD, that it switches the bit rate; else, that it is no remote frame */
    if (frame->fd)
        put(bus, 0, 1);
    put(bus, (uint64_t)frame->length, 2);
    memcpy(bus->out + bus->out_size, data, (size_t)frame->length);
    bus->out_size += (size_t)frame->length;
    bus->count[number_of_frame]++;
}

static void send_due(Network *bus, Instance *it)
{
    for (int i = 0; i < N_FRAMES; i++) {
        const double period = (double)bus_frames[i].period * 1e-9;
        if (bus_frames[i].period && due(bus, it, i) <= it->now.time + 1e-6 * period) {
            send(bus, it, i);
            bus->sent[i]++;
        }
    }
}

/* Receiving */

static void take(Instance *it, const BusFrame *frame, const unsigned char *data)
{
    for (int i = frame->first; i < frame->first + frame->count; i++) {
        const BusSignal *signal = &bus_signals[i];
        const double value = signal->gain * raw_of(signal, extract(data, signal)) + signal->bias;
        if (isfinite(value) && present(data, signal->presence))
            it->now.values[signal->reference] = value;
    }
    it->now.valid = 0;
    it->now.touched = 1;
}

/* Why the data of a frame are not to be trusted, NULL where they are; a counter is compared with that of the last good one */
static const char *distrusted(Network *bus, int number_of_frame, const unsigned char *data)
{
    const BusFrame *frame = &bus_frames[number_of_frame];
    if (frame->check >= 0 && data[frame->check] != checksum(frame, data))
        return "has a wrong checksum";
    if (frame->modulus) {
        const uint64_t count = extract(data, &bus_counters[number_of_frame]);
        const unsigned before = bus->count[number_of_frame];
        if (count >= (uint64_t)frame->modulus)
            return "has a counter that is too large";
        bus->count[number_of_frame] = (unsigned)count + 1;
        if (before == (unsigned)count + 1)
            return "has a counter that stands still";
    }
    return NULL;
}

static void receive(Network *bus, Instance *it, uint32_t code, const unsigned char *at, uint32_t size)
{
    const uint32_t head = HEAD + 8 + (code == CODE_FD_FRAME);
    if ((code != CODE_FRAME && code != CODE_FD_FRAME) || size < head)
        return;
    const uint32_t length = number(at + head - 2, 2);
    if (size < head + length || (code == CODE_FRAME && at[13]))
        return;
    for (int i = 0; i < N_FRAMES; i++) {
        const BusFrame *frame = &bus_frames[i];
        const char *why;
        if (frame->period || (frame->id ^ number(at + HEAD, 4)) & frame->mask || frame->extended != at[12])
            continue;
        if (length < (uint32_t)frame->length)
            instance_warn(it, "frame '%s' has %u of its %d bytes: it is not taken", frame->name, (unsigned)length,
                          frame->length);
        else if ((why = distrusted(bus, i, at + head)) != NULL)
            instance_warn(it, "frame '%s' %s: it is not taken", frame->name, why);
        else
            take(it, frame, at + head);
    }
}

static void receive_all(Network *bus, Instance *it)
{
    size_t at = 0;
    while (bus->in_size - at >= HEAD) {
        const uint32_t size = number(bus->in + at + 4, 4);
        if (size < HEAD || size > bus->in_size - at)
            break;
        receive(bus, it, number(bus->in + at, 4), bus->in + at, size);
        at += size;
    }
    if (at < bus->in_size)
        instance_warn(it, "the last %lu bytes of what was received are no operation", (unsigned long)(bus->in_size - at));
}

/* Clocks and variables */

void network_begin(Network *bus)
{
    memset(bus, 0, sizeof *bus);
}

Status network_tick(Network *bus, Instance *it, unsigned reference)
{
    if (reference == RX_CLOCK) {
        bus->rx = 1;
    } else if (reference == TX_CLOCK) {
        bus->tx = 1;
        bus->told = 0;
        send_due(bus, it);
    } else {
        return instance_error(it, "value reference %u is no clock that can be ticked", reference);
    }
    return STATUS_OK;
}

Status network_get(Network *bus, Instance *it, unsigned reference, size_t *size, const unsigned char **data)
{
    if (reference != TX_DATA || !bus->tx)
        return instance_error(it, "value reference %u is no binary variable that can be got now", reference);
    *size = bus->out_size;
    *data = bus->out;
    return STATUS_OK;
}

Status network_set(Network *bus, Instance *it, unsigned reference, size_t size, const unsigned char *data)
{
    if (reference != RX_DATA || !bus->rx)
        return instance_error(it, "value reference %u is no binary variable that can be set now", reference);
    if (size > sizeof bus->in)
        return instance_error(it, "takes %d bytes at once, not %lu", (int)LONGEST_RECEIVED, (unsigned long)size);
    memcpy(bus->in, data, size);
    bus->in_size = size;
    return STATUS_OK;
}

void network_update(Network *bus, Instance *it)
{
    if (bus->rx)
        receive_all(bus, it);
    if (bus->tx)
        bus->out_size = 0;
    bus->rx = bus->tx = 0;
    bus->in_size = 0;
}

int network_has_interval(unsigned reference)
{
    return reference == TX_CLOCK;
}

int network_interval(Network *bus, const Instance *it, double *interval)
{
    const int fresh = !bus->told;
    double next = INFINITY;
    for (int i = 0; i < N_FRAMES; i++)
        if (bus_frames[i].period)
            next = minimum(next, due(bus, it, i));
    *interval = maximum(0.0, next - it->now.time);
    bus->told = 1;
    return fresh && isfinite(next);
}
