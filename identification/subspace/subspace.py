"""State-space models from records: observability range space extraction (ORSE) and its relatives N4SID, MOESP and CVA.

`subspace` is the one way in: it extracts the range space, chooses the order, and realises the model. For many orders
from one extraction, `realise` each of them in one `range_space`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.linear.records import InputOutputData, Records, without_gaps
from identification.subspace.orders import Best, OrderRule, from_singular_values
from identification.subspace.range_space import RangeSpace, SubspaceSettings, range_space
from identification.subspace.realisation import SubspaceResult, errors_of, mean, realise, simulated


@single_threaded
def subspace(records: Records, order: OrderRule, settings: SubspaceSettings) -> SubspaceResult:
    """The linear model of all records together.

    Args:
        records: of the same step and columns; NaN in them are gaps.
        order: the order, or how it is found: `Threshold`, `Gap` or `Best` of `orders`.
        settings: the block size, the weighting, and what else is asked of the model.

    Raises:
        IdentificationError: the records, or what they excite, do not bear the estimate.

    Source: the flexible-manipulator thesis, Section 2.2.3, for weighting "orse".
    """
    return in_range_space(range_space(records, settings), order)


@single_threaded
def in_range_space(space: RangeSpace, order: OrderRule) -> SubspaceResult:
    """The linear model in a range space, as its settings ask; raises as `subspace`."""
    if isinstance(order, Best):
        return _best(space, order)
    return realise(space, *from_singular_values(order, space.values, space.limit))


def _best(space: RangeSpace, rule: Best) -> SubspaceResult:
    results, refused = [], IdentificationError("order", "no order is to be tried", "give a range")
    for order in sorted(rule.orders):
        try:
            results.append(realise(space, order))
        except IdentificationError as error:
            refused = error
    if not results:
        raise refused
    errors = np.array([_judged(result, rule.validation) for result in results])
    least = float(np.min(errors))
    if not np.isfinite(least):
        raise IdentificationError("order", "no order gives a bounded free run", "ask for stable poles")
    chosen = int(np.argmax(errors <= least * (1 + rule.margin)))
    why = (
        f"mean delta {errors[chosen]:.4g} at order {results[chosen].order}, the least is {least:.4g} "
        f"of the {len(results)} orders that could be had of {len(rule.orders)}"
    )
    return replace(results[chosen], why=why)


def _judged(result: SubspaceResult, validation: Sequence[InputOutputData]) -> float:
    """Mean delta, inf where a run overflows."""
    if not validation:
        return result.mean_delta
    records = without_gaps(validation, result.order + 1).records
    return mean(errors_of(records, simulated(result.model, records))[1])
