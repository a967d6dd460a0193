"""Rows of the regression from recordings: motions by filtered differences, forces, and instruments from the loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from fmus.errors import IdentificationError
from identification.inverse_dynamics.loop import PositionLoop, in_loop
from identification.inverse_dynamics.regression import RegressionRows
from identification.inverse_dynamics.study import Filtering
from identification.inverse_dynamics.terms import AxisMotion, Term
from identification.signals.processing import low_pass
from orchestrator.trace import FloatArray

ORDER, THINNING_ORDER = 4, 2  # of the low-passes; the second rings less
REACH = 2  # rows on either side that the second reaches to


@dataclass(frozen=True, eq=False)
class AxisRecord:
    """A stretch of a recording at even instants.

    Attributes:
        trace: the name of its recording.
        step: [s].
        position, force: (K,); the force is that of the step before and the step after on the mean.
        reference: (K,) of the loop, None without one.
        start: time of the first sample [s].
    """

    name: str
    trace: str
    step: float
    position: FloatArray
    force: FloatArray
    reference: FloatArray | None
    start: float


@dataclass(frozen=True, eq=False)
class FilteredRecord:
    """The rows of a record: forces (K,), columns (K, n), and which of the record's rows they are.

    Attributes:
        time: (K,) of the recording [s].
        motion: of the whole record.
    """

    record: AxisRecord
    time: FloatArray
    y: FloatArray
    x: FloatArray
    kept: NDArray[np.intp]
    motion: AxisMotion


def prepared(record: AxisRecord, how: Filtering, terms: Sequence[Term]) -> FilteredRecord:
    """What a record says of these terms.

    Raises:
        IdentificationError: it is too short, or too coarse for the filters.
    """
    motion = _differentiated(low_pass(record.position, record.step, how.cutoff, ORDER), record.step)
    kept = _kept(record, how, motion)
    y, x = (_thinned(record, how, values)[kept] for values in (record.force, motion.columns(terms)))
    time = np.asarray(record.start + record.step * _stride(record, how) * kept, np.float64)
    return FilteredRecord(record, time, y, x, kept, motion)


def with_instruments(
    one: FilteredRecord,
    how: Filtering,
    loop: PositionLoop,
    values: Mapping[Term, float],
    terms: Sequence[Term],
    gain: float,
) -> RegressionRows:
    """The rows of a record with what the axis does in its loop by these values as instruments.

    Raises:
        IdentificationError: the loop does not hold it.
    """
    record = one.record
    assert record.reference is not None
    start = (float(one.motion.position[0]), float(one.motion.speed[0]))
    motion = in_loop(loop, record.reference, start, values, gain, record.step)
    if not np.all(np.abs(motion.position) < 1e3 * (1 + np.abs(record.position).max())):
        raise IdentificationError(
            record.name, "the axis runs away in the loop", "check `position_gain`, `speed_gain` and the gain's sign"
        )
    return RegressionRows(one.y, one.x, _thinned(record, how, motion.columns(terms))[one.kept])


def _differentiated(position: FloatArray, step: float) -> AxisMotion:
    speed = np.gradient(position, step)
    return AxisMotion(position, speed, np.gradient(speed, step))


def _stride(record: AxisRecord, how: Filtering) -> int:
    return max(round(1 / (record.step * how.rows_per_second)), 1)


def _thinned(record: AxisRecord, how: Filtering, values: FloatArray) -> FloatArray:
    """Every so manieth of the values, after what is above half of that rate is filtered out."""
    stride = _stride(record, how)
    if stride == 1:
        return values
    return low_pass(values, record.step, 0.4 / (stride * record.step), THINNING_ORDER)[::stride]


def _kept(record: AxisRecord, how: Filtering, motion: AxisMotion) -> NDArray[np.intp]:
    """Numbers of the rows that neither the filters' ends touch nor, as far as they reach, a speed that is too low."""
    stride = _stride(record, how)
    slowest = minimum_filter1d(np.abs(motion.speed), 2 * REACH * stride + 1)[::stride]
    ends = 2 / min(how.cutoff, how.rows_per_second)
    time = record.step * stride * np.arange(len(slowest))
    last = record.step * (len(record.position) - 1)
    kept = np.flatnonzero((time >= ends) & (time <= last - ends) & (slowest >= how.least_speed))
    if not len(kept):
        raise IdentificationError(
            record.name, "leaves no row", "record longer and faster, or lower `least_speed`, or raise `cutoff`"
        )
    return kept
