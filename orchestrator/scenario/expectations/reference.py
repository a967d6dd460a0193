"""What a signal is compared with: a reference, in its file and in the unit of the signal; and whether it follows it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from fmus.errors import ScenarioError, TraceError
from orchestrator.assembly.schema import SignalFileBlock
from orchestrator.assembly.stimulus import brought as trace_brought
from orchestrator.crossing import NOTHING_GIVEN, GivenConversion
from orchestrator.fmi.interface import Port
from orchestrator.formats.schema import LayoutBlock
from orchestrator.scenario.expectations.base import Condition, ExpectationScope, Judgement, Times, Tube
from orchestrator.scenario.expectations.figure import shown
from orchestrator.scenario.expectations.limits import within
from orchestrator.scenario.expectations.quantities import Number
from orchestrator.trace import BoolArray, FloatArray, Trace
from orchestrator.yaml_file import Block

ON_STEP = 1e-6  # of a step, to which a stamp is on it
FEWEST = 2  # stamps that have to be on steps; a run with another step has not even these


class ReferenceBlock(Block):
    """A signal of a trace file that a signal is compared with.

    Attributes:
        file: a recording, relative to this file.
        signal: by default the name of what is compared with it.
        factor, offset: variable = factor * signal + offset, over what their units say.
        layout: how the file is laid out, where it does not tell.
    """

    file: Path
    signal: str | None = None
    factor: float | None = None
    offset: float | None = None
    layout: LayoutBlock = LayoutBlock()

    def reference(self, signal: str, base: Path, said: list[str] | None) -> Reference:
        """The reference for a signal; the file is relative to `base`, and what is to be known of it added to `said`."""
        block = SignalFileBlock(**{**dict(self), "signal": self.signal or signal})
        return Reference(
            block.trace(base, said), f"{block.signal} of {block.file.name}", base / block.file, block.given
        )


@dataclass(frozen=True)
class Reference:
    """What a signal is compared with.

    Attributes:
        trace: with one signal; None where it is not there, or to be replaced: then nothing holds.
        name: in words.
        file: where it is, or is to be.
        given: what it is converted by, over its unit, until it is brought.
        accepted: whether it is one that `servotwin accept` keeps of a case.
        missing: what to do where it is not there.
        step: of the run that it is from [s]; 0 where that is not known.
    """

    trace: Trace | None
    name: str
    file: Path
    given: GivenConversion = NOTHING_GIVEN
    accepted: bool = False
    missing: str = ""
    step: float = 0.0

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Reference:
        """The same in the unit of a variable.

        Raises:
            WiringError: its unit does not fit.
        """
        if self.trace is None:
            return self
        trace, how = trace_brought(self.trace, place, port, self.given)
        wiring.crossings.append(how)
        return replace(self, trace=trace, given=NOTHING_GIVEN)

    def check_covered(self, place: str, instants: FloatArray, asked: Times) -> None:
        """See that it lasts as long as these instants (K,) [s], and has a number all along; and that one that was
        accepted has nothing else between the times that are asked for, for then the run has become shorter.

        Raises:
            ScenarioError: it is shorter, or longer.
            TraceError: it has none somewhere.
        """
        trace = self.trace
        if trace is None:
            return
        self._check_followed(place, instants, asked)
        if not trace.covers(instants[0], instants[-1]):
            covered = f"{trace.time[0]:g} to {trace.time[-1]:g} s" if len(trace) else "nothing"
            raise ScenarioError(
                place,
                f"{self.name} covers {covered}, not {instants[0]:g} to {instants[-1]:g} s",
                "say from when to when it is compared with `after` and `before`",
            )
        bad = np.flatnonzero(~np.isfinite(self.values))
        if len(bad):
            raise TraceError(
                f"{self.file}: {place}",
                f"{self.name} is {self.values[bad[0]]:g} at {trace.time[bad[0]]:g} s ({len(bad)} like it)",
                "take a reference whose samples are all numbers",
            )

    def _check_followed(self, place: str, instants: FloatArray, asked: Times) -> None:
        if not self.accepted or not len(self.samples):
            return
        first, last = max(asked[0], self.samples.time[0]), min(asked[1], self.samples.time[-1])
        step = max(self.step, float(np.max(np.diff(instants), initial=0.0))) * (1.0 + ON_STEP)
        if first < instants[0] - step or last > instants[-1] + step:
            raise ScenarioError(
                place,
                f"{self.name} goes from {first:g} to {last:g} s, and the run only from {instants[0]:g} to "
                f"{instants[-1]:g} s",
                "run as long, take another with `servotwin accept`, or say from when to when with `after` and `before`",
            )

    @property
    def samples(self) -> Trace:
        """The trace, which is there."""
        assert self.trace is not None
        return self.trace

    @property
    def values(self) -> FloatArray:
        """(N,) its samples."""
        (values,) = self.samples.signals.values()
        return values

    def during(self, time: FloatArray) -> FloatArray:
        """Its samples from the first to the last of these stamps (K,) [s]."""
        first, last = np.searchsorted(self.samples.time, [time[0], time[-1]])
        return self.values[max(int(first) - 1, 0) : int(last) + 1]

    def known(self, time: FloatArray) -> BoolArray:
        """(K,) at which of these stamps (K,) [s] it tells something of the run that it is from: at the steps of that
        run, where a run with a smaller step has them, too. What lies between is what lines or steps make of it.
        """
        every = np.ones(len(time), dtype=bool)
        if not self.step:
            return every
        count = (time - self.samples.time[0]) / self.step
        on = np.abs(count - np.rint(count)) < ON_STEP
        return on if np.count_nonzero(on) >= FEWEST else every

    def at(self, time: FloatArray, hold: bool) -> FloatArray:
        """(K,) its values at these stamps (K,) [s].

        Raises:
            TraceError: it does not cover them.
        """
        (values,) = self.samples.resampled(time, self.samples.names if hold else ()).signals.values()
        return values


@dataclass(frozen=True)
class Against(Condition):
    """A condition against a reference."""

    reference: Reference

    @property
    def files(self) -> tuple[Path, ...]:
        return () if self.reference.trace is None else (self.reference.file,)

    @property
    def accepted(self) -> bool:
        return self.reference.accepted

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return replace(self, reference=self.reference.brought(place, port, wiring))

    def check_covered(self, place: str, instants: FloatArray, asked: Times) -> None:
        self.reference.check_covered(place, instants, asked)

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        if self.reference.trace is None:
            return Judgement(False, self.reference.missing)
        known = self.reference.known(time)
        return self.compared(time[known], values[known], hold)

    @abstractmethod
    def compared(self, time: FloatArray, values: FloatArray, hold: bool) -> Judgement:
        """As `judged`, with a reference that is there."""

    def precision(self, values: FloatArray) -> float:
        """How far a reference made of values (K,) may be from them without a word [unit of the signal]."""
        return 1e-3 * float(np.ptp(values))


@dataclass(frozen=True)
class Tubed(Against):
    """A condition that a tube about the reference tells."""

    @abstractmethod
    def about(self, time: FloatArray, hold: bool) -> Tube:
        """The tube at these stamps (K,) [s]."""

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube | None:
        return None if self.reference.trace is None else self.about(time, hold)


@dataclass(frozen=True)
class Follows(Tubed):
    """No sample is farther than `within` from the reference [unit of the signal]."""

    takes_nonfinite: ClassVar[bool] = True
    within: Number
    unit: str = ""

    def __str__(self) -> str:
        return f"follows {self.reference.name} within {shown(self.within, self.unit)}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        width = port.quantity(place, self.within, difference=True) if isinstance(self.within, str) else self.within
        return replace(super().brought(place, port, wiring), within=width, unit=port.unit or "")

    def compared(self, time: FloatArray, values: FloatArray, hold: bool) -> Judgement:
        target = self.reference.at(time, hold)
        return replace(within(values, target, float(self.within)), doubt=too_wide(self.about(time, hold), target))

    def about(self, time: FloatArray, hold: bool) -> Tube:
        target = self.reference.at(time, hold)
        return target - float(self.within), target + float(self.within)

    def precision(self, values: FloatArray) -> float:
        return float(self.within)


def too_wide(band: Tube, reference: FloatArray) -> str:
    """That a tube holds whatever stays within the range of its reference (K,), where it does; else ""."""
    lower, upper = band
    least, most = float(reference.min()), float(reference.max())
    if least == most or lower.max() > least or upper.min() < most:
        return ""
    return f"cannot fail for a signal between {least:.4g} and {most:.4g}: the tube is wider than the reference's range"
