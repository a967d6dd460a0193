"""Where two recordings of one thing part: two versions, packagings, engines or tools side by side."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fmus.errors import TraceError
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Parting:
    """A signal that two recordings do not have alike.

    Attributes:
        time: of the first sample at which they differ by more than is allowed [s].
        one, other: their values there [unit].
        largest: their largest difference [unit]; NaN where only one of them is a number.
        largest_at: when that is [s].
        samples: how many differ by more than is allowed.
        of: how many were compared.
    """

    signal: str
    unit: str | None
    time: float
    one: float
    other: float
    largest: float
    largest_at: float
    samples: int
    of: int

    def __str__(self) -> str:
        unit = f" {self.unit}" if self.unit and self.unit != "1" else ""
        return (
            f"{self.signal} parts at {self.time:.6g} s, {self.one:.9g} from {self.other:.9g}{unit}; "
            f"by {self.largest:.3g}{unit} at most, at {self.largest_at:.6g} s"
        )


def partings(
    one: Trace, other: Trace, absolute: float = 0.0, relative: float = 0.0, hold: Iterable[str] = ()
) -> list[Parting]:
    """The signals of both recordings that differ somewhere, those first that part first.

    They are compared at the stamps of `one` that both last for, the other on the line between its samples. A difference
    of `absolute` [unit] plus a share `relative` of the larger amount is allowed; two NaN are alike.

    Args:
        hold: signals that keep a value until their next sample.

    Raises:
        TraceError: they have no signal or no time in common, or one signal in two units.
    """
    names = [name for name in one.names if name in other.names]
    if not names:
        raise TraceError(one.name, f"has no signal in common with {other.name}", "rename their signals")
    for name in names:
        if one.unit(name) and other.unit(name) and one.unit(name) != other.unit(name):
            units = f"{one.unit(name)} in {one.name}, {other.unit(name)} in {other.name}"
            raise TraceError(name, f"is in {units}", "convert one of them")
    if not len(other) or not len(window := one.between(other.time[0], other.time[-1])):
        raise TraceError(one.name, f"has no time in common with {other.name}", "check their times")
    beside = other if np.array_equal(other.time, window.time) else other.select(names).resampled(window.time, hold)
    found = [
        parting
        for name in names
        if (parting := _parting(name, one.unit(name), window.time, window[name], beside[name], absolute, relative))
    ]
    return sorted(found, key=lambda parting: parting.time)


def _parting(
    signal: str,
    unit: str | None,
    time: FloatArray,
    one: FloatArray,
    other: FloatArray,
    absolute: float,
    relative: float,
) -> Parting | None:
    alike = (one == other) | (np.isnan(one) & np.isnan(other))
    with np.errstate(invalid="ignore"):
        difference = np.where(alike, 0.0, np.abs(one - other))
        allowed = absolute + relative * np.maximum(np.abs(one), np.abs(other))
        apart = np.flatnonzero(~alike & ~(np.isfinite(difference) & (difference <= allowed)))
    if not len(apart):
        return None
    row, largest = int(apart[0]), int(np.argmax(difference))  # argmax takes a NaN for the largest
    return Parting(
        signal,
        unit,
        float(time[row]),
        float(one[row]),
        float(other[row]),
        float(difference[largest]),
        float(time[largest]),
        len(apart),
        len(time),
    )
