/* FMI 2.0 (co-simulation and model exchange) on top of instance.h. */
#include "fmi2Functions.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "derivatives.h"

typedef struct {
    Instance instance; /* first, so that a pointer to it is one to the component */
    fmi2CallbackFunctions callbacks;
    char *name;
} Component;

/* Modes in which a function may be called (FMI 2.0, state machines in 3.2.3 and 4.2.4). Getting is also allowed before
 * the initialisation: the values are there, and some importers look at them. */
enum {
    RUNNING = EVENT | CONTINUOUS_TIME | STEP,
    ANY = INSTANTIATED | INITIALIZATION | RUNNING | TERMINATED | FAILED,
    CAN_SetDebugLogging = ANY,
    CAN_SetupExperiment = INSTANTIATED,
    CAN_EnterInitializationMode = INSTANTIATED,
    CAN_ExitInitializationMode = INITIALIZATION,
    CAN_Terminate = RUNNING,
    CAN_Reset = ANY,
    CAN_Get = ANY,
    CAN_Set = INSTANTIATED | INITIALIZATION | RUNNING,
    CAN_FMUstate = ANY,
    CAN_GetDirectionalDerivative = INITIALIZATION | RUNNING | TERMINATED | FAILED,
    CAN_Tangents = INSTANTIATED | INITIALIZATION | STEP,
    CAN_EnterEventMode = EVENT | CONTINUOUS_TIME,
    CAN_NewDiscreteStates = EVENT,
    CAN_EnterContinuousTimeMode = EVENT,
    CAN_CompletedIntegratorStep = CONTINUOUS_TIME,
    CAN_SetTime = EVENT | CONTINUOUS_TIME,
    CAN_SetContinuousStates = CONTINUOUS_TIME,
    CAN_GetContinuousStates = INITIALIZATION | EVENT | CONTINUOUS_TIME | TERMINATED | FAILED,
    CAN_DoStep = STEP,
    CAN_GetStatus = STEP | TERMINATED | FAILED
};

#define REQUIRE(c, modes)                                                                                              \
    do {                                                                                                               \
        if (!(c) || !instance_allows((Instance *)(c), modes, __func__))                                                \
            return fmi2Error;                                                                                          \
    } while (0)

static Instance *of(fmi2Component c)
{
    return &((Component *)c)->instance;
}

/* FMI 2.0 takes a format; percent signs in the message must not act as one. */
static void report(Instance *it, Status status, const char *category, const char *message)
{
    Component *c = (Component *)it;
    char format[1600];
    size_t length = 0;
    if (!c->callbacks.logger)
        return;
    for (; *message && length + 3 < sizeof format; message++) {
        if (*message == '%')
            format[length++] = '%';
        format[length++] = *message;
    }
    format[length] = '\0';
    c->callbacks.logger(c->callbacks.componentEnvironment, c->name, (fmi2Status)status, category, format);
}

/* Inquiry and logging */

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    REQUIRE(c, CAN_SetDebugLogging);
    return (fmi2Status)instance_log(of(c), loggingOn, nCategories, categories);
}

/* Life cycle */

static int digit(char c)
{
    return c >= '0' && c <= '9' ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
}

/* The path that a file URI names, as a new string; what is no file URI is taken as a path already. */
static char *path_of(const char *uri)
{
    const int is_uri = strncmp(uri, "file:", 5) == 0;
    char *path = (char *)malloc(strlen(uri) + 1), *end = path;
    if (!path)
        return NULL;
    if (is_uri) {
        uri += 5;
        if (strncmp(uri, "//localhost/", 12) == 0)
            uri += 11;
        else if (strncmp(uri, "///", 3) == 0)
            uri += 2;
        if (uri[0] == '/' && uri[1] && uri[2] == ':') /* a drive of Windows */
            uri++;
    }
    for (; *uri; uri++) {
        if (is_uri && *uri == '%' && digit(uri[1]) >= 0 && digit(uri[2]) >= 0) {
            *end++ = (char)(16 * digit(uri[1]) + digit(uri[2]));
            uri += 2;
        } else {
            *end++ = *uri;
        }
    }
    *end = '\0';
    return path;
}

