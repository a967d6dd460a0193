/* FMI 3.0 (co-simulation and model exchange) on top of instance.h. */
#include "fmi3_component.h"

#include <stdlib.h>
#include <string.h>

#include "derivatives.h"

#ifdef NETWORK
enum { CLOCKED = 1 };
#else
enum { CLOCKED = CLOCK >= 0 };
#endif

/* Modes in which a function may be called (FMI 3.0, state machines in 2.3, 3.2 and 4.2). Getting is also allowed before
 * the initialisation: the values are there, and some importers look at them. */
enum {
    RUNNING = EVENT | CONTINUOUS_TIME | STEP,
    ANY = INSTANTIATED | INITIALIZATION | RUNNING | TERMINATED | FAILED,
    CAN_SetDebugLogging = ANY,
    CAN_EnterInitializationMode = INSTANTIATED,
    CAN_ExitInitializationMode = INITIALIZATION,
    CAN_EnterEventMode = EVENT | CONTINUOUS_TIME,
    CAN_Terminate = RUNNING,
    CAN_Reset = ANY,
    CAN_Get = ANY,
    CAN_Set = INSTANTIATED | INITIALIZATION | RUNNING,
    CAN_FMUState = ANY,
    CAN_GetDerivative = INITIALIZATION | RUNNING | TERMINATED | FAILED,
    CAN_Tangents = INSTANTIATED | INITIALIZATION | STEP,
    CAN_UpdateDiscreteStates = EVENT,
    CAN_EnterContinuousTimeMode = EVENT,
    CAN_CompletedIntegratorStep = CONTINUOUS_TIME,
    CAN_SetTime = EVENT | CONTINUOUS_TIME,
    CAN_SetContinuousStates = CONTINUOUS_TIME,
    CAN_GetContinuousStates = INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED | FAILED,
    CAN_DoStep = STEP
};

#define REQUIRE(instance, modes)                                                                                       \
    do {                                                                                                               \
        if (!(instance) || !instance_allows((Instance *)(instance), modes, __func__))                                  \
            return fmi3Error;                                                                                          \
    } while (0)

static Instance *of(fmi3Instance instance)
{
    return &((Component *)instance)->instance;
}

static void report(Instance *it, Status status, const char *category, const char *message)
{
    const Component *c = (const Component *)it;
    if (c->log)
        c->log(c->environment, (fmi3Status)status, category, message);
}

/* Inquiry and logging */

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    REQUIRE(instance, CAN_SetDebugLogging);
    return (fmi3Status)instance_log(of(instance), loggingOn, nCategories, categories);
}

/* Life cycle */

static Component *instantiate(fmi3String token, fmi3String resourcePath, fmi3Boolean loggingOn,
                              fmi3InstanceEnvironment environment, fmi3LogMessageCallback log, int model_exchange)
{
    Component *c = (Component *)calloc(1, sizeof *c);
    if (!c)
        return NULL;
    c->instance.report = report;
    c->instance.logging = loggingOn;
    c->log = log;
    c->environment = environment;
    c->instance.model_exchange = model_exchange;
    if (instance_open(&c->instance, token, resourcePath) == STATUS_OK)
        return c;
    fmi3FreeInstance(c);
    return NULL;
}

/* The component, unless it was asked for something that it does not offer. */
static Component *unless(Component *c, int asked, const char *problem)
{
    if (!c || !asked)
        return c;
    instance_error(&c->instance, "%s", problem);
    fmi3FreeInstance(c);
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String instanceName, fmi3String instantiationToken,
                                          fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                          fmi3InstanceEnvironment instanceEnvironment,
                                          fmi3LogMessageCallback logMessage)
{
    (void)instanceName, (void)visible;
    Component *c = instantiate(instantiationToken, resourcePath, loggingOn, instanceEnvironment, logMessage, 1);
    return unless(c, !MODEL_EXCHANGE, "offers co-simulation only");
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String instanceName, fmi3String instantiationToken,
                                         fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                         fmi3Boolean eventModeUsed, fmi3Boolean earlyReturnAllowed,
                                         const fmi3ValueReference requiredIntermediateVariables[],
                                         size_t nRequiredIntermediateVariables,
                                         fmi3InstanceEnvironment instanceEnvironment,
                                         fmi3LogMessageCallback logMessage,
                                         fmi3IntermediateUpdateCallback intermediateUpdate)
{
    (void)instanceName, (void)visible, (void)earlyReturnAllowed;
    (void)requiredIntermediateVariables, (void)intermediateUpdate;
    Component *c = instantiate(instantiationToken, resourcePath, loggingOn, instanceEnvironment, logMessage, 0);
    if (c)
        c->events = CLOCKED && eventModeUsed;
#ifdef NETWORK
    if (c && !eventModeUsed)
        instance_warn(&c->instance, "exchanges nothing with its bus: the importer does not use event mode");
#endif
    return unless(c, nRequiredIntermediateVariables > 0, "provides no intermediate variables");
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String instanceName, fmi3String instantiationToken,
                                               fmi3String resourcePath, fmi3Boolean visible, fmi3Boolean loggingOn,
                                               fmi3InstanceEnvironment instanceEnvironment,
                                               fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
                                               fmi3LockPreemptionCallback lockPreemption,
                                               fmi3UnlockPreemptionCallback unlockPreemption)
{
    (void)instanceName, (void)visible, (void)clockUpdate, (void)lockPreemption, (void)unlockPreemption;
    Component *c = instantiate(instantiationToken, resourcePath, loggingOn, instanceEnvironment, logMessage, 0);
    return unless(c, 1, "offers no scheduled execution");
}

