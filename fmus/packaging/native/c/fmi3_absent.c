/* Functions of FMI 3.0 for what no model here has: strings, arrays, clocks, structural parameters, event indicators.
 * All are exported, since some importers demand every function; asking for none of what is not there is fine. */
#include "fmi3Functions.h"

#include "instance.h"

static fmi3Status none(fmi3Instance instance, size_t count, const char *what)
{
    if (!instance || count)
        return instance ? (fmi3Status)instance_error((Instance *)instance, "has no %s", what) : fmi3Error;
    return fmi3OK;
}

fmi3Status fmi3GetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         fmi3String values[], size_t nValues)
{
    (void)valueReferences, (void)values;
    return none(instance, nValueReferences + nValues, "strings");
}

fmi3Status fmi3SetString(fmi3Instance instance, const fmi3ValueReference valueReferences[], size_t nValueReferences,
                         const fmi3String values[], size_t nValues)
{
    (void)valueReferences, (void)values;
    return none(instance, nValueReferences + nValues, "strings");
}

fmi3Status fmi3GetNumberOfVariableDependencies(fmi3Instance instance, fmi3ValueReference valueReference,
                                               size_t *nDependencies)
{
    (void)valueReference, (void)nDependencies;
    return none(instance, 1, "dependencies of elements of arrays");
}

fmi3Status fmi3GetVariableDependencies(fmi3Instance instance, fmi3ValueReference dependent,
                                       size_t elementIndicesOfDependent[], fmi3ValueReference independents[],
                                       size_t elementIndicesOfIndependents[], fmi3DependencyKind dependencyKinds[],
                                       size_t nDependencies)
{
    (void)dependent, (void)elementIndicesOfDependent, (void)independents, (void)elementIndicesOfIndependents;
    (void)dependencyKinds, (void)nDependencies;
    return none(instance, 1, "dependencies of elements of arrays");
}

fmi3Status fmi3EnterConfigurationMode(fmi3Instance instance)
{
    return none(instance, 1, "structural parameters");
}

fmi3Status fmi3ExitConfigurationMode(fmi3Instance instance)
{
    return none(instance, 1, "structural parameters");
}

fmi3Status fmi3GetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, fmi3Float64 shifts[])
{
    for (size_t i = 0; i < nValueReferences; i++) {
        if (CLOCK < 0 || valueReferences[i] != (fmi3ValueReference)CLOCK)
            return none(instance, 1, "clock with a shift at this value reference");
        shifts[i] = 0.0; /* the first sample is taken at the start */
    }
    return instance ? fmi3OK : fmi3Error;
}

fmi3Status fmi3GetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, nValueReferences, "clocks");
}

fmi3Status fmi3SetIntervalDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                  size_t nValueReferences, const fmi3Float64 intervals[])
{
    (void)valueReferences, (void)intervals;
    return none(instance, nValueReferences, "clocks");
}

fmi3Status fmi3SetIntervalFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                   size_t nValueReferences, const fmi3UInt64 counters[],
                                   const fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, nValueReferences, "clocks");
}

fmi3Status fmi3SetShiftDecimal(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                               size_t nValueReferences, const fmi3Float64 shifts[])
{
    (void)valueReferences, (void)shifts;
    return none(instance, nValueReferences, "clocks");
}

fmi3Status fmi3SetShiftFraction(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                size_t nValueReferences, const fmi3UInt64 counters[], const fmi3UInt64 resolutions[])
{
    (void)valueReferences, (void)counters, (void)resolutions;
    return none(instance, nValueReferences, "clocks");
}

fmi3Status fmi3ActivateModelPartition(fmi3Instance instance, fmi3ValueReference clockReference,
                                      fmi3Float64 activationTime)
{
    (void)clockReference, (void)activationTime;
    return none(instance, 1, "model partitions");
}

fmi3Status fmi3GetEventIndicators(fmi3Instance instance, fmi3Float64 eventIndicators[], size_t nEventIndicators)
{
    (void)eventIndicators;
    return none(instance, nEventIndicators, "event indicators");
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                                    size_t nValueReferences, const fmi3Int32 orders[], fmi3Float64 values[],
                                    size_t nValues)
{
    (void)valueReferences, (void)orders, (void)values;
    return none(instance, nValueReferences + nValues, "derivatives of outputs by time");
}
