#include "system.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "derivatives.h"
#include "resources.h"

#define EARLY 1e-6 /* of a base step: how far rounding may put a communication step beside a whole number of them */
#define ASTRAY 1e-3 /* of a base step: how far an importer that adds up steps may be from where the system is */
#define SETTLED 1e-10 /* largest change of a value in a circle that counts as none, relative to 1 + |value| */

#ifdef NESTED
enum { NESTS = 1 };
#else
enum { NESTS = 0 };
#endif

enum { CIRCLES = 50 }; /* how often initial values may run in a circle before they have to be settled */

typedef struct {
    void *part[N_PARTS];
    double *values[N_PARTS]; /* of each part */
} Parts;

static int part_of(int reference)
{
    int i = 0;
    while (reference >= system_parts[i].first + system_parts[i].count)
        i++;
    return i;
}

/* Life cycle */

static void said(void *owner, int number, Status status, const char *category, const char *message)
{
    Instance *it = (Instance *)owner;
    char text[1200];
    if (status == STATUS_OK && !it->logging)
        return;
    snprintf(text, sizeof text, "%s: %s: %s", MODEL_NAME, system_parts[number].name, message);
    it->report(it, status, category, text);
}

static Status open_part(Instance *it, int i, const char *resources)
{
    Parts *parts = (Parts *)it->parts;
    const char *name = system_parts[i].name, *own = system_parts[i].folder;
    const size_t size = strlen(resources) + strlen(own) + 2;
    char *folder = (char *)malloc(size);
    if (!folder)
        return instance_error(it, "no memory");
    snprintf(folder, size, "%s/%s", resources, own);
    parts->part[i] = system_parts[i].model->open(it, i, said, folder);
    free(folder);
    if (!parts->part[i])
        return instance_error(it, "'%s' cannot be made", name);
    parts->values[i] = system_parts[i].model->values(parts->part[i]);
    return STATUS_OK;
}

/* Whether a variable belongs to an FMU. */
static int is_nested(int reference)
{
    return NESTS && reference < N_VARIABLES - 1 && system_parts[part_of(reference)].fmu != NULL;
}

Status instance_open(Instance *it, const char *token, const char *resources)
{
    Problem problem;
    if (!instance_belongs(it, token, resources))
        return STATUS_ERROR;
    for (int i = 0; i < N_VARIABLES; i++) /* what is not given to an FMU is not set in it */
        it->defaults[i] = is_nested(i) ? NAN : model_variables[i].start;
    if (read_defaults(resources, it->defaults, &problem))
        return instance_error(it, "%s", problem.text);
    if (!(it->parts = calloc(1, sizeof(Parts))))
        return instance_error(it, "no memory");
    for (int i = 0; i < N_PARTS; i++)
        if (open_part(it, i, resources))
            return STATUS_ERROR;
    instance_event(it, "defaults are those of %.400s", resources);
    instance_reset(it);
    return STATUS_OK;
}

void instance_close(Instance *it)
{
    Parts *parts = (Parts *)it->parts;
    for (int i = 0; parts && i < N_PARTS; i++)
        system_parts[i].model->close(parts->part[i]);
    free(parts);
    it->parts = NULL;
    free(it->tangents.known);
}

void instance_reset(Instance *it)
{
    const Parts *parts = (const Parts *)it->parts;
    instance_carry(it, 0);
    memset(&it->now, 0, sizeof it->now);
    memcpy(it->now.values, it->defaults, sizeof it->defaults);
    it->now.mode = INSTANTIATED;
    for (int i = 0; i < N_PARTS; i++) {
        const Part *part = &system_parts[i];
        part->model->reset(parts->part[i]);
        for (int k = part->first; k < part->first + part->count; k++)
            if (isnan(it->defaults[k]))
                it->now.values[k] = model_variables[k].start;
            else if (model_variables[k].role <= TUNABLE)
                part->model->set(parts->part[i], (unsigned)(k - part->first), it->defaults[k]);
    }
    instance_begin(it, 0.0);
}