static char *copy_of(const char *text)
{
    char *copy = (char *)malloc(strlen(text) + 1);
    return copy ? strcpy(copy, text) : NULL;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation, const fmi2CallbackFunctions *functions,
                              fmi2Boolean visible, fmi2Boolean loggingOn)
{
    (void)visible;
    Component *c = functions ? (Component *)calloc(1, sizeof *c) : NULL;
    if (!c)
        return NULL;
    Instance *it = &c->instance;
    it->report = report;
    it->logging = loggingOn;
    it->model_exchange = fmuType == fmi2ModelExchange;
    c->callbacks = *functions;
    c->name = copy_of(instanceName ? instanceName : "");
    char *resources = fmuResourceLocation ? path_of(fmuResourceLocation) : NULL;
    Status status = c->name ? instance_open(it, fmuGUID, resources) : STATUS_ERROR;
    free(resources);
    if (status == STATUS_OK && it->model_exchange && !MODEL_EXCHANGE)
        status = instance_error(it, "offers co-simulation only");
    if (status == STATUS_OK)
        return c;
    fmi2FreeInstance(c);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (!c)
        return;
    instance_close(of(c));
    free(((Component *)c)->name);
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance, fmi2Real startTime,
                               fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    REQUIRE(c, CAN_SetupExperiment);
    of(c)->tolerance = toleranceDefined ? tolerance : 0.0;
    of(c)->ends = stopTimeDefined;
    of(c)->stop = stopTime;
    return (fmi2Status)instance_begin(of(c), startTime);
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    REQUIRE(c, CAN_EnterInitializationMode);
    of(c)->now.mode = INITIALIZATION;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    REQUIRE(c, CAN_ExitInitializationMode);
    if (instance_run(of(c)))
        return fmi2Error;
    of(c)->now.mode = of(c)->model_exchange ? EVENT : STEP;
    return fmi2OK;
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    REQUIRE(c, CAN_Terminate);
    of(c)->now.mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    REQUIRE(c, CAN_Reset);
    instance_reset(of(c));
    return fmi2OK;
}

/* Values */

static int whole(double value)
{
    return value >= INT_MIN && value <= INT_MAX ? (int)value : 0;
}

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    REQUIRE(c, CAN_Get);
    for (size_t i = 0; i < nvr; i++)
        if (instance_get(of(c), vr[i], REAL, &value[i]))
            return fmi2Error;
    return fmi2OK;
}

static fmi2Status get_int(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, int types, int value[])
{
    for (size_t i = 0; i < nvr; i++) {
        double number;
        if (instance_get(of(c), vr[i], types, &number))
            return fmi2Error;
        value[i] = whole(number);
    }
    return fmi2OK;
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Integer value[])
{
    REQUIRE(c, CAN_Get);
    return get_int(c, vr, nvr, INTEGER | ENUMERATION, value);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Boolean value[])
{
    REQUIRE(c, CAN_Get);
    return get_int(c, vr, nvr, BOOLEAN, value);
}

static fmi2Status no_strings(fmi2Component c, size_t nvr)
{
    return nvr ? (fmi2Status)instance_error(of(c), "has no strings") : fmi2OK;
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2String value[])
{
    (void)vr, (void)value;
    REQUIRE(c, CAN_Get);
    return no_strings(c, nvr);
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    REQUIRE(c, CAN_Set);
    for (size_t i = 0; i < nvr; i++)
        if (instance_set(of(c), vr[i], REAL, value[i]))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Integer value[])
{
    REQUIRE(c, CAN_Set);
    for (size_t i = 0; i < nvr; i++)
        if (instance_set(of(c), vr[i], INTEGER | ENUMERATION, value[i]))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Boolean value[])
{
    REQUIRE(c, CAN_Set);
    for (size_t i = 0; i < nvr; i++)
        if (instance_set(of(c), vr[i], BOOLEAN, value[i] != 0))
            return fmi2Error;
    return fmi2OK;
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2String value[])
{
    (void)vr, (void)value;
    REQUIRE(c, CAN_Set);
    return no_strings(c, nvr);
}

/* States to go back to */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    REQUIRE(c, CAN_FMUstate);
    return (fmi2Status)instance_save(of(c), FMUstate);
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    REQUIRE(c, CAN_FMUstate);
    return (fmi2Status)instance_restore(of(c), FMUstate);
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    REQUIRE(c, CAN_FMUstate);
    if (FMUstate) {
        instance_drop(of(c), *FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    (void)FMUstate;
    REQUIRE(c, CAN_FMUstate);
    *size = instance_serialized_size();
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate, fmi2Byte serializedState[], size_t size)
{
    REQUIRE(c, CAN_FMUstate);
    return (fmi2Status)instance_serialize(of(c), FMUstate, serializedState, size);
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    REQUIRE(c, CAN_FMUstate);
    return (fmi2Status)instance_deserialize(of(c), serializedState, size, FMUstate);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference vUnknown_ref[], size_t nUnknown,
                                        const fmi2ValueReference vKnown_ref[], size_t nKnown, const fmi2Real dvKnown[],
                                        fmi2Real dvUnknown[])
{
    REQUIRE(c, CAN_GetDirectionalDerivative);
    return (fmi2Status)instance_derivative(of(c), vUnknown_ref, nUnknown, vKnown_ref, nKnown, dvKnown, dvUnknown, 0);
}

#ifndef NESTED
/* Tangents, for which FMI 2.0 has no functions; see derivatives.h */

FMI2_Export fmi2Status servotwin2CarryTangents(fmi2Component c, size_t directions);
FMI2_Export fmi2Status servotwin2SetTangents(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                             const fmi2Real value[]);
FMI2_Export fmi2Status servotwin2GetTangents(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                             fmi2Real value[]);

fmi2Status servotwin2CarryTangents(fmi2Component c, size_t directions)
{
    REQUIRE(c, directions ? (int)CAN_Tangents : (int)ANY); /* to give them up is always possible */
    return (fmi2Status)instance_carry(of(c), directions);
}

fmi2Status servotwin2SetTangents(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, const fmi2Real value[])
{
    REQUIRE(c, CAN_Tangents);
    return (fmi2Status)instance_set_tangents(of(c), vr, nvr, value);
}

fmi2Status servotwin2GetTangents(fmi2Component c, const fmi2ValueReference vr[], size_t nvr, fmi2Real value[])
{
    REQUIRE(c, CAN_Tangents);
    return (fmi2Status)instance_get_tangents(of(c), vr, nvr, value);
}

#endif

/* Model exchange */

fmi2Status fmi2EnterEventMode(fmi2Component c)
{
    REQUIRE(c, CAN_EnterEventMode);
    of(c)->now.mode = EVENT;
    return fmi2OK;
}

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *fmi2eventInfo)
{
    REQUIRE(c, CAN_NewDiscreteStates);
    memset(fmi2eventInfo, 0, sizeof *fmi2eventInfo);
    return fmi2OK;
}

