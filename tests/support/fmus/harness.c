/* Calls everything that an FMU exports, well and badly; built together with its sources and sanitizers.
 *
 *     harness TOKEN RESOURCES      (FMI 2.0 or 3.0, by -DFMI; -DNESTED with FMUs inside, which have no tangents and
 *                                   whose states are not serialised)
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MOST 200

static int messages;

#if FMI == 2
#include "fmi2Functions.h"
#define F(name) fmi2##name
#define STATE(name) fmi2##name##FMUstate
typedef fmi2Component Handle;
typedef fmi2FMUstate State;
typedef fmi2Byte Byte;
#define DESERIALIZE fmi2DeSerializeFMUstate
#define STATE_SIZE fmi2SerializedFMUstateSize

static void hear(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                 fmi2String message, ...)
{
    (void)environment, (void)name, (void)status, (void)category;
    messages += message != NULL;
}

static const fmi2CallbackFunctions callbacks = {hear, calloc, free, NULL, NULL};

static Handle made(const char *token, const char *resources, int exchange)
{
    return fmi2Instantiate("harness", exchange ? fmi2ModelExchange : fmi2CoSimulation, token, resources, &callbacks, 0, 1);
}

static void begin(Handle it)
{
    fmi2SetupExperiment(it, 0, 0, 0, 0, 0);
    fmi2EnterInitializationMode(it);
}

static int step(Handle it, double time, double duration)
{
    return fmi2DoStep(it, time, duration, 1);
}

static void values(Handle it)
{
    for (unsigned vr = 0; vr < MOST; vr++) {
        double real;
        int whole;
        if (fmi2GetReal(it, &vr, 1, &real) == fmi2OK)
            fmi2SetReal(it, &vr, 1, &real);
        if (fmi2GetInteger(it, &vr, 1, &whole) == fmi2OK)
            fmi2SetInteger(it, &vr, 1, &whole);
        if (fmi2GetBoolean(it, &vr, 1, &whole) == fmi2OK)
            fmi2SetBoolean(it, &vr, 1, &whole);
    }
}

static void derivative(Handle it, unsigned unknown, unsigned known)
{
    double seed = 1, result;
    fmi2GetDirectionalDerivative(it, &unknown, 1, &known, 1, &seed, &result);
}

#ifndef NESTED
fmi2Status servotwin2CarryTangents(Handle it, size_t directions);
fmi2Status servotwin2SetTangents(Handle it, const unsigned vr[], size_t count, const double values[]);
fmi2Status servotwin2GetTangents(Handle it, const unsigned vr[], size_t count, double values[]);

static void carry(Handle it, size_t directions)
{
    double row[5] = {1};
    servotwin2CarryTangents(it, directions);
    for (unsigned vr = 0; vr < MOST; vr++) {
        servotwin2SetTangents(it, &vr, 1, row);
        servotwin2GetTangents(it, &vr, 1, row);
    }
}
#endif

static void exchange(Handle it)
{
    fmi2EventInfo info;
    fmi2Boolean event, end;
    double x[MOST] = {0};
    fmi2NewDiscreteStates(it, &info);
    fmi2EnterContinuousTimeMode(it);
    for (size_t n = 0; n < 8; n++) {
        fmi2SetTime(it, 0.1);
        if (fmi2GetContinuousStates(it, x, n) == fmi2OK) {
            fmi2SetContinuousStates(it, x, n);
            fmi2GetDerivatives(it, x, n);
            fmi2GetNominalsOfContinuousStates(it, x, n);
        }
    }
    fmi2GetEventIndicators(it, x, 0);
    fmi2CompletedIntegratorStep(it, 1, &event, &end);
    fmi2EnterEventMode(it);
}
#else
#include "fmi3Functions.h"
#define F(name) fmi3##name
#define STATE(name) fmi3##name##FMUState
typedef fmi3Instance Handle;
typedef fmi3FMUState State;
typedef fmi3Byte Byte;
#define DESERIALIZE fmi3DeserializeFMUState
#define STATE_SIZE fmi3SerializedFMUStateSize

static void hear(fmi3InstanceEnvironment environment, fmi3Status status, fmi3String category, fmi3String message)
{
    (void)environment, (void)status, (void)category;
    messages += message != NULL;
}

static Handle made(const char *token, const char *resources, int exchange)
{
    return exchange ? fmi3InstantiateModelExchange("harness", token, resources, 0, 1, NULL, hear)
                    : fmi3InstantiateCoSimulation("harness", token, resources, 0, 1, 0, 0, NULL, 0, NULL, hear, NULL);
}

static void begin(Handle it)
{
    fmi3EnterInitializationMode(it, 0, 0, 0, 0, 0);
}

static int step(Handle it, double time, double duration)
{
    bool a, b, c;
    double last;
    return fmi3DoStep(it, time, duration, 1, &a, &b, &c, &last);
}

static void values(Handle it)
{
    for (unsigned vr = 0; vr < MOST; vr++) {
        double real[5];
        int32_t whole;
        int64_t item;
        bool truth;
        uint8_t byte;
        for (size_t n = 0; n < 5; n++) /* one value, all of a small array, or a wrong number */
            if (fmi3GetFloat64(it, &vr, 1, real, n) == fmi3OK)
                fmi3SetFloat64(it, &vr, 1, real, n);
        if (fmi3GetInt32(it, &vr, 1, &whole, 1) == fmi3OK)
            fmi3SetInt32(it, &vr, 1, &whole, 1);
        if (fmi3GetInt64(it, &vr, 1, &item, 1) == fmi3OK)
            fmi3SetInt64(it, &vr, 1, &item, 1);
        if (fmi3GetBoolean(it, &vr, 1, &truth, 1) == fmi3OK)
            fmi3SetBoolean(it, &vr, 1, &truth, 1);
        fmi3GetUInt8(it, &vr, 1, &byte, 1);
    }
}

