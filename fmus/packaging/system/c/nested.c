#include "nested.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define ALMOST (1.0 - 1e-9) /* of a step that is whole but for rounding */

/* What changes while running, beside what is in the FMU; the values lie behind it, then which of them were given. */
typedef struct {
    void *state;
    Phase phase;
    int touched, asked, complained;
    double start;
} Kept;

/* Messages */

void nested_said(Nested *part, int status, const char *category, const char *text)
{
    const int refused = category && strcmp(category, "logParameters") == 0; /* as an FMU of ours says it */
    const Status known = status >= STATUS_OK && status <= STATUS_FATAL ? (Status)status : STATUS_ERROR;
    if (known > STATUS_DISCARD)
        part->complained = 1;
    part->listener(part->owner, part->number, known,
                   refused ? category : known == STATUS_OK ? "logEvents" : "logStatusError", text);
}

void nested_say(Nested *part, Status status, const char *format, ...)
{
    char text[900];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text, sizeof text, format, arguments);
    va_end(arguments);
    part->listener(part->owner, part->number, status, status == STATUS_OK ? "logEvents" : "logStatusError", text);
}

Status nested_lacks(Nested *part, const char *function)
{
    nested_say(part, STATUS_ERROR, "its library has no function %s", function);
    return STATUS_ERROR;
}

/* Whether a status of FMI lets it go on; where not, it is said what was done, and `to` what. */
static Status check(Nested *part, int status, const char *doing, const char *to)
{
    static const char *const names[] = {"discard", "error", "fatal"};
    if (status == STATUS_OK || status == STATUS_WARNING)
        return STATUS_OK;
    const char *name = status >= STATUS_DISCARD && status <= STATUS_FATAL ? names[status - STATUS_DISCARD] : "pending";
    part->dead |= status == STATUS_FATAL;
    nested_say(part, STATUS_ERROR, "%s%s: returned %s", doing, to, name);
    return STATUS_ERROR;
}

/* Values */

int nested_whole(Nested *part, double value, int *number)
{
    const double whole = nearbyint(value);
    const int fits = whole >= INT32_MIN && whole <= INT32_MAX;
    if (fits)
        *number = (int)whole;
    else
        nested_say(part, STATUS_ERROR, "%g does not fit into 32 bits", value);
    return fits;
}

static int count_of(const Nested *part)
{
    return system_parts[part->number].count;
}

static const char *name_of(const Nested *part, int place)
{
    return model_variables[system_parts[part->number].first + place].name;
}

static int is_read(const Nested *part, int place)
{
    return part->fmu->variables[place].use == READ;
}

static int is_written(const Nested *part, int place)
{
    const Use use = part->fmu->variables[place].use;
    return use == DRIVEN || (use == FREE && part->given[place]);
}

/* How many of the values of a variable, an array with all of them, are wanted. */
static int wanted_of(const Nested *part, int first, int (*wanted)(const Nested *part, int place))
{
    int count = 0;
    for (int place = first; place < first + part->fmu->variables[first].size; place++)
        count += wanted(part, place);
    return count;
}

static void gather(const Nested *part, Bundle *bundle, int (*wanted)(const Nested *part, int place))
{
    size_t n = 0, references = 0;
    for (int kind = 0; kind < KINDS; kind++) {
        bundle->first[kind] = n;
        bundle->first_reference[kind] = references;
        for (int place = 0; place < count_of(part); place++) {
            const NestedVariable *variable = &part->fmu->variables[place];
            if ((int)variable->kind != kind || !wanted_of(part, place, wanted))
                continue;
            bundle->references[references++] = variable->reference;
            for (int element = 0; element < variable->size; element++)
                bundle->places[n++] = place + element;
        }
    }
    bundle->first[KINDS] = n;
    bundle->first_reference[KINDS] = references;
}

static Status write_inputs(Nested *part)
{
    const Bundle *to = &part->writes;
    for (int kind = 0; kind < KINDS; kind++) {
        const size_t first = to->first[kind], end = to->first[kind + 1], reference = to->first_reference[kind];
        for (size_t i = first; i < end; i++)
            to->numbers[i] = part->values[to->places[i]];
        if (first < end && check(part,
                                 part->fmu->functions->set(part, (Kind)kind, to->references + reference,
                                                           to->first_reference[kind + 1] - reference,
                                                           to->numbers + first, end - first),
                                 "set inputs", ""))
            return STATUS_ERROR;
    }
    return STATUS_OK;
}

