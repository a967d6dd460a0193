"""Rows of the regression from recordings: forces, motions and instruments from the loop, filtered alike."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter1d

from fmus.errors import IdentificationError
from identification.inverse_dynamics.averages import averaged_motion, half_width, smoothed, speed
from identification.inverse_dynamics.loop import PositionLoop, in_loop
from identification.inverse_dynamics.regression import RegressionRows
from identification.inverse_dynamics.study import Filtering
from identification.inverse_dynamics.terms import Term
from orchestrator.trace import FloatArray

FINEST = 0.2  # of the sampling rate, up to which derivatives are right


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
        speeds: of all samples of the record.
    """

    record: AxisRecord
    time: FloatArray
    y: FloatArray
    x: FloatArray
    kept: NDArray[np.intp]
    speeds: FloatArray


def prepared(
    record: AxisRecord, how: Filtering, terms: Sequence[Term], within: NDArray[np.intp] | None = None
) -> FilteredRecord:
    """What a record says of these terms; forces and columns go through the same filters.

    Args:
        within: numbers of the rows that may be kept; all without.

    Raises:
        IdentificationError: it is too short, or too coarse for the filters.
    """
    _bearable(record, how)
    smooth = smoothed(record.position, record.step, how.cutoff)
    speeds = speed(smooth, record.step)
    kept = _kept(record, how, speeds, within)
    columns = averaged_motion(record.position, smooth, record.step).columns(terms)
    y, x = (_thinned(record, how, values)[kept] for values in (record.force, columns))
    time = np.asarray(record.start + record.step * _stride(record, how) * kept, np.float64)
    return FilteredRecord(record, time, y, x, kept, speeds)


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
    start = (float(record.position[0]), float(one.speeds[0]))
    position = in_loop(loop, record.reference, start, values, gain, record.step)
    if not np.all(np.abs(position) < 1e3 * (1 + np.abs(record.position).max())):
        raise IdentificationError(
            record.name, "the axis runs away in the loop", "check `position_gain`, `speed_gain` and the gain's sign"
        )
    columns = averaged_motion(position, position, record.step).columns(terms)
    return RegressionRows(one.y, one.x, _thinned(record, how, columns)[one.kept], one.kept)


def _bearable(record: AxisRecord, how: Filtering) -> None:
    """See that derivatives are right as far as the filter lets through."""
    most = FINEST / record.step
    if how.cutoff > most * (1 + 1e-6):
        raise IdentificationError(
            record.name,
            f"derivatives up to {how.cutoff:g} Hz cannot be had from {1 / record.step:.4g} samples a second",
            f"write `cutoff: {most:.3g}` or less, or record faster",
        )


def _stride(record: AxisRecord, how: Filtering) -> int:
    return max(round(1 / (record.step * how.rows_per_second)), 1)


def corners(record: AxisRecord, how: Filtering) -> list[float]:
    """Of the filters that forces and columns go through [Hz]: the study's, and one for rows that are fewer."""
    stride = _stride(record, how)
    return [how.cutoff, *([0.4 / (stride * record.step)] if stride > 1 else [])]


def _thinned(record: AxisRecord, how: Filtering, values: FloatArray) -> FloatArray:
    """Every so manieth of the values, after what is too fast is filtered out."""
    for corner in corners(record, how):
        values = smoothed(values, record.step, corner)
    return values[:: _stride(record, how)]


def _kept(record: AxisRecord, how: Filtering, speeds: FloatArray, within: NDArray[np.intp] | None) -> NDArray[np.intp]:
    """Numbers of the rows that see neither the record's ends nor a speed that is too low; speeds are smoothed, too."""
    stride = _stride(record, how)
    reach = sum(half_width(corner) for corner in (how.cutoff, *corners(record, how))) + record.step
    slowest = minimum_filter1d(np.abs(speeds), 2 * math.ceil(reach / record.step) + 1)[::stride]
    time = record.step * stride * np.arange(len(slowest))
    last = record.step * (len(record.position) - 1)
    kept = np.flatnonzero((time >= reach) & (time <= last - reach) & (slowest >= how.least_speed))
    kept = kept if within is None else np.intersect1d(kept, within)
    if not len(kept):
        raise IdentificationError(
            record.name, "leaves no row", "record longer and faster, or lower `least_speed`, or raise `cutoff`"
        )
    return kept
