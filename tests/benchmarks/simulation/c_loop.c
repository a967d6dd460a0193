/* What a programmer would write by hand: FMUs (FMI 2.0) in a ring, Jacobi order, outputs recorded at every step. */
#include <dlfcn.h>
#include <stdlib.h>
#include <time.h>
#include "fmi2FunctionTypes.h"

#define REALS 2    /* outputs of one FMU by type */
#define INTEGERS 2
#define BOOLEANS 1
#define OUTPUTS (REALS + INTEGERS + BOOLEANS)
#define MOST 256

static const fmi2ValueReference input[] = {7}, constant_real[] = {9}, constant_integer[] = {19};
static const fmi2ValueReference reals[] = {8, 10}, integers[] = {20, 34}, booleans[] = {28};

static void quiet(fmi2ComponentEnvironment e, fmi2String i, fmi2Status s, fmi2String c, fmi2String m, ...) {}
static const fmi2CallbackFunctions callbacks = {quiet, calloc, free, NULL, NULL};

static double now(void) {
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

static void *symbol(void *library, const char *name) {
    void *found = dlsym(library, name);
    if (!found) abort();
    return found;
}

/* Steps `count` FMUs. The record is (steps + 1, count * OUTPUTS), or (steps + 1, count) of the outputs that drive the
   ring where not all are wanted. Returns the processor's seconds from the first step to the last, a negative number
   where an FMU failed. */
double ring(const char *path, const char *guid, const char *resources, int count, long steps, double h, int all,
            double *record) {
    void *library = dlopen(path, RTLD_NOW);
    if (!library || count > MOST) return -1;
    fmi2InstantiateTYPE *instantiate = symbol(library, "fmi2Instantiate");
    fmi2SetupExperimentTYPE *setup = symbol(library, "fmi2SetupExperiment");
    fmi2EnterInitializationModeTYPE *enter = symbol(library, "fmi2EnterInitializationMode");
    fmi2ExitInitializationModeTYPE *leave = symbol(library, "fmi2ExitInitializationMode");
    fmi2FreeInstanceTYPE *release = symbol(library, "fmi2FreeInstance");
    fmi2SetRealTYPE *set_real = symbol(library, "fmi2SetReal");
    fmi2SetIntegerTYPE *set_integer = symbol(library, "fmi2SetInteger");
    fmi2GetRealTYPE *get_real = symbol(library, "fmi2GetReal");
    fmi2GetIntegerTYPE *get_integer = symbol(library, "fmi2GetInteger");
    fmi2GetBooleanTYPE *get_boolean = symbol(library, "fmi2GetBoolean");
    fmi2DoStepTYPE *step = symbol(library, "fmi2DoStep");

    fmi2Component fmu[MOST];
    fmi2Real real[MOST][REALS] = {{0}};
    fmi2Integer integer[MOST][INTEGERS];
    fmi2Boolean boolean[MOST][BOOLEANS];
    int bad = 0;
    for (int i = 0; i < count; i++) {
        fmu[i] = instantiate("fmu", fmi2CoSimulation, guid, resources, &callbacks, fmi2False, fmi2False);
        if (!fmu[i]) return -1;
        bad |= setup(fmu[i], fmi2False, 0, 0, fmi2False, 0);
        bad |= enter(fmu[i]);
        double real_start = i + 0.5;
        int integer_start = i + 1;
        bad |= set_real(fmu[i], constant_real, 1, &real_start);
        bad |= set_integer(fmu[i], constant_integer, 1, &integer_start);
    }
    double passed = 0;
    for (int i = 0; i < count; i++) {
        bad |= set_real(fmu[i], input, 1, &passed);
        bad |= get_real(fmu[i], reals, 1, &passed);
    }
    for (int i = 0; i < count; i++) {
        bad |= leave(fmu[i]);
        bad |= get_real(fmu[i], reals, REALS, real[i]);
        bad |= get_integer(fmu[i], integers, INTEGERS, integer[i]);
        bad |= get_boolean(fmu[i], booleans, BOOLEANS, boolean[i]);
    }

    double begun = now();
    for (long k = 0; k <= steps && bad == 0; k++) {
        double *row = record + k * count * (all ? OUTPUTS : 1);
        for (int i = 0; i < count; i++) {
            *row++ = real[i][0];
            if (!all) continue;
            for (int j = 1; j < REALS; j++) *row++ = real[i][j];
            for (int j = 0; j < INTEGERS; j++) *row++ = integer[i][j];
            for (int j = 0; j < BOOLEANS; j++) *row++ = boolean[i][j];
        }
        if (k == steps) break;
        passed = real[count - 1][0];
        for (int i = 0; i < count; i++) { /* every input has the value from before the step */
            double u = passed;
            passed = real[i][0];
            bad |= set_real(fmu[i], input, 1, &u);
            bad |= step(fmu[i], k * h, h, fmi2True);
            bad |= get_real(fmu[i], reals, all ? REALS : 1, real[i]);
            if (!all) continue;
            bad |= get_integer(fmu[i], integers, INTEGERS, integer[i]);
            bad |= get_boolean(fmu[i], booleans, BOOLEANS, boolean[i]);
        }
    }
    double seconds = now() - begun;
    for (int i = 0; i < count; i++) release(fmu[i]);
    return bad ? -1 : seconds;
}