fmi2Status fmi2EnterContinuousTimeMode(fmi2Component c)
{
    REQUIRE(c, CAN_EnterContinuousTimeMode);
    if (instance_start_continuous(of(c)))
        return fmi2Error;
    of(c)->now.mode = CONTINUOUS_TIME;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean noSetFMUStatePriorToCurrentPoint,
                                       fmi2Boolean *enterEventMode, fmi2Boolean *terminateSimulation)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(c, CAN_CompletedIntegratorStep);
    *enterEventMode = *terminateSimulation = fmi2False;
    return (fmi2Status)instance_check_states(of(c));
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real time)
{
    REQUIRE(c, CAN_SetTime);
    return (fmi2Status)instance_set_time(of(c), time);
}

fmi2Status fmi2SetContinuousStates(fmi2Component c, const fmi2Real x[], size_t nx)
{
    REQUIRE(c, CAN_SetContinuousStates);
    return (fmi2Status)instance_set_states(of(c), x, nx);
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real derivatives[], size_t nx)
{
    REQUIRE(c, CAN_GetContinuousStates);
    return (fmi2Status)instance_get_rates(of(c), derivatives, nx);
}

fmi2Status fmi2GetEventIndicators(fmi2Component c, fmi2Real eventIndicators[], size_t ni)
{
    (void)eventIndicators;
    REQUIRE(c, CAN_GetContinuousStates);
    return ni ? (fmi2Status)instance_error(of(c), "has no event indicators") : fmi2OK;
}

fmi2Status fmi2GetContinuousStates(fmi2Component c, fmi2Real x[], size_t nx)
{
    REQUIRE(c, CAN_GetContinuousStates);
    return (fmi2Status)instance_get_states(of(c), x, nx);
}

fmi2Status fmi2GetNominalsOfContinuousStates(fmi2Component c, fmi2Real x_nominal[], size_t nx)
{
    REQUIRE(c, ANY);
    return (fmi2Status)instance_get_nominals(of(c), x_nominal, nx);
}

/* Co-simulation */

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint, fmi2Real communicationStepSize,
                      fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    (void)noSetFMUStatePriorToCurrentPoint;
    REQUIRE(c, CAN_DoStep);
    return (fmi2Status)instance_step(of(c), currentCommunicationPoint, communicationStepSize);
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    REQUIRE(c, 0); /* steps are over when fmi2DoStep returns */
    return fmi2Error;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                       const fmi2Integer order[], const fmi2Real value[])
{
    (void)vr, (void)order, (void)value;
    REQUIRE(c, CAN_Set);
    return nvr ? (fmi2Status)instance_error(of(c), "does not interpolate inputs") : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                                        const fmi2Integer order[], fmi2Real value[])
{
    (void)vr, (void)order, (void)value;
    REQUIRE(c, CAN_Get);
    return nvr ? (fmi2Status)instance_error(of(c), "gives no derivatives of outputs by time") : fmi2OK;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind s, fmi2Status *value)
{
    (void)s, (void)value;
    REQUIRE(c, CAN_GetStatus);
    return fmi2Discard;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    REQUIRE(c, CAN_GetStatus);
    if (s != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = of(c)->now.time;
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind s, fmi2Integer *value)
{
    (void)s, (void)value;
    REQUIRE(c, CAN_GetStatus);
    return fmi2Discard;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    REQUIRE(c, CAN_GetStatus);
    if (s != fmi2Terminated)
        return fmi2Discard;
    *value = of(c)->now.over;
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind s, fmi2String *value)
{
    (void)s, (void)value;
    REQUIRE(c, CAN_GetStatus);
    return fmi2Discard;
}
