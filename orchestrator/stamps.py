"""Recordings whose stamps repeat or run backwards as traces, and what that took."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmus.errors import TraceError
from orchestrator.trace import FloatArray, Trace

MIXED = 50  # changes from run to run of stamps in the order of time, for each run: no samples that came late
LEAST_MIXED = 15  # the same of half as many stamps
HOLE = 20  # steps that part what a clock that was put back leaves from the rest
RUN = 5  # samples of what it leaves: no buffer that goes round
COUNTERS = {
    **{2.0**bits * unit: f"{bits} bits" for bits in (16, 32) for unit in (1.0, 1e-3, 1e-6, 1e-7, 1e-9)},
    86_400.0: "the seconds of a day",
}
"""When counters that stamps are taken from begin anew [s], and what they are."""
LATEST = 1e15  # [s]; stamps beyond it are no times, whatever the file says


@dataclass(frozen=True)
class StampReport:
    """What `ordered` found in the stamps of one recording and did about it."""

    samples: int
    repeated: int
    backward: int
    mean_step: float
    largest_gap: float

    @property
    def clean(self) -> bool:
        return not (self.repeated or self.backward)

    def __str__(self) -> str:
        parts = [f"{self.samples} samples, mean step {self.mean_step:.3g} s, largest gap {self.largest_gap:.3g} s"]
        if self.repeated:
            parts.append(f"{self.repeated} repeated stamps (the last sample of each kept)")
        if self.backward:
            parts.append(f"{self.backward} stamps out of order (sorted)")
        return ", ".join(parts)


def unwrapped(time: FloatArray) -> tuple[FloatArray, str]:
    """Stamps (K,) [s] of a counter that begins anew, as they go on, and a line about it; else as they are, and ""."""
    steps = np.diff(time)
    back, onwards = steps < 0, steps[steps > 0]
    if not back.any() or not len(onwards):
        return time, ""
    usual = 2.5 * float(np.median(onwards))
    for period, what in COUNTERS.items():
        low, high = (0.0, period) if time.min() >= 0 else (-period / 2, period / 2)
        across = steps[back] + period
        if low <= time.min() and time.max() < high and np.all((across > 0) & (across <= min(usual, period / 8))):
            begun = np.append(0, np.cumsum(back))
            told = f"its times begin anew, as a counter of {what} does, and are counted on: {begun[-1]} times"
            return time + period * begun, told
    return time, ""


def ordered(
    time: ArrayLike,
    signals: Mapping[str, ArrayLike],
    units: Mapping[str, str] | None = None,
    name: str = "trace",
) -> tuple[Trace, StampReport]:
    """A trace from raw columns, stamps sorted, of equal stamps the last sample kept; and what was found.

    Args:
        time: (K,) stamps [s], in any order.
        signals: name -> (K,) samples.

    Raises:
        TraceError: fewer than two distinct stamps, a stamp that is not finite, a column of another length; or times
            that start anew, so that samples of several runs would mix.
    """
    stamps, columns = _columns(time, signals, name)
    backward = int(np.count_nonzero(stamps[1:] < stamps[:-1]))
    order = np.argsort(stamps, kind="stable")
    if backward:
        _require_one_run(stamps, order, name)
    ascending = stamps[order]
    keep = order[np.append(ascending[1:] > ascending[:-1], True)]
    if len(keep) < 2:
        raise TraceError(name, "has fewer than two distinct time stamps", "check the time column")
    steps = np.diff(stamps[keep])
    trace = Trace(stamps[keep], {key: values[keep] for key, values in columns.items()}, dict(units or {}), name)
    report = StampReport(len(stamps), len(stamps) - len(keep), backward, float(steps.mean()), float(steps.max()))
    return trace, report


def _columns(time: ArrayLike, signals: Mapping[str, ArrayLike], name: str) -> tuple[FloatArray, dict[str, FloatArray]]:
    """Stamps and samples as arrays (K,) with K > 0, stamps finite and small enough to be subtracted."""
    stamps = np.asarray(time, dtype=float)
    if stamps.ndim != 1:
        raise TraceError(name, f"time has shape {stamps.shape}, not (K,)", "give one stamp a sample")
    if len(stamps) == 0:
        raise TraceError(name, "holds no samples", "record or export it again")
    bad = np.flatnonzero(~(np.abs(stamps) < LATEST))
    if len(bad):
        raise TraceError(
            name,
            f"time stamp {bad[0] + 1} is {stamps[bad[0]]:g} ({len(bad)} like it)",
            "drop those rows, or check the time column",
        )
    columns = {key: np.asarray(values, dtype=float) for key, values in signals.items()}
    for key, values in columns.items():
        if values.shape != stamps.shape:
            raise TraceError(f"{name}.{key}", f"has shape {values.shape}, time has {stamps.shape}")
    return stamps, columns


def _require_one_run(stamps: FloatArray, order: NDArray[np.intp], name: str) -> None:
    """See that sorted stamps (K,) would neither mix long ascending runs, as those of several recordings in one file,
    nor put what came later long before the rest, as of a clock that was put back."""
    back = np.flatnonzero(stamps[1:] < stamps[:-1]) + 1
    run = np.searchsorted(back, order, side="right")
    changes = np.diff(run)
    steps = np.diff(stamps[order])
    parted = (changes < 0) & (steps > HOLE * np.median(steps))
    least = min(len(part) for part in np.split(stamps, back))
    mixed = np.count_nonzero(changes) > min(MIXED, max(LEAST_MIXED, len(stamps) // 2)) * len(back)
    if mixed or (least >= RUN and parted.any() and np.count_nonzero(changes) == len(back)):
        before, after = stamps[back[0] - 1], stamps[back[0]]
        raise TraceError(
            name,
            f"its time starts anew at sample {back[0] + 1}, from {before:.9g} s to {after:.9g} s",
            "give each run a file of its own",
        )
