/* Functions of FMI 3.0 for clocks and binary variables, of FMUs without a bus: the clock of the samples, if any. */
#include "fmi3_component.h"

static fmi3Status none(fmi3Instance instance, size_t count, const char *what)
{
    if (!instance || count)
        return instance ? (fmi3Status)instance_error((Instance *)instance, "has no %s", what) : fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         size_t valueSizes[], fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return none(instance, nValueReferences + nValues, "binary variables");
}

fmi3Status fmi3SetBinary(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const size_t valueSizes[], const fmi3Binary values[], size_t nValues)
{
    (void)valueReferences, (void)valueSizes, (void)values;
    return none(instance, nValueReferences + nValues, "binary variables");
}

/* The clock of the samples is an input: who has event mode ticks it. A sample that is due when a step begins, and for
 * which nobody ticked, is taken in the step. */

static int allowed(fmi3Instance instance, size_t count, const char *function)
{
    return instance && (!count || instance_allows(&((Component *)instance)->instance, EVENT, function));
}

static int is_clock(fmi3ValueReference reference)
{
    return CLOCK >= 0 && reference == (fmi3ValueReference)CLOCK;
}

fmi3Status fmi3GetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        fmi3Clock values[])
{
    if (!allowed(instance, nValueReferences, __func__))
        return fmi3Error;
    for (size_t i = 0; i < nValueReferences; i++) {
        if (!is_clock(valueReferences[i]))
            return none(instance, 1, "clock at this value reference");
        values[i] = ((Component *)instance)->ticking;
    }
    return fmi3OK;
}

fmi3Status fmi3SetClock(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                        const fmi3Clock values[])
{
    if (!allowed(instance, nValueReferences, __func__))
        return fmi3Error;
    for (size_t i = 0; i < nValueReferences; i++) {
        if (!is_clock(valueReferences[i]))
            return none(instance, 1, "clock at this value reference");
        ((Component *)instance)->ticking |= values[i];
    }
    return fmi3OK;
}

fmi3Status fmi3GetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, fmi3Float64 intervals[], fmi3IntervalQualifier qualifiers[])
{
    if (!instance)
        return fmi3Error;
    for (size_t i = 0; i < nValueReferences; i++) {
        Component *c = (Component *)instance;
        if (!is_clock(valueReferences[i]))
            return none(instance, 1, "clock at this value reference");
        intervals[i] = c->instance.now.values[CLOCK >= 0 ? SAMPLE_TIME : 0];
        qualifiers[i] = c->told ? fmi3IntervalUnchanged : fmi3IntervalChanged;
        c->told = 1;
    }
    return fmi3OK;
}

fmi3Status fmi3GetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
                                   fmi3IntervalQualifier qualifiers[])
{
    (void)valueReferences, (void)counters, (void)resolutions, (void)qualifiers;
    return none(instance, nValueReferences, "interval that is a fraction");
}
