#include "instance.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "derivatives.h"
#include "late.h"
#include "resources.h"

#define EARLY 1e-6 /* of a sample period: how far rounding may put a step's end before or after a sampling instant */
#define MOST_INNER_STEPS 1e15

enum { OUTPUTS_VALID = 1, RATES_VALID = 2 };
enum { MOST_NAMED = 8 }; /* parameters that do not fit together */

/* Life cycle */

Status instance_open(Instance *it, const char *token, const char *resources)
{
    Problem problem;
    if (!instance_belongs(it, token, resources))
        return STATUS_ERROR;
    for (int i = 0; i < N_VARIABLES; i++)
        it->defaults[i] = model_variables[i].start;
    if (read_defaults(resources, it->defaults, &problem) || read_tables(resources, it->tables, &problem))
        return instance_error(it, "%s", problem.text);
    instance_event(it, "defaults are those of %.400s", resources);
    instance_reset(it);
    return STATUS_OK;
}

void instance_close(Instance *it)
{
    free_tables(it->tables);
    instance_carry(it, 0);
}

void instance_reset(Instance *it)
{
    instance_carry(it, 0);
    memset(&it->now, 0, sizeof it->now);
    memcpy(it->now.values, it->defaults, sizeof it->defaults);
    it->now.mode = INSTANTIATED;
    instance_begin(it, 0.0);
}

Status instance_begin(Instance *it, double time)
{
    Snapshot *s = &it->now;
    if (!isfinite(time))
        return instance_error(it, "the start time is not finite");
    s->time = s->start = time;
    s->samples = 0;
    s->stepped = 0;
    s->valid = 0;
    late_begin(it);
    for (int i = 0; i < N_STATES; i++) {
        const State *state = &model_states[i];
        s->values[state->value] = state->parameter < 0 ? state->start : s->values[state->parameter];
    }
    if (it->tangents.directions)
        tangents_begin(it);
    return STATUS_OK;
}

Status instance_run(Instance *it)
{
    const double *v = it->now.values;
    const int *about = NULL;
    char given[400] = "";
    const char *conflict = model_conflict(v, it->tables, &about);
    if (!conflict)
        return STATUS_OK;
    size_t end = 0;
    for (int i = 0; about[i] >= 0 && i <= MOST_NAMED && end < sizeof given; i++)
        end += (size_t)(i < MOST_NAMED ? snprintf(given + end, sizeof given - end, "%s%s = %g", i ? ", " : "",
                                                  model_variables[about[i]].name, v[about[i]])
                                       : snprintf(given + end, sizeof given - end, ", ..."));
    return instance_refuse(it, "%s: %s", given, conflict);
}

/* Values */

static void evaluate_outputs(Instance *it)
{
    Snapshot *s = &it->now;
    if (s->valid & OUTPUTS_VALID)
        return;
    late_foresee(it);
    late_enter(it);
    model_outputs(s->time, s->values, it->tables);
    late_leave(it);
    s->valid |= OUTPUTS_VALID;
}

static void evaluate_rates(Instance *it)
{
    Snapshot *s = &it->now;
    if (s->valid & RATES_VALID)
        return;
    double constants[N_CONSTANTS + 1];
    model_constants(s->values, constants);
    model_derivatives(s->time, s->values, it->tables, constants, &s->values[FIRST_RATE]);
    s->valid |= RATES_VALID;
}

Status instance_get(Instance *it, unsigned reference, int types, double *value)
{
    const Variable *variable = instance_find(it, reference, types);
    if (!variable)
        return STATUS_ERROR;
    if (variable->role == OUTPUT)
        evaluate_outputs(it);
    else if (variable->role == RATE)
        evaluate_rates(it);
    *value = variable->role == TIME ? it->now.time : it->now.values[reference];
    return STATUS_OK;
}

/* States at their start values follow their parameter. */
static void follow(Instance *it, int parameter)
{
    for (int i = 0; i < N_STATES; i++)
        if (model_states[i].parameter == parameter)
            it->now.values[model_states[i].value] = it->now.values[parameter];
}

Status instance_set(Instance *it, unsigned reference, int types, double value)
{
    const Variable *variable = instance_find(it, reference, types);
    if (!variable)
        return STATUS_ERROR;
    const char *problem = instance_obstacle(it, variable);
    if (problem)
        return instance_error(it, "'%s' %s", variable->name, problem);
    it->now.values[reference] = value;
    it->now.valid = 0;
    it->now.touched |= variable->role == INPUT;
    if (variable->role == PARAMETER)
        follow(it, (int)reference);
    return STATUS_OK;
}

/* Stepping */

static Status check_requirements(Instance *it, double time)
{
    const char *refusal = model_refusal(time, it->now.values, it->tables);
    return refusal ? instance_fail(it, "%s", refusal) : STATUS_OK;
}