static Status read_outputs(Nested *part)
{
    const Bundle *from = &part->reads;
    for (int kind = 0; kind < KINDS; kind++) {
        const size_t first = from->first[kind], end = from->first[kind + 1], reference = from->first_reference[kind];
        if (first < end && check(part,
                                 part->fmu->functions->get(part, (Kind)kind, from->references + reference,
                                                           from->first_reference[kind + 1] - reference,
                                                           from->numbers + first, end - first),
                                 "get outputs", ""))
            return STATUS_ERROR;
        for (size_t i = first; i < end; i++)
            part->values[from->places[i]] = from->numbers[i];
    }
    return STATUS_OK;
}

/* Life cycle */

static int escaped_in_uri(char c)
{
    return !((c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || strchr("-._~/:", c));
}

char *nested_place(const Nested *part, const char *path, int as_uri)
{
    const size_t length = strlen(part->folder) + strlen(path);
    char *plain = (char *)malloc(length + 1), *made = (char *)malloc(3 * length + sizeof "file:///"), *to = made;
    if (plain && made) {
        snprintf(plain, length + 1, "%s%s", part->folder, path);
        if (as_uri)
            to += sprintf(to, plain[0] == '/' ? "file://" : "file:///");
        for (const char *from = plain; *from; from++) {
            const char c = as_uri && *from == '\\' ? '/' : *from;
            if (as_uri && escaped_in_uri(c))
                to += sprintf(to, "%%%02X", (unsigned)(unsigned char)c);
            else
                *to++ = c;
        }
        *to = '\0';
    } else {
        free(made);
        made = NULL;
    }
    free(plain);
    return made;
}

static Status load(Nested *part)
{
    LibraryProblem problem;
    char path[400];
    snprintf(path, sizeof path, "/binaries/%s/%s%s", part->fmu->functions->folder, part->fmu->identifier, LIBRARY_SUFFIX);
    char *library = nested_place(part, path, 0);
    part->library = library ? library_load(library, &problem) : NULL;
    if (library && !part->library)
        nested_say(part, STATUS_ERROR, "its library cannot be loaded: %s", problem.text);
    free(library);
    return part->library ? part->fmu->functions->bind(part) : STATUS_ERROR;
}

static Status instantiate(Nested *part)
{
    for (int place = 0; place < count_of(part); place++)
        part->values[place] = model_variables[system_parts[part->number].first + place].start;
    const Status status = part->fmu->functions->instantiate(part);
    if (status)
        nested_say(part, STATUS_ERROR, "cannot be instantiated");
    part->phase = MADE;
    part->touched = part->asked = part->complained = 0;
    return status;
}

/* Give the instance back. */
static void release(Nested *part)
{
    if (part->instance && !part->dead) {
        if (part->phase == RUNNING)
            part->fmu->functions->terminate(part);
        part->fmu->functions->release(part);
    }
    part->instance = NULL;
}

static void close_bundle(Bundle *bundle)
{
    free(bundle->references);
    free(bundle->places);
    free(bundle->numbers);
}

static int open_bundle(Bundle *bundle, size_t room)
{
    bundle->references = (unsigned *)calloc(room, sizeof *bundle->references);
    bundle->places = (int *)calloc(room, sizeof *bundle->places);
    bundle->numbers = (double *)calloc(room, sizeof *bundle->numbers);
    return bundle->references && bundle->places && bundle->numbers;
}

static void close_part(void *of)
{
    Nested *part = (Nested *)of;
    if (!part)
        return;
    release(part);
    close_bundle(&part->reads);
    close_bundle(&part->writes);
    free(part->functions);
    free(part->callbacks);
    free(part->folder);
    free(part->scratch);
    free(part->values);
    free(part->given);
    free(part);
}

static void *open_part(void *owner, int number, PartReport *listener, const char *folder)
{
    Nested *part = (Nested *)calloc(1, sizeof *part);
    const size_t room = (size_t)system_parts[number].count + 1;
    if (!part)
        return NULL;
    part->owner = (Instance *)owner;
    part->number = number;
    part->listener = listener;
    part->fmu = system_parts[number].fmu;
    part->folder = (char *)malloc(strlen(folder) + 1);
    part->scratch = calloc(room, sizeof(double));
    part->values = (double *)calloc(room, sizeof *part->values);
    part->given = (unsigned char *)calloc(room, 1);
    const int bundled = open_bundle(&part->reads, room) && open_bundle(&part->writes, room);
    if (!bundled || !part->folder || !part->scratch || !part->values || !part->given) {
        nested_say(part, STATUS_ERROR, "no memory");
    } else {
        strcpy(part->folder, folder);
        gather(part, &part->reads, is_read);
        gather(part, &part->writes, is_written);
        if (!load(part) && !instantiate(part))
            return part;
    }
    close_part(part);
    return NULL;
}

/* A fresh instance is surer than a reset, which some FMUs do by half. */
static void reset_part(void *of)
{
    Nested *part = (Nested *)of;
    if (!part->touched || part->dead)
        return;
    if (part->fmu->once) {
        if (part->phase == RUNNING)
            part->fmu->functions->terminate(part);
        part->dead = check(part, part->fmu->functions->reset(part), "reset", "") != STATUS_OK;
        part->phase = MADE;
        part->touched = part->asked = part->complained = 0;
    } else {
        release(part);
        part->dead = instantiate(part) != STATUS_OK;
    }
    memset(part->given, 0, (size_t)count_of(part));
    gather(part, &part->writes, is_written);
}

static Status begin_part(void *of, double time)
{
    ((Nested *)of)->start = time;
    return STATUS_OK;
}

/* Whether its functions may be called. */
static Status require_alive(Nested *part)
{
    if (!part->dead)
        return STATUS_OK;
    nested_say(part, STATUS_ERROR, "has failed for good: instantiate anew");
    return STATUS_ERROR;
}

/* The place of the first element of the array that an element belongs to; that of a scalar is its own. */
static int first_of(const Nested *part, int place)
{
    while (!part->fmu->variables[place].size)
        place--;
    return place;
}

/* Inputs are written before a step; a parameter is set now. */
static Status set_part(void *of, unsigned place, double value)
{
    Nested *part = (Nested *)of;
    const NestedVariable *variable = &part->fmu->variables[place];
    if (require_alive(part))
        return STATUS_ERROR;
    const int anew = !part->given[place];
    part->values[place] = value;
    part->touched = part->given[place] = 1;
    if (variable->use != GIVEN) {
        if (anew)
            gather(part, &part->writes, is_written);
        return STATUS_OK;
    }
    const int first = first_of(part, (int)place);
    const int status = part->fmu->functions->set(part, variable->kind, &variable->reference, 1, part->values + first,
                                                 (size_t)part->fmu->variables[first].size);
    return check(part, status, "set ", name_of(part, (int)place));
}

/* Whether two values differ by rounding only, be it to the single precision in which some FMUs keep theirs. */
static int is_same(double one, double other)
{
    return fabs(one - other) <= 1e-12 * fmax(fabs(one), fabs(other)) || (double)(float)one == other;
}

/* See that the FMU has what was set. */
static Status require_taken(Nested *part)
{
    for (int place = 0; place < count_of(part); place++) {
        const NestedVariable *variable = &part->fmu->variables[place];
        const int first = first_of(part, place);
        double *all = part->writes.numbers; /* which are filled before each use */
        if (variable->use != GIVEN || !part->given[place])
            continue;
        const int status = part->fmu->functions->get(part, variable->kind, &variable->reference, 1, all,
                                                     (size_t)part->fmu->variables[first].size);
        const double found = all[place - first];
        if (check(part, status, "get ", name_of(part, place)))
            return STATUS_ERROR;
        if (!is_same(part->values[place], found)) {
            nested_say(part, STATUS_ERROR, "%s was set to %g but is %g: it does not take it", name_of(part, place),
                       part->values[place], found);
            return STATUS_ERROR;
        }
    }
    return STATUS_OK;
}

/* What the outputs are with the present inputs; before it runs that is a part of its initialisation. */
static Status evaluate_part(void *of)
{
    Nested *part = (Nested *)of;
    if (require_alive(part))
        return STATUS_ERROR;
    part->touched = 1;
    if (part->phase == MADE) {
        if (check(part, part->fmu->functions->enter(part), "enter the initialisation", ""))
            return STATUS_ERROR;
        part->phase = INITIALISING;
    }
    return write_inputs(part) ? STATUS_ERROR : read_outputs(part);
}

static Status run_part(void *of)
{
    Nested *part = (Nested *)of;
    if (require_alive(part))
        return STATUS_ERROR;
    if (part->phase == INITIALISING) {
        if (check(part, part->fmu->functions->leave(part), "leave the initialisation", ""))
            return STATUS_ERROR;
        part->phase = RUNNING;
        if (require_taken(part))
            return STATUS_ERROR;
    }
    return read_outputs(part);
}

/* Take note of how a step went; one that asked to stop at its very end does so before the next one. */
static Status stepped(Nested *part, int status, double end, double duration, const Stop *stop)
{
    if (!stop->asked && !stop->early)
        return check(part, status, "step", "");
    if (stop->reached >= end - duration * (1.0 - ALMOST)) {
        part->asked = stop->asked;
        return STATUS_OK;
    }
    const int ends = stop->asked && !part->complained;
    nested_say(part, ends ? STATUS_DISCARD : STATUS_ERROR, "%s at t = %g s, within a step",
               stop->asked ? "asked to stop" : "ended early", stop->reached);
    return ends ? STATUS_DISCARD : STATUS_ERROR;
}

static Status step_part(void *of, double time, double duration)
{
    Nested *part = (Nested *)of;
    Stop stop = {0, 0, 0.0};
    if (part->asked) {
        nested_say(part, STATUS_DISCARD, "asked to stop at t = %g s", time);
        return STATUS_DISCARD;
    }
    if (require_alive(part) || write_inputs(part))
        return STATUS_ERROR;
    const int answer = part->fmu->functions->step(part, time, duration, &stop);
    const Status status = stepped(part, answer, time + duration, duration, &stop);
    return status ? status : read_outputs(part);
}

static double *values_of(void *part)
{
    return ((Nested *)part)->values;
}

/* States to go back to: a pointer to what is kept */

static double *kept_values(Kept *kept)
{
    return (double *)(void *)(kept + 1);
}

static Status save_part(void *of, void *to)
{
    Nested *part = (Nested *)of;
    const size_t count = (size_t)count_of(part);
    Kept *kept;
    memcpy(&kept, to, sizeof kept);
    if (!part->fmu->saves || require_alive(part)) {
        nested_say(part, STATUS_ERROR, "cannot save its state");
        return STATUS_ERROR;
    }
    if (!kept && !(kept = (Kept *)calloc(1, sizeof *kept + count * (sizeof(double) + 1)))) {
        nested_say(part, STATUS_ERROR, "no memory for its state");
        return STATUS_ERROR;
    }
    memcpy(to, &kept, sizeof kept);
    kept->phase = part->phase;
    kept->touched = part->touched;
    kept->asked = part->asked;
    kept->complained = part->complained;
    kept->start = part->start;
    memcpy(kept_values(kept), part->values, count * sizeof(double));
    memcpy(kept_values(kept) + count, part->given, count);
    return check(part, part->fmu->functions->save(part, &kept->state), "save its state", "");
}

static Status restore_part(void *of, const void *from)
{
    Nested *part = (Nested *)of;
    const size_t count = (size_t)count_of(part);
    Kept *kept;
    memcpy(&kept, from, sizeof kept);
    if (!kept || require_alive(part))
        return STATUS_ERROR;
    if (check(part, part->fmu->functions->restore(part, kept->state), "restore its state", ""))
        return STATUS_ERROR;
    part->phase = kept->phase;
    part->touched = 1;
    part->asked = kept->asked;
    part->complained = kept->complained;
    part->start = kept->start;
    memcpy(part->values, kept_values(kept), count * sizeof(double));
    memcpy(part->given, kept_values(kept) + count, count);
    gather(part, &part->writes, is_written);
    return STATUS_OK;
}

static void drop_part(void *of, void *at)
{
    Nested *part = (Nested *)of;
    Kept *kept;
    memcpy(&kept, at, sizeof kept);
    if (kept && kept->state && !part->dead)
        part->fmu->functions->drop(part, &kept->state);
    free(kept);
}

/* Tangents, which FMI does not have */

static Status carry_none(void *part, size_t directions)
{
    (void)part;
    return directions ? STATUS_ERROR : STATUS_OK;
}

static Status set_no_tangents(void *part, unsigned place, const double *tangents)
{
    (void)part, (void)place, (void)tangents;
    return STATUS_ERROR;
}

static Status get_no_tangents(void *part, unsigned place, double *tangents)
{
    (void)part, (void)place, (void)tangents;
    return STATUS_ERROR;
}

const PartModel nested_part = {
    sizeof(Kept *), open_part, close_part,   reset_part, begin_part, set_part,        step_part,       evaluate_part,
    run_part,       values_of, save_part,    restore_part, drop_part, carry_none,     set_no_tangents, get_no_tangents,
};
