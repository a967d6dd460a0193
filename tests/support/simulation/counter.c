/* A counter (FMI 2.0, or 3.0 by -DFMI=3, co-simulation): values of all plain types in and out.
 *
 * Each step adds `by` to `count` where `on`, and gain * h * count to `total`. It has only what a plain run calls.
 */
#include <stdbool.h>
#include <stdlib.h>

#if FMI == 3
#include "fmi3Functions.h"
#define F(name) fmi3##name
#define EXPORT FMI3_Export
typedef fmi3Instance Handle;
typedef fmi3Status Status;
typedef fmi3ValueReference Reference;
typedef bool Truth;
#define COUNT(n) , size_t n
#else
#include "fmi2Functions.h"
#define F(name) fmi2##name
#define EXPORT FMI2_Export
typedef fmi2Component Handle;
typedef fmi2Status Status;
typedef fmi2ValueReference Reference;
typedef int Truth;
#define COUNT(n)
#endif

typedef struct {
    double gain, total;
    int by, count, level;
    int on, odd;
} Counter;

static Handle made(void)
{
    Counter *c = calloc(1, sizeof *c);
    c->gain = 1.0;
    c->by = 1;
    c->level = 2;
    return c;
}

static void advance(Counter *c, double h)
{
    c->count += c->on ? c->by * c->level : 0;
    c->odd = c->count % 2 != 0;
    c->total += c->gain * h * c->count;
}

#define ACCESS(Name, Number, Type, of)                                                                                 \
    EXPORT Status F(Get##Name)(Handle h, const Reference r[], size_t n, Number v[] COUNT(m))                           \
    {                                                                                                                  \
        Type *const own[] = of(h);                                                                                     \
        for (size_t i = 0; i < n; i++)                                                                                 \
            v[i] = (Number)*own[r[i] % 10];                                                                            \
        return F(OK);                                                                                                  \
    }                                                                                                                  \
    EXPORT Status F(Set##Name)(Handle h, const Reference r[], size_t n, const Number v[] COUNT(m))                     \
    {                                                                                                                  \
        Type *const own[] = of(h);                                                                                     \
        for (size_t i = 0; i < n; i++)                                                                                 \
            *own[r[i] % 10] = (Type)v[i];                                                                              \
        return F(OK);                                                                                                  \
    }
#define REALS(h) {&((Counter *)h)->gain, &((Counter *)h)->total}
#define WHOLES(h) {&((Counter *)h)->by, &((Counter *)h)->count, &((Counter *)h)->level}
#define TRUTHS(h) {&((Counter *)h)->on, &((Counter *)h)->odd}

EXPORT void F(FreeInstance)(Handle h) { free(h); }
EXPORT Status F(ExitInitializationMode)(Handle h) { return F(OK); }
EXPORT Status F(Terminate)(Handle h) { return F(OK); }

#if FMI == 3
EXPORT Handle fmi3InstantiateCoSimulation(fmi3String name, fmi3String token, fmi3String path, fmi3Boolean visible,
                                          fmi3Boolean logging, fmi3Boolean events, fmi3Boolean early,
                                          const Reference needed[], size_t count, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback update)
{
    return made();
}
EXPORT Status fmi3EnterInitializationMode(Handle h, fmi3Boolean a, double b, double c, fmi3Boolean d, double e) { return F(OK); }
EXPORT Status fmi3DoStep(Handle h, double t, double d, fmi3Boolean keep, fmi3Boolean *event, fmi3Boolean *end,
                         fmi3Boolean *early, double *reached)
{
    advance(h, d);
    *event = *end = *early = false;
    *reached = t + d;
    return F(OK);
}
ACCESS(Float64, double, double, REALS)
ACCESS(Int32, int32_t, int, WHOLES)
ACCESS(Int64, int64_t, int, WHOLES)
#else
EXPORT Handle fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String resources,
                              const fmi2CallbackFunctions *host, fmi2Boolean visible, fmi2Boolean logging)
{
    return made();
}
EXPORT Status fmi2SetupExperiment(Handle h, int a, double b, double c, int d, double e) { return F(OK); }
EXPORT Status fmi2EnterInitializationMode(Handle h) { return F(OK); }
EXPORT Status fmi2DoStep(Handle h, double t, double d, int keep) { advance(h, d); return F(OK); }
ACCESS(Real, double, double, REALS)
ACCESS(Integer, int, int, WHOLES)
#endif
ACCESS(Boolean, Truth, int, TRUTHS)
