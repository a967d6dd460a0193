/* FMUs of FMI 2.0 within a system. */
#include "fmi2FunctionTypes.h"

#include <stdarg.h>
#include <stdio.h>

#define FMI(name) fmi2##name
#define FMI_TYPE(name) fmi2##name##TYPE
#define STATE(verb) verb##FMUstate
#define FUNCTIONS(X)                                                                                                   \
    X(SetDebugLogging, 0)                                                                                              \
    X(Instantiate, 1) X(FreeInstance, 0) X(SetupExperiment, 1) X(EnterInitializationMode, 1)                           \
    X(ExitInitializationMode, 1) X(Terminate, 0) X(Reset, 0) X(GetReal, 0) X(GetInteger, 0) X(GetBoolean, 0)           \
    X(SetReal, 0) X(SetInteger, 0) X(SetBoolean, 0) X(GetFMUstate, 0) X(SetFMUstate, 0) X(FreeFMUstate, 0)             \
    X(DoStep, 1) X(GetBooleanStatus, 0) X(GetRealStatus, 0)

#include "nested_binding.h"

static void said(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...)
{
    char text[900];
    va_list arguments;
    (void)name;
    va_start(arguments, message);
    vsnprintf(text, sizeof text, message ? message : "", arguments);
    va_end(arguments);
    nested_said((Nested *)environment, (int)status, category, text);
}

static Status instantiate(Nested *part)
{
    const fmi2CallbackFunctions callbacks = {said, calloc, free, NULL, part};
    if (!part->callbacks && !(part->callbacks = malloc(sizeof callbacks)))
        return STATUS_ERROR;
    *(fmi2CallbackFunctions *)part->callbacks = callbacks;
    char *resources = nested_place(part, "/resources", 1);
    if (resources)
        part->instance = functions_of(part)->Instantiate(
            system_parts[part->number].name, fmi2CoSimulation, part->fmu->token, resources,
            (const fmi2CallbackFunctions *)part->callbacks, fmi2False, part->owner->logging);
    free(resources);
    return ask_for_trouble(part);
}

static int enter(Nested *part)
{
    const Instance *it = part->owner;
    const double tolerance = tolerance_of(part);
    const int status = (int)functions_of(part)->SetupExperiment(part->instance, tolerance > 0, tolerance, part->start,
                                                                it->ends, it->stop);
    return status > (int)fmi2Warning ? status : (int)functions_of(part)->EnterInitializationMode(part->instance);
}

/* There are no arrays: there are as many values as references. */
static int set(Nested *part, Kind kind, const unsigned references[], size_t count, const double values[], size_t n)
{
    (void)n;
    fmi2Integer *numbers = (fmi2Integer *)part->scratch;
    if (kind == REAL_VALUE)
        CALL(SetReal, part->instance, references, count, values);
    for (size_t i = 0; i < count; i++)
        if (kind == TRUTH_VALUE)
            numbers[i] = values[i] != 0;
        else if (!nested_whole(part, values[i], &numbers[i]))
            return (int)fmi2Error;
    if (kind == TRUTH_VALUE)
        CALL(SetBoolean, part->instance, references, count, numbers);
    CALL(SetInteger, part->instance, references, count, numbers);
}

static int get_numbers(Nested *part, Kind kind, const unsigned references[], size_t count, fmi2Integer numbers[])
{
    if (kind == TRUTH_VALUE)
        CALL(GetBoolean, part->instance, references, count, numbers);
    CALL(GetInteger, part->instance, references, count, numbers);
}

static int get(Nested *part, Kind kind, const unsigned references[], size_t count, double values[], size_t n)
{
    (void)n;
    fmi2Integer *numbers = (fmi2Integer *)part->scratch;
    if (kind == REAL_VALUE)
        CALL(GetReal, part->instance, references, count, values);
    const int status = get_numbers(part, kind, references, count, numbers);
    for (size_t i = 0; i < count; i++)
        values[i] = kind == TRUTH_VALUE ? numbers[i] != 0 : numbers[i];
    return status;
}

static int step(Nested *part, double time, double duration, Stop *stop)
{
    const Functions *f = functions_of(part);
    fmi2Boolean asked = fmi2False;
    const int status = (int)f->DoStep(part->instance, time, duration, !part->fmu->saves);
    if (status != (int)fmi2Discard || !f->GetBooleanStatus || !f->GetRealStatus)
        return status;
    stop->reached = time;
    f->GetBooleanStatus(part->instance, fmi2Terminated, &asked);
    f->GetRealStatus(part->instance, fmi2LastSuccessfulTime, &stop->reached);
    stop->asked = asked != fmi2False;
    return status;
}

const NestedFunctions nested_fmi2 = {
    LIBRARY_FOLDER_2, bind, instantiate, release, reset, enter, leave, terminate, set, get, step, save, restore, drop,
};
