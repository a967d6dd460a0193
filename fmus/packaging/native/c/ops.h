/* The functions that generated equations call beside those of math.h; each is the one of that name in fmus/ops.py. */
#ifndef OPS_H
#define OPS_H

#include <math.h>
#include <stddef.h>

/* Samples over time: linear in between, the end values outside. `time` increases strictly. */
typedef struct {
    size_t count;
    double *time;
    double *value;
} Table;

static inline double minimum(double a, double b) { return a < b ? a : b; }
static inline double maximum(double a, double b) { return a > b ? a : b; }
static inline double sign(double x) { return (double)((x > 0) - (x < 0)); }
static inline double square(double x) { return x * x; }

/* Sum of the products of two vectors, added from the first on. */
static inline double dot(size_t count, const double *a, const double *b)
{
    double sum = a[0] * b[0];
    for (size_t i = 1; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

/* A number in (0, 1) that depends only on seed and index. */
double uniform(double seed, double index);

/* A table's value at a time, and the slope of the piece it lies on. */
double playback(const Table *table, double time);
double playback_slope(const Table *table, double time);

#endif