static Status prepare(Instance *it, double time)
{
    Snapshot *s = &it->now;
    if (check_requirements(it, time))
        return STATUS_ERROR;
    s->longest = N_CONTINUOUS > 0 ? model_solver_step(s->values, it->tables) : INFINITY;
    if (!(s->longest > 0))
        return instance_fail(it, "the solver's step would be %g s", s->longest);
    if (N_CONTINUOUS > 0)
        instance_event(it, "inner steps are at most %g s long", s->longest);
    s->stepped = 1;
    return STATUS_OK;
}

static void runge_kutta(Instance *it, const double *constants, double t, double h)
{
    double *v = it->now.values;
    double start[N_CONTINUOUS + 1], k1[N_CONTINUOUS + 1], k2[N_CONTINUOUS + 1], k3[N_CONTINUOUS + 1],
        k4[N_CONTINUOUS + 1];
    for (int i = 0; i < N_CONTINUOUS; i++)
        start[i] = v[model_continuous[i]];
    model_derivatives(t, v, it->tables, constants, k1);
    for (int i = 0; i < N_CONTINUOUS; i++)
        v[model_continuous[i]] = start[i] + 0.5 * h * k1[i];
    model_derivatives(t + 0.5 * h, v, it->tables, constants, k2);
    for (int i = 0; i < N_CONTINUOUS; i++)
        v[model_continuous[i]] = start[i] + 0.5 * h * k2[i];
    model_derivatives(t + 0.5 * h, v, it->tables, constants, k3);
    for (int i = 0; i < N_CONTINUOUS; i++)
        v[model_continuous[i]] = start[i] + h * k3[i];
    model_derivatives(t + h, v, it->tables, constants, k4);
    for (int i = 0; i < N_CONTINUOUS; i++)
        v[model_continuous[i]] = start[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
}

static Status integrate(Instance *it, double time, double duration)
{
    if (N_CONTINUOUS == 0 || !(duration > 0))
        return STATUS_OK;
    const double count = maximum(1.0, ceil(duration / it->now.longest - 1e-9));
    const double inner = duration / count;
    if (!(count <= MOST_INNER_STEPS))
        return instance_fail(it, "a step of %g s needs %g inner steps", duration, count);
    double constants[N_CONSTANTS + 1];
    model_constants(it->now.values, constants);
    for (double i = 0; i < count; i++) {
        if (it->tangents.directions)
            tangents_integrate(it, constants, time + i * inner, inner);
        else
            runge_kutta(it, constants, time + i * inner, inner);
    }
    return STATUS_OK;
}

Status instance_check_states(Instance *it)
{
    for (int i = 0; i < N_STATES; i++) {
        const int reference = model_states[i].value;
        const double value = it->now.values[reference];
        if (!isfinite(value))
            return instance_fail(it, "state '%s' is %s at t = %g s", model_variables[reference].name,
                           isnan(value) ? "nan" : value > 0 ? "inf" : "-inf", it->now.time);
    }
    return STATUS_OK;
}

/* The sample period [s]. */
static Status get_period(Instance *it, double *period)
{
    *period = it->now.values[N_SAMPLED > 0 ? SAMPLE_TIME : 0];
    if (!(*period > 0))
        return instance_fail(it, "'%s' is %g s", model_variables[N_SAMPLED > 0 ? SAMPLE_TIME : 0].name, *period);
    return STATUS_OK;
}

static void sample(Instance *it, double due)
{
    if (it->tangents.directions)
        tangents_update(it, due);
    model_update(due, it->now.values, it->tables);
    it->now.samples++;
}

Status instance_sample(Instance *it)
{
    Snapshot *s = &it->now;
    double period;
    if ((!s->stepped && prepare(it, s->time)) || get_period(it, &period))
        return STATUS_ERROR;
    const double due = s->start + s->samples * period;
    if (!(fabs(due - s->time) <= EARLY * period))
        return instance_error(it, "is ticked at %.9g s, and its next sample is due at %.9g s", s->time, due);
    s->valid = 0;
    sample(it, due);
    return instance_check_states(it);
}

/* Sample and integrate from an instant to another. */
static Status go_on(Instance *it, double time, double end)
{
    Snapshot *s = &it->now;
    double now = time;
    if (N_SAMPLED > 0) {
        double due, period;
        if (get_period(it, &period))
            return STATUS_ERROR;
        while ((due = s->start + s->samples * period) < end - EARLY * period) {
            if (due > now) {
                if (integrate(it, now, due - now))
                    return STATUS_ERROR;
                now = due;
            }
            sample(it, due);
        }
    }
    return integrate(it, now, end - now);
}

Status instance_step(Instance *it, double time, double duration)
{
    Snapshot *s = &it->now;
    const double end = time + duration;
    if (!(duration >= 0) || !isfinite(end))
        return instance_error(it, "cannot step from %g s by %g s", time, duration);
    if (!s->stepped && prepare(it, time))
        return STATUS_ERROR;
    s->valid = 0;
    const char *crowded = late_arrive(it, time, duration);
    if (crowded)
        return instance_fail(it, "'%s' is later than %d steps", crowded, LONGEST_HISTORY);
    late_enter(it);
    const Status status = go_on(it, time, end);
    late_leave(it);
    if (status)
        return STATUS_ERROR;
    s->time = end;
    return instance_check_states(it);
}

/* Model exchange */

Status instance_start_continuous(Instance *it)
{
    if (it->now.stepped)
        return STATUS_OK;
    it->now.stepped = 1;
    return check_requirements(it, it->now.time);
}

Status instance_set_time(Instance *it, double time)
{
    if (!isfinite(time))
        return instance_error(it, "the time is not finite");
    it->now.time = time;
    it->now.valid = 0;
    return STATUS_OK;
}

static Status check_count(Instance *it, size_t count)
{
    return count == N_CONTINUOUS
               ? STATUS_OK
               : instance_error(it, "has %d continuous states, not %lu", N_CONTINUOUS, (unsigned long)count);
}

Status instance_set_states(Instance *it, const double states[], size_t count)
{
    if (check_count(it, count))
        return STATUS_ERROR;
    for (int i = 0; i < N_CONTINUOUS; i++)
        it->now.values[model_continuous[i]] = states[i];
    it->now.valid = 0;
    return STATUS_OK;
}

Status instance_get_states(Instance *it, double states[], size_t count)
{
    if (check_count(it, count))
        return STATUS_ERROR;
    for (int i = 0; i < N_CONTINUOUS; i++)
        states[i] = it->now.values[model_continuous[i]];
    return STATUS_OK;
}

Status instance_get_rates(Instance *it, double rates[], size_t count)
{
    if (check_count(it, count))
        return STATUS_ERROR;
    evaluate_rates(it);
    for (int i = 0; i < N_CONTINUOUS; i++) {
        rates[i] = it->now.values[FIRST_RATE + i];
        if (!isfinite(rates[i])) {
            instance_error(it, "'%s' is not finite at t = %g s", model_variables[FIRST_RATE + i].name, it->now.time);
            return STATUS_DISCARD;
        }
    }
    return STATUS_OK;
}

Status instance_get_nominals(Instance *it, double nominals[], size_t count)
{
    if (check_count(it, count))
        return STATUS_ERROR;
    memcpy(nominals, model_nominals, count * sizeof *nominals);
    return STATUS_OK;
}

/* States to go back to */

typedef struct {
    uint64_t checksum; /* of what follows */
    char token[sizeof MODEL_TOKEN];
    Snapshot snapshot;
} Serialized;

static uint64_t checksum_of(const Serialized *whole)
{
    return instance_checksum(whole->token, sizeof *whole - offsetof(Serialized, token));
}

static Status keep(Instance *it, const Snapshot *snapshot, void **state)
{
    if (!state)
        return instance_error(it, "there is no place for the state");
    if (!*state && !(*state = malloc(sizeof *snapshot)))
        return instance_error(it, "no memory for the state");
    memcpy(*state, snapshot, sizeof *snapshot);
    return STATUS_OK;
}

Status instance_save(Instance *it, void **state)
{
    return keep(it, &it->now, state);
}

void instance_drop(Instance *it, void *state)
{
    (void)it;
    free(state);
}

Status instance_restore(Instance *it, const void *state)
{
    if (!state)
        return instance_error(it, "there is no state to go back to");
    if (it->tangents.directions)
        return instance_error(it, "a state to go back to holds no tangents, which are carried");
    memcpy(&it->now, state, sizeof it->now);
    return STATUS_OK;
}

size_t instance_serialized_size(void)
{
    return sizeof(Serialized);
}

Status instance_serialize(Instance *it, const void *state, void *bytes, size_t size)
{
    Serialized whole;
    if (!state || !bytes || size < sizeof whole)
        return instance_error(it, "a serialised state needs %lu bytes", (unsigned long)sizeof whole);
    memset(&whole, 0, sizeof whole);
    memcpy(whole.token, MODEL_TOKEN, sizeof MODEL_TOKEN);
    memcpy(&whole.snapshot, state, sizeof whole.snapshot);
    whole.checksum = checksum_of(&whole);
    memcpy(bytes, &whole, sizeof whole);
    return STATUS_OK;
}

Status instance_deserialize(Instance *it, const void *bytes, size_t size, void **state)
{
    Serialized whole;
    if (!bytes || size < sizeof whole)
        return instance_error(it, "a serialised state has %lu bytes", (unsigned long)sizeof whole);
    memcpy(&whole, bytes, sizeof whole);
    if (memcmp(whole.token, MODEL_TOKEN, sizeof MODEL_TOKEN) != 0 || whole.checksum != checksum_of(&whole))
        return instance_error(it, "the bytes are no state of this model, or damaged");
    return keep(it, &whole.snapshot, state);
}
