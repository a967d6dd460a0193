/* FMUs of FMI 3.0 within a system. They see to their events themselves: event mode is not used. */
#include "fmi3FunctionTypes.h"

#define FMI(name) fmi3##name
#define FMI_TYPE(name) fmi3##name##TYPE
#define STATE(verb) verb##FMUState
#define FUNCTIONS(X)                                                                                                   \
    X(SetDebugLogging, 0)                                                                                              \
    X(InstantiateCoSimulation, 1) X(FreeInstance, 0) X(EnterInitializationMode, 1) X(ExitInitializationMode, 1)        \
    X(Terminate, 0) X(Reset, 0) X(GetFloat64, 0) X(GetInt32, 0) X(GetInt64, 0) X(GetBoolean, 0) X(SetFloat64, 0)       \
    X(SetInt32, 0) X(SetInt64, 0) X(SetBoolean, 0) X(GetFMUState, 0) X(SetFMUState, 0) X(FreeFMUState, 0) X(DoStep, 1)

#include "nested_binding.h"

static void said(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    nested_said((Nested *)environment, (int)status, category, message ? message : "");
}

static Status instantiate(Nested *part)
{
    char *resources = nested_place(part, "/resources/", 0);
    if (resources)
        part->instance = functions_of(part)->InstantiateCoSimulation(
            system_parts[part->number].name, part->fmu->token, resources, fmi3False, part->owner->logging != 0,
            fmi3False, fmi3False, NULL, 0, part, said, NULL);
    free(resources);
    return ask_for_trouble(part);
}

static int enter(Nested *part)
{
    const Instance *it = part->owner;
    const double tolerance = tolerance_of(part);
    CALL(EnterInitializationMode, part->instance, tolerance > 0, tolerance, part->start, it->ends != 0, it->stop);
}

/* Values of other types than Float64 go through memory of theirs; a whole number that does not fit is an error. */
#define SET(Name, Number, convert)                                                                                     \
    do {                                                                                                               \
        Number *numbers = (Number *)part->scratch;                                                                     \
        for (size_t i = 0; i < n; i++)                                                                             \
            convert;                                                                                                   \
        CALL(Set##Name, part->instance, references, count, numbers, n);                                            \
    } while (0)

#define WHOLE                                                                                                          \
    do {                                                                                                               \
        int number;                                                                                                    \
        if (!nested_whole(part, values[i], &number))                                                                   \
            return (int)fmi3Error;                                                                                     \
        numbers[i] = number;                                                                                           \
    } while (0)

static int set(Nested *part, Kind kind, const unsigned references[], size_t count, const double values[], size_t n)
{
    if (kind == WHOLE_VALUE)
        SET(Int32, fmi3Int32, WHOLE);
    if (kind == ITEM_VALUE)
        SET(Int64, fmi3Int64, WHOLE);
    if (kind == TRUTH_VALUE)
        SET(Boolean, fmi3Boolean, numbers[i] = values[i] != 0);
    CALL(SetFloat64, part->instance, references, count, values, n);
}

#define GET(Name, Number)                                                                                              \
    do {                                                                                                               \
        Number *numbers = (Number *)part->scratch;                                                                     \
        REQUIRE(Get##Name);                                                                                            \
        const int status = (int)functions_of(part)->Get##Name(part->instance, references, count, numbers, n);      \
        for (size_t i = 0; i < n; i++)                                                                             \
            values[i] = (double)numbers[i];                                                                            \
        return status;                                                                                                 \
    } while (0)

static int get(Nested *part, Kind kind, const unsigned references[], size_t count, double values[], size_t n)
{
    if (kind == WHOLE_VALUE)
        GET(Int32, fmi3Int32);
    if (kind == ITEM_VALUE)
        GET(Int64, fmi3Int64);
    if (kind == TRUTH_VALUE)
        GET(Boolean, fmi3Boolean);
    CALL(GetFloat64, part->instance, references, count, values, n);
}

static int step(Nested *part, double time, double duration, Stop *stop)
{
    fmi3Boolean event = fmi3False, asked = fmi3False, early = fmi3False;
    stop->reached = time;
    const int status = (int)functions_of(part)->DoStep(part->instance, time, duration, !part->fmu->saves, &event,
                                                       &asked, &early, &stop->reached);
    stop->asked = status <= (int)fmi3Warning && asked;
    stop->early = status <= (int)fmi3Warning && early;
    return status;
}

const NestedFunctions nested_fmi3 = {
    LIBRARY_FOLDER_3, bind, instantiate, release, reset, enter, leave, terminate, set, get, step, save, restore, drop,
};
