/* Steps an FMU, loading its library as an importer does, and prints its outputs to the last bit after each step.
 *
 *     player LIBRARY TOKEN STEP COUNT REFERENCE...      (FMI 2.0 or 3.0, by -DFMI)
 *
 * The place of its resources comes as a line of UTF-8: Windows changes letters of arguments.
 */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _WIN32
#include <windows.h>
#define OPEN(path) ((void *)LoadLibraryA(path))
#define FIND(library, name) ((void *)GetProcAddress((HMODULE)(library), name))
#else
#include <dlfcn.h>
#define OPEN(path) dlopen(path, RTLD_NOW | RTLD_LOCAL)
#define FIND(library, name) dlsym(library, name)
#endif

enum { LONGEST_LINE = 4096, MOST_OUTPUTS = 100 };

static void *library;

static void give_up(const char *what)
{
    fprintf(stderr, "%s failed\n", what);
    exit(1);
}

static void *function(const char *name)
{
    void *found = FIND(library, name);
    if (!found)
        give_up(name);
    return found;
}

#define CALL(name, ...)                                                                                                \
    do {                                                                                                               \
        if (((FUNCTION(name))function(PREFIX #name))(__VA_ARGS__) != 0)                                                \
            give_up(#name);                                                                                            \
    } while (0)

#if FMI == 2
#include "fmi2Functions.h"
#define PREFIX "fmi2"
#define FUNCTION(name) fmi2##name##TYPE *
typedef fmi2Component Handle;

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static Handle made(const char *token, const char *resources)
{
    static const fmi2CallbackFunctions callbacks = {hear, calloc, free, NULL, NULL};
    fmi2InstantiateTYPE *instantiate = (fmi2InstantiateTYPE *)function("fmi2Instantiate");
    return instantiate("played", fmi2CoSimulation, token, resources, &callbacks, 0, 0);
}

static void begin(Handle it)
{
    CALL(SetupExperiment, it, 0, 0, 0, 0, 0);
    CALL(EnterInitializationMode, it);
    CALL(ExitInitializationMode, it);
}

static void step(Handle it, double time, double duration)
{
    CALL(DoStep, it, time, duration, 1);
}

static void get(Handle it, const unsigned *references, size_t count, double *values)
{
    CALL(GetReal, it, references, count, values);
}
#else
#include "fmi3Functions.h"
#define PREFIX "fmi3"
#define FUNCTION(name) fmi3##name##TYPE *
typedef fmi3Instance Handle;

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment, (void)status, (void)category;
    fprintf(stderr, "%s\n", message);
}

static Handle made(const char *token, const char *resources)
{
    fmi3InstantiateCoSimulationTYPE *instantiate =
        (fmi3InstantiateCoSimulationTYPE *)function("fmi3InstantiateCoSimulation");
    return instantiate("played", token, resources, 0, 0, 0, 0, NULL, 0, NULL, hear, NULL);
}

static void begin(Handle it)
{
    CALL(EnterInitializationMode, it, 0, 0, 0, 0, 0);
    CALL(ExitInitializationMode, it);
}

static void step(Handle it, double time, double duration)
{
    bool a, b, c;
    double last;
    CALL(DoStep, it, time, duration, 1, &a, &b, &c, &last);
}

static void get(Handle it, const unsigned *references, size_t count, double *values)
{
    CALL(GetFloat64, it, references, count, values, count);
}
#endif

int main(int count, char **arguments)
{
    char resources[LONGEST_LINE];
    unsigned references[MOST_OUTPUTS];
    double values[MOST_OUTPUTS];
    const size_t outputs = (size_t)count - 5;
    if (count < 6 || outputs > MOST_OUTPUTS || !fgets(resources, sizeof resources, stdin))
        give_up("reading the arguments");
    resources[strcspn(resources, "\r\n")] = '\0';
    for (size_t i = 0; i < outputs; i++)
        references[i] = (unsigned)strtoul(arguments[5 + i], NULL, 10);
    if (!(library = OPEN(arguments[1])))
        give_up("loading");
    Handle it = made(arguments[2], resources);
    if (!it)
        give_up("instantiating");
    begin(it);
    for (int k = 0; k < atoi(arguments[4]); k++) {
        step(it, k * atof(arguments[3]), atof(arguments[3]));
        get(it, references, outputs, values);
        for (size_t i = 0; i < outputs; i++)
            printf("%a%c", values[i], i + 1 < outputs ? ' ' : '\n');
    }
    ((FUNCTION(FreeInstance))function(PREFIX "FreeInstance"))(it);
    return 0;
}
