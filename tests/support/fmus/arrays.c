/* An FMU (FMI 3.0, co-simulation) of array variables: y = gain u with sizes by the structural parameter m, and for each
 * type of two elements the output, input + parameter. What it does not need it does not have: no states, no binaries. */
#include <stdlib.h>
#include <string.h>
#include "fmi3Functions.h"

enum { MOST = 4, M = 1, GAIN, U, Y, FIRST = 100, TEN = 10, INPUT = 0, PARAMETER, OUTPUT };

typedef fmi3Int64 fmi3Level; /* an enumeration */
#define TYPES(X) X(Float32) X(Int8) X(UInt8) X(Int16) X(UInt16) X(Int32) X(UInt32) X(Int64) X(UInt64) X(Boolean) \
    X(Level)

enum {
#define NUMBER(T) AT_##T,
    TYPES(NUMBER) AT_String
};

typedef struct {
    int configuring;
    size_t m;
    double gain[MOST * MOST], u[MOST], y[MOST];
#define MEMORY(T) fmi3##T T[3][2];
    TYPES(MEMORY)
    char text[3][2][64];
} Arrays;

static void start(Arrays *a) {
    memset(a, 0, sizeof *a);
    a->m = 2;
    for (size_t i = 0; i < MOST; i++) a->u[i] = 1.0 + (double)i;
    a->gain[0] = a->gain[3] = 1.0;
}

static void *vector(Arrays *a, fmi3ValueReference r, size_t *n) {
    *n = r == GAIN ? a->m * a->m : a->m;
    return r == GAIN ? a->gain : r == U ? a->u : r == Y ? a->y : NULL;
}

static void compute(Arrays *a) {
    for (size_t i = 0; i < a->m; i++) {
        a->y[i] = 0;
        for (size_t j = 0; j < a->m; j++) a->y[i] += a->gain[i * a->m + j] * a->u[j];
    }
#define ADD(T)                                                                                                         \
    for (int i = 0; i < 2; i++) a->T[OUTPUT][i] = (fmi3##T)(a->T[INPUT][i] + a->T[PARAMETER][i]);
    TYPES(ADD)
    memcpy(a->text[OUTPUT], a->text[PARAMETER], sizeof a->text[OUTPUT]);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                         fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                         const fmi3ValueReference required[], size_t n, fmi3InstanceEnvironment e,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update) {
    Arrays *a = malloc(sizeof *a);
    start(a);
    return a;
}
void fmi3FreeInstance(fmi3Instance c) { free(c); }
fmi3Status fmi3Reset(fmi3Instance c) { start(c); return fmi3OK; }
fmi3Status fmi3Terminate(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3EnterConfigurationMode(fmi3Instance c) { ((Arrays *)c)->configuring = 1; return fmi3OK; }
fmi3Status fmi3ExitConfigurationMode(fmi3Instance c) { ((Arrays *)c)->configuring = 0; return fmi3OK; }
fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean td, fmi3Float64 t, fmi3Float64 from, fmi3Boolean sd,
                                       fmi3Float64 stop) { return fmi3OK; }
fmi3Status fmi3ExitInitializationMode(fmi3Instance c) { return fmi3OK; }
fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 h, fmi3Boolean no, fmi3Boolean *event, fmi3Boolean *end,
                      fmi3Boolean *early, fmi3Float64 *last) {
    *event = *end = *early = fmi3False;
    *last = t + h;
    return fmi3OK;
}

/* Copies whole arrays and nothing else: the number of values has to be right. */
#define EACH(FIND, COPY)                                                                                               \
    Arrays *a = c;                                                                                                     \
    size_t at = 0;                                                                                                     \
    for (size_t i = 0; i < n; i++) {                                                                                   \
        size_t size = 2;                                                                                               \
        void *there = FIND;                                                                                            \
        if (!there || at + size > total) return fmi3Error;                                                             \
        COPY;                                                                                                          \
        at += size;                                                                                                    \
    }                                                                                                                  \
    return at == total ? fmi3OK : fmi3Error;

#define PLACE(T) (r[i] / TEN == FIRST / TEN + AT_##T && r[i] % TEN < 3 ? a->T[r[i] % TEN] : NULL)
#define ACCESS(T)                                                                                                      \
    fmi3Status fmi3Get##T(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3##T v[], size_t total) {         \
        compute(c);                                                                                                    \
        EACH(FOUND(T), memcpy(v + at, there, size * sizeof *v))                                                        \
    }                                                                                                                  \
    fmi3Status fmi3Set##T(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3##T v[], size_t total) {   \
        EACH(FOUND(T), memcpy(there, v + at, size * sizeof *v))                                                        \
    }
#define FOUND PLACE
ACCESS(Float32) ACCESS(Int8) ACCESS(UInt8) ACCESS(Int16) ACCESS(UInt16) ACCESS(Int32) ACCESS(UInt32) ACCESS(Boolean)
#undef FOUND
#define FOUND(T) (PLACE(T) ? (void *)PLACE(T) : (void *)PLACE(Level))
ACCESS(Int64)
#undef FOUND
#define FOUND(T) vector(a, r[i], &size)
ACCESS(Float64)

fmi3Status fmi3GetUInt64(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3UInt64 v[], size_t total) {
    compute(c);
    EACH((r[i] == M ? (size = 1, (void *)&a->m) : (void *)PLACE(UInt64)), memcpy(v + at, there, size * sizeof *v))
}
fmi3Status fmi3SetUInt64(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3UInt64 v[], size_t total) {
    if (n && r[0] == M && !((Arrays *)c)->configuring) return fmi3Error;
    EACH((r[i] == M ? (size = 1, (void *)&a->m) : (void *)PLACE(UInt64)), memcpy(there, v + at, size * sizeof *v))
}
fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, fmi3String v[], size_t total) {
    compute(c);
    EACH(a->text[r[i] % TEN], for (int k = 0; k < 2; k++) v[at + k] = ((char(*)[64])there)[k])
}
fmi3Status fmi3SetString(fmi3Instance c, const fmi3ValueReference r[], size_t n, const fmi3String v[], size_t total) {
    EACH(a->text[r[i] % TEN], for (int k = 0; k < 2; k++) strncpy(((char(*)[64])there)[k], v[at + k], 63))
}
