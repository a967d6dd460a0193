/* What FMUs of FMI 2.0 and 3.0 within a system are bound by alike. Before it is included:
 * FMI(name) is the full name of a function, FMI_TYPE(name) that of its type, STATE(verb) that of one about states, and
 * FUNCTIONS(X) are all that are called, X(name, whether no run goes without it). */
#ifndef NESTED_BINDING_H
#define NESTED_BINDING_H

#include <stdlib.h>

#include "nested.h"

#define TEXT(name) #name
#define NAME_OF(name) TEXT(name)

#define DECLARE(name, needed) FMI_TYPE(name) *name;
typedef struct {
    FUNCTIONS(DECLARE)
} Functions;

static const Functions *functions_of(const Nested *part)
{
    return (const Functions *)part->functions;
}

#define REQUIRE(name)                                                                                                  \
    do {                                                                                                               \
        if (!functions_of(part)->name)                                                                                 \
            return (int)nested_lacks(part, NAME_OF(FMI(name)));                                                        \
    } while (0)

#define CALL(name, ...)                                                                                                \
    do {                                                                                                               \
        REQUIRE(name);                                                                                                 \
        return (int)functions_of(part)->name(__VA_ARGS__);                                                             \
    } while (0)

static Status bind(Nested *part)
{
    Functions *found = (Functions *)calloc(1, sizeof *found);
    part->functions = found;
    if (!found)
        return STATUS_ERROR;
#define FIND(name, needed)                                                                                             \
    if (!library_find(part->library, NAME_OF(FMI(name)), &found->name) && needed)                                      \
        return nested_lacks(part, NAME_OF(FMI(name)));
    FUNCTIONS(FIND)
    return STATUS_OK;
}

/* Have it tell of trouble, where it keeps that apart; what it tells where it is to log everything is its own affair. */
static Status ask_for_trouble(Nested *part)
{
    size_t count = 0;
    while (part->fmu->categories[count])
        count++;
    if (part->instance && count && !part->owner->logging && functions_of(part)->SetDebugLogging)
        functions_of(part)->SetDebugLogging(part->instance, 1, count, part->fmu->categories);
    return part->instance ? STATUS_OK : STATUS_ERROR;
}

static void release(Nested *part)
{
    if (functions_of(part)->FreeInstance)
        functions_of(part)->FreeInstance(part->instance);
}

/* Of its solver, relative; 0 where none is told. */
static double tolerance_of(const Nested *part)
{
    return part->owner->tolerance > 0 ? part->owner->tolerance : system_tolerance;
}

static int reset(Nested *part)
{
    CALL(Reset, part->instance);
}

static int leave(Nested *part)
{
    CALL(ExitInitializationMode, part->instance);
}

static int terminate(Nested *part)
{
    return functions_of(part)->Terminate ? (int)functions_of(part)->Terminate(part->instance) : (int)STATUS_OK;
}

static int save(Nested *part, void **state)
{
    CALL(STATE(Get), part->instance, state);
}

static int restore(Nested *part, void *state)
{
    CALL(STATE(Set), part->instance, state);
}

static int drop(Nested *part, void **state)
{
    CALL(STATE(Free), part->instance, state);
}

#endif
