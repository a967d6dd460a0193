/* What every instance has, of a model and of a system: messages, and the rules of what may be called, got and set. */
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

enum { LONGEST_MESSAGE = 600 };

static void report(Instance *it, Status status, const char *category, const char *format, va_list arguments)
{
    char text[LONGEST_MESSAGE], message[LONGEST_MESSAGE + sizeof MODEL_NAME + 2];
    vsnprintf(text, sizeof text, format, arguments);
    snprintf(message, sizeof message, "%s: %s", MODEL_NAME, text);
    it->report(it, status, category, message);
}

Status instance_error(Instance *it, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    report(it, STATUS_ERROR, "logStatusError", format, arguments);
    va_end(arguments);
    return STATUS_ERROR;
}

Status instance_fail(Instance *it, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    report(it, STATUS_ERROR, "logStatusError", format, arguments);
    va_end(arguments);
    it->now.mode = FAILED;
    return STATUS_ERROR;
}

Status instance_refuse(Instance *it, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    report(it, STATUS_ERROR, "logParameters", format, arguments);
    va_end(arguments);
    it->now.mode = FAILED;
    return STATUS_ERROR;
}

void instance_warn(Instance *it, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    report(it, STATUS_WARNING, "logStatusError", format, arguments);
    va_end(arguments);
}

void instance_event(Instance *it, const char *format, ...)
{
    va_list arguments;
    if (!it->logging)
        return;
    va_start(arguments, format);
    report(it, STATUS_OK, "logEvents", format, arguments);
    va_end(arguments);
}

Status instance_log(Instance *it, int on, size_t count, const char *const categories[])
{
    int events = count == 0;
    for (size_t i = 0; i < count; i++) {
        const char *name = categories && categories[i] ? categories[i] : "";
        if (strcmp(name, "logEvents") == 0)
            events = 1;
        else if (strcmp(name, "logStatusError") != 0 && strcmp(name, "logParameters") != 0)
            return instance_error(it, "has no log category '%.60s'", name);
    }
    it->logging = on && events;
    return STATUS_OK;
}

int instance_belongs(Instance *it, const char *token, const char *resources)
{
    /* What follows in the token says which defaults were built in; a write-back replaces those. */
    if (!token || strncmp(token, MODEL_TOKEN, strlen(MODEL_TOKEN)) != 0)
        instance_error(it, "the GUID or instantiation token '%.100s' is that of another FMU", token ? token : "");
    else if (!resources)
        instance_error(it, "the importer names no folder of resources");
    else
        return 1;
    return 0;
}

int instance_allows(Instance *it, int modes, const char *function)
{
    static const char *const names[] = {"instantiated", "initialization", "event", "continuous-time",
                                        "step",         "terminated",     "failed"};
    int number = 0;
    if (it->now.mode & modes)
        return 1;
    while (it->now.mode >> (number + 1))
        number++;
    instance_error(it, "%s may not be called in %s mode", function, names[number]);
    return 0;
}

const Variable *instance_find(Instance *it, unsigned reference, int types)
{
    if (reference < N_VARIABLES && (model_variables[reference].type & types))
        return &model_variables[reference];
    instance_error(it, "value reference %u is no variable of this type", reference);
    return NULL;
}

const char *instance_obstacle(const Instance *it, const Variable *variable)
{
    if (variable->role == INPUT || variable->role == TUNABLE || (variable->role == STATE && it->model_exchange))
        return NULL;
    if (variable->role == RECEIVED)
        return it->now.mode & (INSTANTIATED | INITIALIZATION) ? NULL : "is set by frames of the bus alone";
    if (variable->role != PARAMETER)
        return "is computed and cannot be set";
    return it->now.mode & (INSTANTIATED | INITIALIZATION) ? NULL : "is fixed once the initialisation is over";
}

uint64_t instance_checksum(const void *bytes, size_t size)
{
    const unsigned char *byte = (const unsigned char *)bytes;
    uint64_t hash = UINT64_C(14695981039346656037);
    for (size_t i = 0; i < size; i++)
        hash = (hash ^ byte[i]) * UINT64_C(1099511628211);
    return hash;
}
