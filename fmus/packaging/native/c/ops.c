#include "ops.h"

#include <stdint.h>

/* A whole number modulo 2^64, negative ones in two's complement. */
static uint64_t wrapped(double x)
{
    const double rest = fmod(trunc(x), 0x1p64);
    return rest < 0 ? (uint64_t)0 - (uint64_t)-rest : (uint64_t)rest;
}

/* SplitMix64's finaliser. */
static uint64_t mix(uint64_t z)
{
    z += UINT64_C(0x9E3779B97F4A7C15);
    z = (z ^ (z >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    z = (z ^ (z >> 27)) * UINT64_C(0x94D049BB133111EB);
    return z ^ (z >> 31);
}

double uniform(double seed, double index)
{
    if (!isfinite(seed) || !isfinite(index))
        return NAN;
    return (double)(mix(mix(wrapped(seed)) ^ wrapped(index)) >> 12) * 0x1p-52 + 0x1p-53;
}

/* The number of samples that do not lie after `time`. */
static size_t passed(const Table *table, double time)
{
    size_t low = 0, high = table->count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (time < table->time[middle])
            high = middle;
        else
            low = middle + 1;
    }
    return low;
}

double playback(const Table *table, double time)
{
    const size_t right = passed(table, time);
    if (right == 0)
        return table->value[0];
    if (right == table->count)
        return table->value[right - 1];
    const double t0 = table->time[right - 1], t1 = table->time[right];
    const double y0 = table->value[right - 1], y1 = table->value[right];
    return y0 + (y1 - y0) * (time - t0) / (t1 - t0);
}

double playback_slope(const Table *table, double time)
{
    const size_t right = passed(table, time);
    if (right == 0 || right == table->count)
        return 0.0;
    return (table->value[right] - table->value[right - 1]) / (table->time[right] - table->time[right - 1]);
}
