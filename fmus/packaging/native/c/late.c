#include "late.h"

#include <string.h>

enum { ROWS = LONGEST_HISTORY + 2 };

/* Tangents of a history: a row for each of its values, then what acts, then a place to exchange with the input's. */
static double *tangents_of(Instance *it, int delay, int at)
{
    const Tangents *of = &it->tangents;
    return of->late + ((size_t)delay * (ROWS + 1) + (size_t)at) * of->width;
}

size_t late_room(size_t width)
{
    return (size_t)N_DELAYS * (ROWS + 1) * width;
}

static size_t bytes(const Instance *it)
{
    return it->tangents.width * sizeof(double);
}

static double *tangents_of_input(Instance *it, int delay)
{
    return it->tangents.known + (size_t)model_delays[delay].input * it->tangents.width;
}

void late_begin(Instance *it)
{
    for (int i = 0; i < N_DELAYS; i++)
        it->now.late[i].count = 0;
    it->now.duration = 0.0;
    it->now.touched = 1;
}

/* How long each value holds between two instants; what comes back is how long none does yet. Parts of the whole. */
static double mean_weights(const History *h, double start, double stop, double weights[])
{
    if (!(stop > start)) {
        int last = 0;
        for (int i = 0; i < h->count; i++) {
            weights[i] = 0.0;
            if (h->time[i] <= start)
                last = i;
        }
        weights[last] = 1.0;
        return start < h->time[0];
    }
    for (int i = 0; i < h->count; i++) {
        const double begins = i == 0 ? start : maximum(h->time[i], start);
        const double ends = i + 1 == h->count ? stop : minimum(h->time[i + 1], stop);
        weights[i] = maximum(ends - begins, 0.0) / (stop - start);
    }
    return maximum(minimum(h->time[0], stop) - start, 0.0) / (stop - start);
}

/* Add a factor times the weights of the slope there: of the parabola through three values, a line through two. */
static void add_slope(const History *h, int at, double factor, double weights[])
{
    const int size = h->count < 3 ? h->count : 3;
    const int last = h->count - size;
    const int first = at < 1 ? 0 : at - 1 > last ? last : at - 1;
    for (int i = 0; i < size; i++) {
        double slope = size == 3 ? 0.0 : 1.0;
        for (int j = 0; size == 3 && j < size; j++)
            if (j != i)
                slope += h->time[at] - h->time[first + j];
        for (int j = 0; j < size; j++)
            if (j != i)
                slope /= h->time[first + i] - h->time[first + j];
        weights[first + i] += factor * slope;
    }
}

/* Of the cubic through the values around an instant, with slopes by parabolas; the first one before all. */
static void curve_weights(const History *h, double instant, double weights[])
{
    memset(weights, 0, (size_t)h->count * sizeof *weights);
    if (h->count == 1 || instant <= h->time[0]) {
        weights[0] = 1.0;
        return;
    }
    int left = h->count - 2;
    while (left > 0 && h->time[left] > instant)
        left--;
    const double width = h->time[left + 1] - h->time[left], s = (instant - h->time[left]) / width;
    weights[left] += (1 + 2 * s) * (1 - s) * (1 - s);
    weights[left + 1] += s * s * (3 - 2 * s);
    add_slope(h, left, width * s * (1 - s) * (1 - s), weights);
    add_slope(h, left + 1, width * s * s * (s - 1), weights);
}

/* See what acts over a step, by the history as it is. */
static void act(Instance *it, int delay, double time, double duration)
{
    const Delay *names = &model_delays[delay];
    const double *v = it->now.values;
    History *h = &it->now.late[delay];
    double weights[ROWS], share = 0.0;
    const double start = time - v[names->seconds];
    if (v[names->shape] > 1.5)
        curve_weights(h, start + duration, weights);
    else
        share = mean_weights(h, start, start + duration, weights);
    h->acts = share * v[names->before];
    for (int i = 0; i < h->count; i++)
        h->acts += weights[i] * h->value[i];
    if (!it->tangents.directions)
        return;
    double *acts = tangents_of(it, delay, ROWS - 1);
    memset(acts, 0, bytes(it));
    for (int i = 0; i < h->count; i++)
        for (size_t d = 0; weights[i] != 0.0 && d < it->tangents.width; d++)
            acts[d] += weights[i] * tangents_of(it, delay, i)[d];
}

static void drop(Instance *it, int delay, int rows)
{
    History *h = &it->now.late[delay];
    h->count -= rows;
    memmove(h->time, h->time + rows, (size_t)h->count * sizeof *h->time);
    memmove(h->value, h->value + rows, (size_t)h->count * sizeof *h->value);
    if (it->tangents.directions)
        memmove(tangents_of(it, delay, 0), tangents_of(it, delay, rows), (size_t)h->count * bytes(it));
}

/* Append the input as it is now; at the instant of the last value in its place. */
static void append(Instance *it, int delay, double time)
{
    History *h = &it->now.late[delay];
    if (h->count && h->time[h->count - 1] >= time)
        h->count--;
    h->time[h->count] = time;
    h->value[h->count] = it->now.values[model_delays[delay].input];
    if (it->tangents.directions)
        memcpy(tangents_of(it, delay, h->count), tangents_of_input(it, delay), bytes(it));
    h->count++;
}

const char *late_arrive(Instance *it, double time, double duration)
{
    for (int i = 0; i < N_DELAYS; i++) {
        History *h = &it->now.late[i];
        const double start = time - it->now.values[model_delays[i].seconds];
        int gone = 0;
        while (h->count - gone > 2 && h->time[gone + 2] <= start)
            gone++;
        drop(it, i, gone);
        append(it, i, time);
        if (h->count > LONGEST_HISTORY)
            return model_variables[model_delays[i].input].name;
        act(it, i, time, duration);
    }
    it->now.duration = duration;
    it->now.touched = 0;
    return NULL;
}

void late_foresee(Instance *it)
{
    Snapshot *s = &it->now;
    if (!s->touched)
        return;
    for (int i = 0; i < N_DELAYS; i++) {
        History *h = &s->late[i];
        const int count = h->count, replaced = count && h->time[count - 1] >= s->time;
        const double time = h->time[count ? count - 1 : 0], value = h->value[count ? count - 1 : 0];
        append(it, i, s->time);
        act(it, i, s->time, s->duration);
        h->count = count;
        if (replaced) {
            h->time[count - 1] = time;
            h->value[count - 1] = value;
        }
    }
}

static void exchange(Instance *it)
{
    for (int i = 0; i < N_DELAYS; i++) {
        double *value = &it->now.values[model_delays[i].input], *acts = &it->now.late[i].acts, kept = *value;
        *value = *acts;
        *acts = kept;
        if (!it->tangents.directions)
            continue;
        double *row = tangents_of_input(it, i), *other = tangents_of(it, i, ROWS - 1), *spare = tangents_of(it, i, ROWS);
        memcpy(spare, row, bytes(it));
        memcpy(row, other, bytes(it));
        memcpy(other, spare, bytes(it));
    }
}

void late_enter(Instance *it)
{
    exchange(it);
}

void late_leave(Instance *it)
{
    exchange(it);
}