void fmi3FreeInstance(fmi3Instance instance)
{
    if (!instance)
        return;
    instance_close(of(instance));
    free(instance);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined, fmi3Float64 tolerance,
                                       fmi3Float64 startTime, fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    REQUIRE(instance, CAN_EnterInitializationMode);
    of(instance)->tolerance = toleranceDefined ? tolerance : 0.0;
    of(instance)->ends = stopTimeDefined;
    of(instance)->stop = stopTime;
    if (instance_begin(of(instance), startTime))
        return fmi3Error;
    of(instance)->now.mode = INITIALIZATION;
    ((Component *)instance)->told = 0;
#ifdef NETWORK
    network_begin(&((Component *)instance)->network);
#endif
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    REQUIRE(instance, CAN_ExitInitializationMode);
    if (instance_run(of(instance)))
        return fmi3Error;
    const int events = ((Component *)instance)->events || of(instance)->model_exchange;
    of(instance)->now.mode = events ? EVENT : STEP;
    return fmi3OK;
}

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    REQUIRE(instance, CAN_EnterEventMode | (instance && ((Component *)instance)->events ? STEP : 0));
    of(instance)->now.mode = EVENT;
    return fmi3OK;
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    REQUIRE(instance, CAN_Terminate);
    of(instance)->now.mode = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    REQUIRE(instance, CAN_Reset);
    instance_reset(of(instance));
    return fmi3OK;
}

/* Values: real ones are Float64, whole ones Int32, enumerations Int64 */

static Status same_count(fmi3Instance instance, size_t wanted, size_t values)
{
    if (wanted == values)
        return STATUS_OK;
    return instance_error(of(instance), "%lu values where there are %lu", (unsigned long)values, (unsigned long)wanted);
}

/* How many values lie behind a value reference; references that are none are found out when they are used. */
static size_t size_of(fmi3ValueReference reference)
{
    return reference < N_VARIABLES ? (size_t)model_variables[reference].size : 1;
}

static Status right_count(fmi3Instance instance, const fmi3ValueReference references[], size_t count, size_t values)
{
    size_t wanted = 0;
    for (size_t i = 0; i < count; i++)
        wanted += size_of(references[i]);
    return same_count(instance, wanted, values);
}

#define ACCESSORS(Name, Number, types, from_double)                                                                    \
    fmi3Status fmi3Get##Name(fmi3Instance instance, const fmi3ValueReference valueReferences[],                        \
                             size_t nValueReferences, Number values[], size_t nValues)                                 \
    {                                                                                                                  \
        REQUIRE(instance, CAN_Get);                                                                                    \
        if (right_count(instance, valueReferences, nValueReferences, nValues))                                         \
            return fmi3Error;                                                                                          \
        for (size_t i = 0; i < nValueReferences; i++)                                                                  \
            for (size_t k = 0; k < size_of(valueReferences[i]); k++) {                                                 \
                double value;                                                                                          \
                if (instance_get(of(instance), valueReferences[i] + (unsigned)k, types, &value))                       \
                    return fmi3Error;                                                                                  \
                *values++ = from_double(value);                                                                        \
            }                                                                                                          \
        return fmi3OK;                                                                                                 \
    }                                                                                                                  \
    fmi3Status fmi3Set##Name(fmi3Instance instance, const fmi3ValueReference valueReferences[],                        \
                             size_t nValueReferences, const Number values[], size_t nValues)                           \
    {                                                                                                                  \
        REQUIRE(instance, CAN_Set);                                                                                    \
        if (right_count(instance, valueReferences, nValueReferences, nValues))                                         \
            return fmi3Error;                                                                                          \
        for (size_t i = 0; i < nValueReferences; i++)                                                                  \
            for (size_t k = 0; k < size_of(valueReferences[i]); k++)                                                   \
                if (instance_set(of(instance), valueReferences[i] + (unsigned)k, types, (double)*values++))            \
                    return fmi3Error;                                                                                  \
        return fmi3OK;                                                                                                 \
    }