Status instance_begin(Instance *it, double time)
{
    const Parts *parts = (const Parts *)it->parts;
    Snapshot *s = &it->now;
    for (int i = 0; i < N_PARTS; i++)
        if (system_parts[i].model->begin(parts->part[i], time))
            return STATUS_ERROR;
    s->time = s->start = time;
    s->samples = 0;
    s->stepped = 0;
    s->valid = 0;
    return STATUS_OK;
}

/* Values */

/* Whether one of `count` values is another than it was, by more than the tolerance. */
static int moving(const double before[], const double now[], size_t count, double tolerance)
{
    for (size_t i = 0; i < count; i++)
        if (before[i] != now[i] && fabs(now[i] - before[i]) > tolerance * (1.0 + fabs(now[i])))
            return 1;
    return 0;
}

/* Tangents: rows by value reference, of what holds in the system; those of a part's inputs come from there. */

static double *row(const Tangents *of, int reference)
{
    return of->known + (size_t)reference * of->directions;
}

/* Give a part the tangents of its inputs. */
static Status take_tangents(Instance *it, int i)
{
    const Parts *parts = (const Parts *)it->parts;
    const Tangents *of = &it->tangents;
    for (const Feed *feed = system_parts[i].feeds; feed->input >= 0; feed++) {
        for (size_t d = 0; d < of->directions; d++)
            of->work[d] = feed->factor * row(of, feed->source)[d];
        if (system_parts[i].model->set_tangents(parts->part[i], (unsigned)feed->input, of->work))
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

/* Have the tangents of a part's outputs hold. */
static Status give_tangents(Instance *it, int i)
{
    const Parts *parts = (const Parts *)it->parts;
    for (const int *output = system_parts[i].outputs; *output >= 0; output++) {
        const unsigned own = (unsigned)(*output - system_parts[i].first);
        if (system_parts[i].model->get_tangents(parts->part[i], own, row(&it->tangents, *output)))
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

/* Pass them on as the initial values were. */
static Status settle_tangents(Instance *it)
{
    const size_t count = N_VARIABLES * it->tangents.directions, size = count * sizeof(double);
    double *before = (double *)malloc(size);
    int turn = 0, going = 1;
    for (; before && going && turn <= N_PARTS + CIRCLES; turn++) {
        memcpy(before, it->tangents.known, size);
        for (int i = 0; i < N_PARTS; i++)
            if (take_tangents(it, i) || give_tangents(it, i)) {
                free(before);
                return STATUS_ERROR;
            }
        going = turn == 0 || moving(before, it->tangents.known, count, turn > N_PARTS ? SETTLED : 0.0);
    }
    free(before);
    return going ? instance_fail(it, "the initial tangents do not settle") : STATUS_OK;
}

/* Pass outputs to inputs until nothing changes: a chain of n parts is through after n passes. */
static Status settle(Instance *it)
{
    const Parts *parts = (const Parts *)it->parts;
    Snapshot *s = &it->now;
    double before[N_VARIABLES];
    for (int turn = 0; turn <= N_PARTS + CIRCLES; turn++) {
        memcpy(before, s->values, sizeof before);
        for (int i = 0; i < N_PARTS; i++) {
            const Part *part = &system_parts[i];
            part->take(s->values, parts->values[i]);
            if (part->model->evaluate(parts->part[i]))
                return STATUS_ERROR;
            part->give(parts->values[i], s->values);
        }
        if (turn > 0 && !moving(before, s->values, N_VARIABLES, turn > N_PARTS ? SETTLED : 0.0)) {
            s->valid = 1;
            return it->tangents.directions ? settle_tangents(it) : STATUS_OK;
        }
    }
    return instance_fail(it, "the initial values run in a circle and do not settle");
}

Status instance_get(Instance *it, unsigned reference, int types, double *value)
{
    const Variable *variable = instance_find(it, reference, types);
    if (!variable)
        return STATUS_ERROR;
    const int known = it->now.stepped || it->now.valid || (NESTS && it->now.mode == INSTANTIATED);
    if (variable->role == OUTPUT && !known && settle(it))
        return STATUS_ERROR;
    *value = variable->role == TIME ? it->now.time : it->now.values[reference];
    return STATUS_OK;
}

Status instance_set(Instance *it, unsigned reference, int types, double value)
{
    const Parts *parts = (const Parts *)it->parts;
    const Variable *variable = instance_find(it, reference, types);
    const char *problem = variable ? instance_obstacle(it, variable) : NULL;
    if (!variable)
        return STATUS_ERROR;
    if (problem)
        return instance_error(it, "'%s' %s", variable->name, problem);
    const int i = part_of((int)reference);
    it->now.values[reference] = value;
    it->now.valid = 0;
    return system_parts[i].model->set(parts->part[i], reference - (unsigned)system_parts[i].first, value);
}

/* Carried derivatives */

Status instance_carry(Instance *it, size_t directions)
{
    const Parts *parts = (const Parts *)it->parts;
    Tangents *of = &it->tangents;
    free(of->known);
    memset(of, 0, sizeof *of);
    it->now.valid = 0;
    if (directions && !(of->known = (double *)calloc(directions, (N_VARIABLES + 1) * sizeof *of->known)))
        return instance_error(it, "no memory for the tangents along %lu directions", (unsigned long)directions);
    for (int i = 0; i < N_PARTS; i++)
        if (system_parts[i].model->carry(parts->part[i], directions))
            return STATUS_ERROR;
    of->directions = directions;
    of->work = directions ? row(of, N_VARIABLES) : NULL;
    return STATUS_OK;
}

Status instance_set_tangents(Instance *it, const unsigned references[], size_t count, const double tangents[])
{
    const Parts *parts = (const Parts *)it->parts;
    const Tangents *of = &it->tangents;
    for (size_t k = 0; k < count; k++) {
        const unsigned reference = references[k];
        const double *given = tangents + k * of->directions;
        const char *problem = !of->directions ? "no directions are carried" : NULL;
        if (reference >= N_VARIABLES || model_variables[reference].role > TUNABLE)
            problem = "it is no input or parameter";
        if (problem)
            return instance_error(it, "'%s' cannot be given tangents: %s",
                                  reference < N_VARIABLES ? model_variables[reference].name : "", problem);
        const int i = part_of((int)reference);
        const unsigned own = reference - (unsigned)system_parts[i].first;
        if (system_parts[i].model->set_tangents(parts->part[i], own, given))
            return STATUS_ERROR;
        memcpy(row(of, (int)reference), given, of->directions * sizeof *given);
        it->now.valid = 0;
    }
    return STATUS_OK;
}

Status instance_get_tangents(Instance *it, const unsigned references[], size_t count, double tangents[])
{
    const Tangents *of = &it->tangents;
    if (of->directions && !it->now.stepped && !it->now.valid && settle(it))
        return STATUS_ERROR;
    for (size_t k = 0; k < count; k++) {
        if (!of->directions || references[k] >= N_VARIABLES || model_variables[references[k]].role > OUTPUT)
            return instance_error(it, "value reference %u has no tangents", references[k]);
        memcpy(tangents + k * of->directions, row(of, (int)references[k]), of->directions * sizeof *tangents);
    }
    return STATUS_OK;
}

/* Stepping */

static double time_of(const Instance *it, double tick)
{
    const Clock *clock = &system_clock;
    if (it->now.start == clock->first / clock->denominator)
        return (clock->first + tick * clock->step) / clock->denominator;
    return it->now.start + tick * clock->step / clock->denominator;
}

/* See that a part's outputs, whose sum is given, are finite where they have to be. */
static Status check_finite(Instance *it, const Part *part, double sum)
{
    if (!FINITE || isfinite(sum))
        return STATUS_OK;
    for (int k = part->first; k < part->first + part->count; k++)
        if (model_variables[k].role == OUTPUT && !isfinite(it->now.values[k]))
            return instance_fail(it, "'%s' is %g at t = %g s", model_variables[k].name, it->now.values[k], it->now.time);
    return STATUS_OK; /* the sum alone is too large */
}

/* Have a part's outputs hold. */
static Status pass_on(Instance *it, int i)
{
    const Parts *parts = (const Parts *)it->parts;
    if (check_finite(it, &system_parts[i], system_parts[i].give(parts->values[i], it->now.values)))
        return STATUS_ERROR;
    return it->tangents.directions ? give_tangents(it, i) : STATUS_OK;
}

/* FMUs may have other outputs once their initialisation is over, which then hold. */
Status instance_run(Instance *it)
{
    const Parts *parts = (const Parts *)it->parts;
    if (NESTS && !it->now.valid && settle(it))
        return STATUS_ERROR;
    for (int i = 0; i < N_PARTS; i++)
        if (system_parts[i].model->run(parts->part[i])) {
            it->now.mode = FAILED;
            return STATUS_ERROR;
        }
    for (int i = 0; NESTS && i < N_PARTS; i++)
        system_parts[i].give(parts->values[i], it->now.values);
    return STATUS_OK;
}

static Status prepare(Instance *it)
{
    if (!it->now.valid && settle(it))
        return STATUS_ERROR;
    for (int i = 0; i < N_PARTS; i++)
        if (pass_on(it, i))
            return STATUS_ERROR;
    it->now.stepped = 1;
    return STATUS_OK;
}

/* One base step: the parts that are due, in their order; outputs that are not instant hold once their step is over. */
static Status advance(Instance *it)
{
    const Parts *parts = (const Parts *)it->parts;
    Snapshot *s = &it->now;
    const int64_t tick = (int64_t)s->samples;
    const int carries = it->tangents.directions > 0;
    for (int i = 0; i < N_PARTS; i++) {
        const Part *part = &system_parts[i];
        if (part->every > 1 && tick % part->every)
            continue;
        part->take(s->values, parts->values[i]);
        const Status tangents = carries ? take_tangents(it, i) : STATUS_OK;
        const Status status = tangents ? tangents : part->model->step(parts->part[i], s->time, part->duration);
        if (status) {
            s->over = status == STATUS_DISCARD && part->fmu != NULL;
            s->mode = s->over ? s->mode : (int)FAILED;
            return s->over ? STATUS_DISCARD : STATUS_ERROR;
        }
        if (part->evaluated && part->model->evaluate(parts->part[i]))
            return STATUS_ERROR;
        if (part->instant && pass_on(it, i))
            return STATUS_ERROR;
    }
    s->samples = (double)(tick + 1);
    s->time = time_of(it, s->samples);
    for (int i = 0; i < N_PARTS; i++) {
        const Part *part = &system_parts[i];
        if (part->instant || (part->every > 1 && (tick + 1) % part->every))
            continue;
        if (pass_on(it, i))
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

Status instance_step(Instance *it, double time, double duration)
{
    Snapshot *s = &it->now;
    const double base = system_clock.step / system_clock.denominator;
    if (!(duration >= 0) || !isfinite(time + duration))
        return instance_error(it, "cannot step from %g s by %g s", time, duration);
    const double count = floor(duration / base + 0.5);
    if (fabs(duration - count * base) > EARLY * base)
        return instance_error(it, "a step of %.12g s is no multiple of the system's base step of %.12g s", duration, base);
    if (fabs(time - s->time) > ASTRAY * base)
        return instance_error(it, "cannot step from %.12g s: it is at %.12g s", time, s->time);
    if (!s->stepped && prepare(it))
        return STATUS_ERROR;
    Status status = s->over ? STATUS_DISCARD : STATUS_OK;
    for (double i = 0; i < count && !status; i++)
        status = advance(it);
    return status;
}

/* States to go back to: the system's own snapshot, and that of each part */

static size_t size_of_state(void)
{
    size_t size = sizeof(Snapshot);
    for (int i = 0; i < N_PARTS; i++)
        size += system_parts[i].model->size;
    return size;
}

Status instance_save(Instance *it, void **state)
{
    const Parts *parts = (const Parts *)it->parts;
    if (!state)
        return instance_error(it, "there is no place for the state");
    const int fresh = !*state;
    if (fresh && !(*state = calloc(1, size_of_state())))
        return instance_error(it, "no memory for the state");
    char *to = (char *)*state;
    memcpy(to, &it->now, sizeof it->now);
    to += sizeof it->now;
    for (int i = 0; i < N_PARTS; to += system_parts[i].model->size, i++)
        if (system_parts[i].model->save(parts->part[i], to)) {
            instance_drop(it, fresh ? *state : NULL);
            *state = fresh ? NULL : *state;
            return STATUS_ERROR;
        }
    return STATUS_OK;
}

void instance_drop(Instance *it, void *state)
{
    const Parts *parts = (const Parts *)it->parts;
    char *at = (char *)state + sizeof it->now;
    for (int i = 0; state && i < N_PARTS; at += system_parts[i].model->size, i++)
        system_parts[i].model->drop(parts->part[i], at);
    free(state);
}

Status instance_restore(Instance *it, const void *state)
{
    const Parts *parts = (const Parts *)it->parts;
    const char *from = (const char *)state;
    if (!state)
        return instance_error(it, "there is no state to go back to");
    if (it->tangents.directions)
        return instance_error(it, "a state to go back to holds no tangents, which are carried");
    memcpy(&it->now, from, sizeof it->now);
    from += sizeof it->now;
    for (int i = 0; i < N_PARTS; from += system_parts[i].model->size, i++)
        if (system_parts[i].model->restore(parts->part[i], from))
            return STATUS_ERROR;
    return STATUS_OK;
}

/* Serialised: a checksum of what follows, the token, the state. That of an FMU within is not in memory of ours. */
enum { SUM = sizeof(uint64_t), HEAD = SUM + sizeof MODEL_TOKEN };

size_t instance_serialized_size(void)
{
    return HEAD + size_of_state();
}

Status instance_serialize(Instance *it, const void *state, void *bytes, size_t size)
{
    char *to = (char *)bytes;
    if (NESTS)
        return instance_error(it, "a state of FMUs within cannot be serialised");
    if (!state || !bytes || size < instance_serialized_size())
        return instance_error(it, "a serialised state needs %lu bytes", (unsigned long)instance_serialized_size());
    memcpy(to + SUM, MODEL_TOKEN, sizeof MODEL_TOKEN);
    memcpy(to + HEAD, state, size_of_state());
    const uint64_t checksum = instance_checksum(to + SUM, instance_serialized_size() - SUM);
    memcpy(to, &checksum, SUM);
    return STATUS_OK;
}

Status instance_deserialize(Instance *it, const void *bytes, size_t size, void **state)
{
    const char *from = (const char *)bytes;
    uint64_t checksum;
    if (NESTS)
        return instance_error(it, "a state of FMUs within cannot be serialised");
    if (!bytes || size < instance_serialized_size())
        return instance_error(it, "a serialised state has %lu bytes", (unsigned long)instance_serialized_size());
    memcpy(&checksum, from, SUM);
    if (memcmp(from + SUM, MODEL_TOKEN, sizeof MODEL_TOKEN) != 0 ||
        checksum != instance_checksum(from + SUM, instance_serialized_size() - SUM))
        return instance_error(it, "the bytes are no state of this system, or damaged");
    if (!state)
        return instance_error(it, "there is no place for the state");
    if (!*state && !(*state = malloc(size_of_state())))
        return instance_error(it, "no memory for the state");
    memcpy(*state, from + HEAD, size_of_state());
    return STATUS_OK;
}

/* What a system does not offer; the adapters of FMI know the functions all the same */

static Status exchange(Instance *it)
{
    return instance_error(it, "offers co-simulation only");
}

Status instance_derivative(Instance *it, const unsigned unknowns[], size_t rows, const unsigned knowns[], size_t columns,
                           const double seed[], double result[], int transposed)
{
    (void)unknowns, (void)rows, (void)knowns, (void)columns, (void)seed, (void)result, (void)transposed;
    return instance_error(it, "provides no derivatives");
}

Status instance_sample(Instance *it)
{
    return exchange(it);
}

Status instance_start_continuous(Instance *it)
{
    return exchange(it);
}

Status instance_set_time(Instance *it, double time)
{
    (void)time;
    return exchange(it);
}

Status instance_set_states(Instance *it, const double states[], size_t count)
{
    (void)states, (void)count;
    return exchange(it);
}

Status instance_get_states(Instance *it, double states[], size_t count)
{
    (void)states, (void)count;
    return exchange(it);
}

Status instance_get_rates(Instance *it, double rates[], size_t count)
{
    (void)rates, (void)count;
    return exchange(it);
}

Status instance_get_nominals(Instance *it, double nominals[], size_t count)
{
    (void)nominals, (void)count;
    return exchange(it);
}

Status instance_check_states(Instance *it)
{
    return exchange(it);
}
