"""What drives an input of a system over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import TraceError, WiringError
from orchestrator.crossing import NOTHING_GIVEN, Crossing, Given, crossing
from orchestrator.fmi.interface import Port
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Stimulus:
    """A constant, or a recording that is played back.

    Attributes:
        source: a value [unit of the input], a text with its unit (`90 deg`) until it is `brought`, or a trace with one
            signal [its own unit; without one that of the input].
        hold: whether the recording's last value is kept until its next, instead of a line between them; None where the
            input decides: what is no real number, or changes at events only, is held.
        given: what a recording is converted by, over its unit.

    Raises:
        TraceError: the trace has no signal, or several.
    """

    source: float | str | Trace
    hold: bool | None = None
    given: Given = NOTHING_GIVEN

    def __post_init__(self) -> None:
        if isinstance(self.source, Trace) and len(self.source.names) != 1:
            names = ", ".join(self.source.names) or "none"
            raise TraceError(self.source.name, f"drives an input with {names}", "select one signal")

    def brought(self, name: str, port: Port) -> tuple[Stimulus, Crossing | None]:
        """The same in the unit of the input of this name, and how it got there.

        Raises:
            WiringError: its unit does not fit, or there is a line through values of an input that has none between.
        """
        if isinstance(self.source, str):
            return replace(self, source=port.quantity(name, self.source)), None
        if not isinstance(self.source, Trace):
            return self, None
        if self.hold is False and port.stepwise:
            kind = "discrete" if port.variability == "discrete" else port.type
            raise WiringError(name, f"is {kind} and has no values between samples", "leave out `interpolation: linear`")
        trace, crossed = brought(self.source, name, port, self.given)
        return replace(self, source=trace, given=NOTHING_GIVEN, hold=self.hold or port.stepwise), crossed

    @property
    def varies(self) -> bool:
        """Whether its value can change with time."""
        return isinstance(self.source, Trace)

    def values(self, time: FloatArray) -> FloatArray:
        """(K,) values at these times (K,) [s].

        Raises:
            TraceError: the recording does not cover them, or has no value there.
        """
        if not isinstance(self.source, Trace):
            return np.full(len(time), float(self.source))
        (name,) = self.source.names
        values = self.source.resampled(time, hold=[name] if self.hold else [])[name]
        missing = np.flatnonzero(np.isnan(values))
        if len(missing):
            place, problem = f"{self.source.name}.{name}", f"has no value at t = {time[missing[0]]:g} s"
            raise TraceError(place, problem, "cut the recording to where it has one, or fill it in")
        return values


def brought(trace: Trace, place: str, port: Port, given: Given = NOTHING_GIVEN) -> tuple[Trace, Crossing]:
    """A trace with one signal in the unit of a variable, and how it got there; `place` is named.

    Raises:
        WiringError: its unit does not fit.
    """
    (name,) = trace.names
    crossed = crossing(f"{place} from {name}", port.meaning(trace.unit(name)), port.measure, given)
    signals = {name: crossed.conversion(trace[name])}
    return Trace(trace.time, signals, {name: port.unit} if port.unit else {}, trace.name), crossed