static void derivative(Handle it, unsigned unknown, unsigned known)
{
    double seed = 1, result;
    fmi3GetDirectionalDerivative(it, &unknown, 1, &known, 1, &seed, 1, &result, 1);
    fmi3GetAdjointDerivative(it, &unknown, 1, &known, 1, &seed, 1, &result, 1);
}

#ifndef NESTED
fmi3Status servotwin3CarryTangents(Handle it, size_t directions);
fmi3Status servotwin3SetTangents(Handle it, const unsigned vr[], size_t count, const double values[], size_t size);
fmi3Status servotwin3GetTangents(Handle it, const unsigned vr[], size_t count, double values[], size_t size);

static void carry(Handle it, size_t directions)
{
    double row[5] = {1};
    servotwin3CarryTangents(it, directions);
    for (unsigned vr = 0; vr < MOST; vr++) {
        servotwin3SetTangents(it, &vr, 1, row, 5);
        servotwin3SetTangents(it, &vr, 1, row, 4);
        servotwin3GetTangents(it, &vr, 1, row, 5);
    }
}
#endif

static void exchange(Handle it)
{
    bool a, b, c, d, e;
    double next, x[MOST] = {0};
    size_t n;
    fmi3UpdateDiscreteStates(it, &a, &b, &c, &d, &e, &next);
    fmi3EnterContinuousTimeMode(it);
    fmi3SetTime(it, 0.1);
    fmi3GetNumberOfContinuousStates(it, &n);
    fmi3GetContinuousStates(it, x, n);
    fmi3SetContinuousStates(it, x, n);
    fmi3GetContinuousStateDerivatives(it, x, n);
    fmi3GetNominalsOfContinuousStates(it, x, n);
    fmi3GetContinuousStates(it, x, n + 1);
    fmi3GetEventIndicators(it, x, 0);
    fmi3CompletedIntegratorStep(it, 1, &a, &b);
    fmi3EnterEventMode(it);
}
#endif

#ifdef NESTED
#define carry(it, directions) (void)0
#endif

static int keep(Handle it)
{
    State state = NULL, again = NULL;
    size_t size = 0;
    STATE(Get)(it, &state);
    STATE(Get)(it, &state); /* into the same memory */
    STATE_SIZE(it, state, &size);
    Byte *bytes = malloc(size);
    STATE(Serialize)(it, state, bytes, size);
    STATE(Serialize)(it, state, bytes, size - 1);
    DESERIALIZE(it, bytes, size - 1, &again);
    DESERIALIZE(it, bytes, size, &again);
#ifdef NESTED
    const int same = !again && STATE(Set)(it, state) == 0;
#else
    const int same = again && STATE(Set)(it, again) == 0 && STATE(Set)(it, state) == 0;
#endif
    STATE(Free)(it, &state);
    STATE(Free)(it, &state);
    STATE(Free)(it, &again);
    STATE(Set)(it, NULL);
    free(bytes);
    return same;
}

static int live(const char *token, const char *resources, int as_exchange)
{
    Handle it = made(token, resources, as_exchange);
    if (!it)
        return as_exchange; /* models without model exchange refuse it */
    for (int round = 0; round < 2; round++) {
        values(it);
        carry(it, 0);
        carry(it, round ? 5 : 0);
        begin(it);
        values(it);
        carry(it, round ? 5 : 0);
        for (unsigned unknown = 0; unknown < 40; unknown++)
            for (unsigned known = 0; known < 40; known++)
                derivative(it, unknown, known);
        F(ExitInitializationMode)(it);
        values(it);
        if (as_exchange)
            exchange(it);
        for (int k = 0; k < 50; k++)
            step(it, 0.013 * k, 0.013);
        step(it, 0.65, 0.0);
        step(it, 0.65, -1.0);
        step(it, 0.65, NAN);
        carry(it, 0);
        if (!keep(it))
            return 0;
        values(it);
        F(Terminate)(it);
        F(Reset)(it);
    }
    F(FreeInstance)(it);
    F(FreeInstance)(NULL);
    return 1;
}

int main(int count, char **arguments)
{
    if (count < 3 || made("another", arguments[2], 0) || made(arguments[1], "/nowhere", 0) || messages < 2)
        return 1;
    if (step(NULL, 0, 0) == 0)
        return 2;
    return live(arguments[1], arguments[2], 0) && live(arguments[1], arguments[2], 1) ? 0 : 3;
}