static int32_t whole(double value)
{
    return value >= INT32_MIN && value <= INT32_MAX ? (int32_t)value : 0;
}

static bool truth(double value)
{
    return value != 0;
}

enum { NO_TYPE = 0 };

ACCESSORS(Float64, fmi3Float64, REAL, (fmi3Float64))
ACCESSORS(Int32, fmi3Int32, INTEGER, whole)
ACCESSORS(Int64, fmi3Int64, ENUMERATION, whole)
ACCESSORS(Boolean, fmi3Boolean, BOOLEAN, truth)
ACCESSORS(Float32, fmi3Float32, NO_TYPE, (fmi3Float32))
ACCESSORS(Int8, fmi3Int8, NO_TYPE, (fmi3Int8))
ACCESSORS(UInt8, fmi3UInt8, NO_TYPE, (fmi3UInt8))
ACCESSORS(Int16, fmi3Int16, NO_TYPE, (fmi3Int16))
ACCESSORS(UInt16, fmi3UInt16, NO_TYPE, (fmi3UInt16))
ACCESSORS(UInt32, fmi3UInt32, NO_TYPE, (fmi3UInt32))
ACCESSORS(UInt64, fmi3UInt64, NO_TYPE, (fmi3UInt64))

/* States to go back to */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    REQUIRE(instance, CAN_FMUState);
    return (fmi3Status)instance_save(of(instance), FMUState);
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    REQUIRE(instance, CAN_FMUState);
    return (fmi3Status)instance_restore(of(instance), FMUState);
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    REQUIRE(instance, CAN_FMUState);
    if (FMUState) {
        instance_drop(of(instance), *FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    (void)FMUState;
    REQUIRE(instance, CAN_FMUState);
    *size = instance_serialized_size();
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState, fmi3Byte serializedState[], size_t size)
{
    REQUIRE(instance, CAN_FMUState);
    return (fmi3Status)instance_serialize(of(instance), FMUState, serializedState, size);
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[], size_t size,
                                   fmi3FMUState *FMUState)
{
    REQUIRE(instance, CAN_FMUState);
    return (fmi3Status)instance_deserialize(of(instance), serializedState, size, FMUState);
}

/* Derivatives */

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                        const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                        size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    REQUIRE(instance, CAN_GetDerivative);
    if (same_count(instance, nKnowns, nSeed) || same_count(instance, nUnknowns, nSensitivity))
        return fmi3Error;
    return (fmi3Status)instance_derivative(of(instance), unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity, 0);
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
                                    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[],
                                    size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
{
    REQUIRE(instance, CAN_GetDerivative);
    if (same_count(instance, nUnknowns, nSeed) || same_count(instance, nKnowns, nSensitivity))
        return fmi3Error;
    return (fmi3Status)instance_derivative(of(instance), unknowns, nUnknowns, knowns, nKnowns, seed, sensitivity, 1);
}

#ifndef NESTED
/* Tangents, for which FMI 3.0 has no functions; see derivatives.h */

FMI3_Export fmi3Status servotwin3CarryTangents(fmi3Instance instance, size_t directions);
FMI3_Export fmi3Status servotwin3SetTangents(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                             size_t nValueReferences, const fmi3Float64 values[], size_t nValues);
FMI3_Export fmi3Status servotwin3GetTangents(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                             size_t nValueReferences, fmi3Float64 values[], size_t nValues);

fmi3Status servotwin3CarryTangents(fmi3Instance instance, size_t directions)
{
    REQUIRE(instance, directions ? (int)CAN_Tangents : (int)ANY); /* to give them up is always possible */
    return (fmi3Status)instance_carry(of(instance), directions);
}

fmi3Status servotwin3SetTangents(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                 size_t nValueReferences, const fmi3Float64 values[], size_t nValues)
{
    REQUIRE(instance, CAN_Tangents);
    if (same_count(instance, nValueReferences * of(instance)->tangents.directions, nValues))
        return fmi3Error;
    return (fmi3Status)instance_set_tangents(of(instance), valueReferences, nValueReferences, values);
}

fmi3Status servotwin3GetTangents(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                 size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    REQUIRE(instance, CAN_Tangents);
    if (same_count(instance, nValueReferences * of(instance)->tangents.directions, nValues))
        return fmi3Error;
    return (fmi3Status)instance_get_tangents(of(instance), valueReferences, nValueReferences, values);
}

#endif

/* Events and model exchange */

fmi3Status fmi3EvaluateDiscreteStates(fmi3Instance instance)
{
    REQUIRE(instance, INITIALIZATION | EVENT);
    return fmi3OK;
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation, fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged, fmi3Boolean *nextEventTimeDefined,
                                    fmi3Float64 *nextEventTime)
{
    REQUIRE(instance, CAN_UpdateDiscreteStates);
    *discreteStatesNeedUpdate = *terminateSimulation = *nominalsOfContinuousStatesChanged = fmi3False;
    *valuesOfContinuousStatesChanged = *nextEventTimeDefined = fmi3False;
    *nextEventTime = 0.0;
#ifdef NETWORK
    network_update(&((Component *)instance)->network, of(instance));
#endif
    if (!((Component *)instance)->ticking)
        return fmi3OK;
    ((Component *)instance)->ticking = 0;
    return (fmi3Status)instance_sample(of(instance));
}

fmi3Status fmi3EnterStepMode(fmi3Instance instance)
{
    REQUIRE(instance, ((Component *)instance)->events ? EVENT : 0);
    of(instance)->now.mode = STEP;
    return fmi3OK;
}

fmi3Status fmi3EnterContinuousTimeMode(fmi3Instance instance)
{
    REQUIRE(instance, CAN_EnterContinuousTimeMode);
    if (instance_start_continuous(of(instance)))
        return fmi3Error;
    of(instance)->now.mode = CONTINUOUS_TIME;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance instance, fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi3Boolean *enterEventMode, fmi3Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(instance, CAN_CompletedIntegratorStep);
    *enterEventMode = *terminateSimulation = fmi3False;
    return (fmi3Status)instance_check_states(of(instance));
}

fmi3Status fmi3SetTime(fmi3Instance instance, fmi3Float64 time)
{
    REQUIRE(instance, CAN_SetTime);
    return (fmi3Status)instance_set_time(of(instance), time);
}

fmi3Status fmi3SetContinuousStates(fmi3Instance instance, const fmi3Float64 continuousStates[],
                                   size_t nContinuousStates)
{
    REQUIRE(instance, CAN_SetContinuousStates);
    return (fmi3Status)instance_set_states(of(instance), continuousStates, nContinuousStates);
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance instance, fmi3Float64 derivatives[],
                                             size_t nContinuousStates)
{
    REQUIRE(instance, CAN_GetContinuousStates);
    return (fmi3Status)instance_get_rates(of(instance), derivatives, nContinuousStates);
}

fmi3Status fmi3GetContinuousStates(fmi3Instance instance, fmi3Float64 continuousStates[], size_t nContinuousStates)
{
    REQUIRE(instance, CAN_GetContinuousStates);
    return (fmi3Status)instance_get_states(of(instance), continuousStates, nContinuousStates);
}

fmi3Status fmi3GetNominalsOfContinuousStates(fmi3Instance instance, fmi3Float64 nominals[], size_t nContinuousStates)
{
    REQUIRE(instance, ANY);
    return (fmi3Status)instance_get_nominals(of(instance), nominals, nContinuousStates);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    REQUIRE(instance, ANY);
    *nEventIndicators = 0;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    REQUIRE(instance, ANY);
    *nContinuousStates = N_CONTINUOUS;
    return fmi3OK;
}

/* Co-simulation */

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint, fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint, fmi3Boolean *eventHandlingNeeded,
                      fmi3Boolean *terminateSimulation, fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(instance, CAN_DoStep);
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    const Status status = instance_step(of(instance), currentCommunicationPoint, communicationStepSize);
    *lastSuccessfulTime = of(instance)->now.time;
    *terminateSimulation = of(instance)->now.over != 0;
    return of(instance)->now.over ? fmi3OK : (fmi3Status)status;
}
