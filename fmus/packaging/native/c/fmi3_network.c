/* Functions of FMI 3.0 for clocks and binary variables of a network FMU, in co-simulation with event mode. */
#include "fmi3_component.h"

#include <stdlib.h>

#define REQUIRE_EVENT(instance)                                                                                        \
    do {                                                                                                               \
        if (!(instance) || !instance_allows(&((Component *)(instance))->instance, EVENT, __func__))                    \
            return fmi3Error;                                                                                          \
    } while (0)

static Instance *of(fmi3Instance instance)
{
    return &((Component *)instance)->instance;
}

static Network *bus(fmi3Instance instance)
{
    return &((Component *)instance)->network;
}

static fmi3Status none(fmi3Instance instance, size_t count, const char *what)
{
    if (!instance || count)
        return instance ? (fmi3Status)instance_error(of(instance), "has no %s", what) : fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    REQUIRE_EVENT(instance);
    (void)nValues;
    for (size_t i = 0; i < nValueReferences; i++)
        if (network_get(bus(instance), of(instance), valueReferences[i], &valueSizes[i], &values[i]))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    REQUIRE_EVENT(instance);
    (void)nValues;
    for (size_t i = 0; i < nValueReferences; i++)
        if (network_set(bus(instance), of(instance), valueReferences[i], valueSizes[i], values[i]))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[])
{
    REQUIRE_EVENT(instance);
    for (size_t i = 0; i < nValueReferences; i++)
        if (values[i] && network_tick(bus(instance), of(instance), valueReferences[i]))
            return fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[])
{
    (void)valueReferences, (void)values;
    return none(instance, nValueReferences, "output clocks");
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    REQUIRE_EVENT(instance);
    for (size_t i = 0; i < nValueReferences; i++) {
        if (!network_has_interval(valueReferences[i]))
            return none(instance, 1, "clock with an interval at this value reference");
        const int fresh = network_interval(bus(instance), of(instance), &intervals[i]);
        qualifiers[i] = fresh ? fmi3IntervalChanged : fmi3IntervalUnchanged;
    }
    return fmi3OK;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    for (size_t i = 0; i < nValueReferences; i++) {
        double interval;
        const fmi3Status status = fmi3GetIntervalDecimal(instance, &valueReferences[i], 1, &interval, &qualifiers[i]);
        if (status)
            return status;
        resolutions[i] = UINT64_C(1000000000);
        counters[i] = interval < 1e9 ? (fmi3UInt64)(interval * 1e9 + 0.5) : 0;
    }
    return fmi3OK;
}
