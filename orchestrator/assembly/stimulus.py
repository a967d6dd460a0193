"""What drives an input of a system over time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fmus.errors import TraceError, WiringError
from fmus.units import SAME
from orchestrator.crossing import NOTHING_GIVEN, Crossing, GivenConversion, crossing
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray, Trace

ROUNDING = 1e-9  # of numbers that are meant whole


@dataclass(frozen=True)
class Stimulus:
    """A constant, or a recording that is played back.

    Attributes:
        source: a value [unit of the input], a text with its unit (`90 deg`) until it is `brought`, or a trace with one
            signal [its own unit; without one that of the input].
        hold: whether the recording's last value is kept until its next, instead of a line between them; None where the
            input decides: what is no real number, or changes at events only, is held.
        given: what a recording is converted by, over its unit.
        ends_held: whether its first value is kept before it begins, and its last after it ends.
        file: where a recording is from.

    Raises:
        TraceError: the trace has no signal, or several.
    """

    source: float | str | Trace
    hold: bool | None = None
    given: GivenConversion = NOTHING_GIVEN
    ends_held: bool = False
    file: Path | None = None

    def __post_init__(self) -> None:
        if isinstance(self.source, Trace) and len(self.source.names) != 1:
            names = ", ".join(self.source.names) or "none"
            raise TraceError(self.source.name, f"drives an input with {names}", "select one signal")

    def brought(self, name: str, port: Port) -> tuple[Stimulus, Crossing | None]:
        """The same in the unit of the input of this name, and how it got there.

        Raises:
            WiringError: its unit does not fit, or there is a line through values of an input that has none between.
            FmuFileError: a value is none of the input's type, such as 1.5 of an Integer's.
        """
        if not isinstance(self.source, Trace):
            value = port.typed(name, self.source) if port.numeric else port.quantity(name, str(self.source))
            return replace(self, source=float(value)), None
        if self.hold is False and port.stepwise:
            kind = "discrete" if port.variability == "discrete" else port.type
            raise WiringError(name, f"is {kind} and has no values between samples", "leave out `interpolation: linear`")
        trace, crossed = brought(self.source, name, port, self.given)
        if not port.real:
            trace = _typed(trace, f"{name} from {self.file or trace.name}", port)
        return replace(self, source=trace, given=NOTHING_GIVEN, hold=self.hold or port.stepwise), crossed

    @property
    def varies(self) -> bool:
        """Whether its value can change with time."""
        return isinstance(self.source, Trace)

    def held(self, start: float, stop: float) -> str:
        """What is kept at the ends of a run from `start` to `stop` [s], in words; "" where nothing is."""
        if not (self.ends_held and isinstance(self.source, Trace) and len(self.source)):
            return ""
        first, last = self.source.time[[0, -1]]
        kept = [f"first value until {first:g} s"] if start < first else []
        kept += [f"last value from {last:g} s on"] if last < stop else []
        return f"keeps its {' and its '.join(kept)}" if kept else ""

    def values(self, time: FloatArray, name: str) -> FloatArray:
        """(K,) values at these times (K,) [s] for the input of this name.

        Raises:
            WiringError: the recording does not cover them.
            TraceError: it has no value there.
        """
        if not isinstance(self.source, Trace):
            return np.full(len(time), float(self.source))
        trace = self.source
        if self.ends_held and len(trace) and len(time):
            trace = _held_over(trace, time[0], time[-1])
        self._check_covers(trace, time, name)
        (signal,) = trace.names
        values = trace.resampled(time, hold=[signal] if self.hold else [])[signal]
        missing = np.flatnonzero(np.isnan(values))
        if len(missing):
            place, problem = f"{self.file or self.source.name}: {signal}", f"has no value at t = {time[missing[0]]:g} s"
            raise TraceError(place, problem, "cut the recording to where it has one, or fill it in")
        return values

    def _check_covers(self, trace: Trace, time: FloatArray, name: str) -> None:
        if not len(time) or trace.covers(time[0], time[-1]):
            return
        inside = [instant for instant in time if trace.covers(instant, instant)]
        fix = f"or run from {inside[0]:g} to {inside[-1]:g} s at most" if inside else "or check its times"
        covered = f"covers {trace.time[0]:g} to {trace.time[-1]:g} s" if len(trace) else "has no samples"
        problem = f"{self.file or trace.name} {covered}, not {time[0]:g} to {time[-1]:g} s"
        raise WiringError(f"stimuli.{name}", problem, f"say `ends: hold` to keep its first and last value, {fix}")


def _held_over(trace: Trace, start: float, stop: float) -> Trace:
    """The trace with its first value from `start` and its last until `stop` [s]."""
    before, after = [start] if start < trace.time[0] else [], [stop] if stop > trace.time[-1] else []
    time = np.concatenate([before, trace.time, after])
    signals = {name: np.pad(values, (len(before), len(after)), mode="edge") for name, values in trace.signals.items()}
    return Trace(time, signals, trace.units, trace.name)


def _typed(trace: Trace, place: str, port: Port) -> Trace:
    """The trace with whole numbers where its values are whole but for rounding; all have to be of the port's type."""
    (name,) = trace.names
    values, nearest = trace[name], np.rint(trace[name])
    values = np.where(np.abs(values - nearest) <= ROUNDING * np.maximum(1, np.abs(nearest)), nearest, values)
    known = np.unique(values[np.isfinite(values)])
    few = port.items or port.type == "Boolean"
    for value in known if few else (*known[:1], *known[-1:], *known[known != np.rint(known)][:1]):
        port.typed(place, float(value))
    return replace(trace, signals={name: values})


def brought(trace: Trace, place: str, port: Port, given: GivenConversion = NOTHING_GIVEN) -> tuple[Trace, Crossing]:
    """A trace with one signal in the unit of a variable, and how it got there; `place` is named.

    Raises:
        WiringError: its unit does not fit.
    """
    (name,) = trace.names
    crossed = crossing(f"{place} from {name}", port.meaning(trace.unit(name)), port.measure, given)
    signals = trace.signals if crossed.conversion == SAME else {name: crossed.conversion(trace[name])}
    return Trace(trace.time, signals, {name: port.unit} if port.unit else {}, trace.name), crossed
