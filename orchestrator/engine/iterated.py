"""Steps that are repeated until what components take over them agrees with what they give: an implicit coupling.

Over a step a component's input from the dynamics of another is held at the mean of that output at the step's beginning
and at its end, which is not known before the step has been taken: all components step in the plan's order, go back, and
step again with the newer ends, until none moves. For constant coefficients that is the trapezoidal rule between the
components: of second order, and a spring and a mass in two of them exchange just the energy that one loses.
An output that reacts to an input at once, as a damper's force, is read at the beginning with the input of the step, and
once more in the end with the inputs of the end, as which it is recorded.
Stimuli, and outputs that are not continuous, as those of sampled parts, are held as in Gauss-Seidel order; a component
that has no other outputs samples what there is at the beginning of the step.

With a tolerance each step is taken once and in two halves. Where both agree to it the halves count; else all go back,
and the step is halved, down to the least, as it is where a component discards it. It grows again where the error is
small. All are binary fractions of the communication step, so that time is counted.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from fmus.errors import FmuError, StepDiscarded, WiringError
from orchestrator.engine.loop import Loop, LoopNode
from orchestrator.fmi.status import stepping
from orchestrator.rational import TickTimes, written
from orchestrator.system import System
from orchestrator.trace import FloatArray

LOG = logging.getLogger("servotwin.engine")
_GROWS = 1 / 16  # share of the tolerance below which a step of second order may be twice as long
_RICHARDSON = 3.0  # the error of two halves of second order is their difference to the whole by this


@dataclass(frozen=True)
class StepControl:
    """How the steps inside a communication step are chosen.

    Attributes:
        tolerance: of each continuous output in each step, relative to 1 + |value|.
        least: the shortest step [s]; halving the communication step ends there.
    """

    tolerance: float
    least: Fraction

    def parts(self, most: Fraction) -> int:
        """How many of its shortest steps, of two halves each, a communication step [s] is.

        Raises:
            WiringError: it cannot be halved.
        """
        halved = math.floor(math.log2(most / self.least) + 1e-9)
        if halved < 1:
            problem = f"{written(self.least)} s is more than half of the most, {written(most)} s"
            raise WiringError("step.least", problem, "shorten it, or give a plain step")
        return 1 << (halved - 1)


def check_control(system: System, control: StepControl, most: Fraction) -> None:
    """See that all components can take steps of changing length, down to the shortest.

    Raises:
        WiringError: one cannot, or the communication step [s] cannot be halved.
    """
    shortest = most / (2 * control.parts(most))
    for name, part in system.parts.items():
        if not part.interface.variable_step:
            problem = "takes steps of one length only, and `step` has a tolerance"
            raise WiringError(
                name, problem, "its FMU needs canHandleVariableCommunicationStepSize; or give a plain step"
            )
        fixed = part.interface.fixed_step
        if fixed and abs(float(shortest) / fixed - round(float(shortest) / fixed)) > 1e-9:
            problem = (
                f"{written(shortest)} s, to which steps may be halved, is no multiple of the FMU's own {fixed:g} s"
            )
            raise WiringError(
                f"{name}.step", problem, f"give a `least` and a `most` that are {fixed:g} s by powers of two"
            )


@dataclass
class TakenSteps:
    """What steps were taken inside communication steps.

    Attributes:
        steps: those that count.
        rejected: those that were taken back, for their error was too large, their iteration did not settle, or a
            component discarded them.
        forced: those that count though their error was too large, for they were the shortest.
        shortest: the shortest that counts [s].
    """

    steps: int = 0
    rejected: int = 0
    forced: int = 0
    shortest: float = math.inf


@dataclass(frozen=True)
class Iteration:
    """How the steps of a loop are iterated.

    Attributes:
        averaged: slots of outputs that are held at their mean over a step.
        sampling: components without any, which take what there is at the beginning.
        reacting: components with such outputs that react to inputs at once.
        control: None where each communication step is one step.
        fine: time of a part of a communication step, counted in `parts`.
        parts: shortest steps in a communication step, of two halves each.
        span: of the communication step [s].
    """

    averaged: Sequence[int]
    sampling: frozenset[str]
    reacting: frozenset[str]
    control: StepControl | None
    fine: TickTimes
    parts: int
    span: Fraction


@dataclass
class IteratedLoop(Loop):
    """A system whose steps are iterated, and shortened where there is a control.

    Attributes:
        taken: what steps the run took.
    """

    iteration: Iteration = field(kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        own = [False] * self.size
        for node in self.nodes:
            own[node.first : node.first + len(node.instant)] = node.instant
        self._instants = own
        used = {slot for node in self.nodes for slot in node.sources}
        self._coupled = any(circular for _, circular in self._circular) or bool(
            used.intersection(self.iteration.averaged)
        )

    def begin(self, stimuli: FloatArray) -> None:
        self.taken, self._length = TakenSteps(), self.iteration.parts
        self._discarded: StepDiscarded | None = None
        super().begin(stimuli)

    def _take(self, tick: int) -> None:
        acting = self._through(tick)
        for node in self.nodes:
            node.held = node.inputs(acting)

    def _through(self, tick: int) -> list[float]:
        """Take a communication step; the values that acted at its beginning."""
        acting, at = list(self.values), 0
        while at < self.iteration.parts:
            length = self._length
            while at % length:
                length //= 2
            now = tick * self.iteration.parts + at
            if self.iteration.control is None:
                self._require_settled(self._attempt(now, length), now)
            elif not self._controlled(now, length, self.iteration.control):
                continue
            self._count(
                length if self.iteration.control is None else length / 2, 1 if self.iteration.control is None else 2
            )
            if at == 0:
                acting = [
                    self.values[slot] if instant else value
                    for slot, (value, instant) in enumerate(zip(acting, self._instants, strict=True))
                ]
            at += length
        return acting

    def _count(self, length: float, steps: int) -> None:
        taken = self.taken
        taken.steps += steps
        taken.shortest = min(taken.shortest, length * float(self.iteration.span) / self.iteration.parts)

    def _controlled(self, now: int, length: int, control: StepControl) -> bool:
        """Take a step in two halves where they agree with the whole; else go back, have the next be shorter, and say
        so."""
        with self._saved() as (states, values):
            whole = self.values if self._attempt(now, length) else None
            self._back(states, values)
            half = length / 2
            settled = self._attempt(now, half) and self._attempt(now + half, half)
            error = self._error(whole, control) if settled and whole is not None else math.inf
            if error <= 1.0 or (settled and length == 1):
                if error > 1.0:
                    self._tell_forced(now)
                self._length = length * 2 if error < _GROWS and length < self.iteration.parts else length
                return True
            if length == 1:
                if self._discarded is not None:
                    raise self._discarded
                self._require_settled(False, now)
            self._back(states, values)
            self._length = length // 2
            self.taken.rejected += 3 if settled else 2
            return False

    def _tell_forced(self, now: int) -> None:
        if not self.taken.forced:
            LOG.warning(
                "t = %g s: the error of a step is larger than the tolerance, and it is the shortest; it counts",
                self.iteration.fine(now),
            )
        self.taken.forced += 1

    def _error(self, whole: Sequence[float], control: StepControl) -> float:
        """Of the two halves that were taken, in shares of the tolerance."""
        found = [
            abs(self.values[slot] - whole[slot]) / (_RICHARDSON * control.tolerance * (1.0 + abs(self.values[slot])))
            for slot in self.iteration.averaged
        ]
        return max(found, default=0.0)

    def _attempt(self, now: float, length: float) -> bool:
        """Iterate a step of so many parts; False where it does not settle within the limit, or a component discards it
        and it can be shortened."""
        self._discarded = None
        time, duration = self._time(now), float(self.iteration.span * Fraction(length) / self.iteration.parts)
        begin, ends = list(self.values), list(self.values)
        with self._saved() as (states, _):
            for turn in range(self.cycles.limit):
                before = list(ends)
                try:
                    self._turn(begin, ends, time, duration)
                except StepDiscarded as error:
                    if self.iteration.control is None:
                        raise
                    self._discarded = error
                    self._back(states, begin)
                    return False
                self.iterations += 1
                self.values = ends
                if (turn and self._settled(before)) or not self._coupled:
                    self._read_ends(ends)
                    return True
                grown = self.finite and not math.isfinite(sum(ends))
                self._back(states, begin)
                if grown:
                    break
        return False

    def _turn(self, begin: Sequence[float], ends: list[float], time: float, duration: float) -> None:
        """Step all components once, from the values of the step's beginning to those of its end, as far as known."""
        starts = list(begin)
        for node in self.nodes:
            inputs = node.inputs(self._over_the_step(node, starts, ends))
            if node.component.name in self.iteration.reacting and node.sources:
                node.component.write(inputs)
                _put(starts, node.first, node.component.read())
            outputs = self.called(node, inputs, time, duration)
            _put(ends, node.first, outputs)
            if self.iteration.control is None:
                self.require_finite(node, outputs, stepping(time, duration))

    def _read_ends(self, ends: list[float]) -> None:
        """Have outputs that react to inputs at once be those of the step's end, not of means over it."""
        for node in self.nodes:
            if node.component.name in self.iteration.reacting and node.sources:
                node.component.write(node.inputs(ends))
                _put(ends, node.first, node.component.read())

    def _over_the_step(self, node: LoopNode, starts: Sequence[float], ends: Sequence[float]) -> list[float]:
        """What each slot is held at for a component over a step that starts and may end so."""
        held = [end if instant else value for value, end, instant in zip(starts, ends, self._instants, strict=True)]
        for slot in () if node.component.name in self.iteration.sampling else self.iteration.averaged:
            held[slot] = 0.5 * (starts[slot] + ends[slot])
        return held

    def _time(self, now: float) -> float:
        """Of a count of parts, of which halves are exact, too."""
        return (self.iteration.fine.first + now * self.iteration.fine.step) / self.iteration.fine.denominator

    def _require_settled(self, settled: bool, now: float) -> None:
        if not settled:
            names = ", ".join(node.component.name for node in self.nodes)
            fix = "relax the tolerance of `cycles`, or have `step` be shorter"
            if self.iteration.control is None:
                fix = "shorten `step`, or give it a `tolerance`, so that it is shortened where it has to be"
            problem = f"the step from t = {self._time(now):g} s did not settle in {self.cycles.limit} iterations"
            raise FmuError(names, problem, fix)

    @contextmanager
    def _saved(self) -> Iterator[tuple[list[Any], list[float]]]:
        """Snapshots of all components, freed in the end, and the values that hold."""
        states: list[Any] = []
        try:
            for node in self.nodes:
                states.append(node.component.save())
            yield states, list(self.values)
        finally:
            for node, state in zip(self.nodes, states, strict=False):
                node.component.drop(state)

    def _back(self, states: Sequence[Any], values: Sequence[float]) -> None:
        for node, state in zip(self.nodes, states, strict=True):
            node.component.restore(state)
        self.values = list(values)


def _put(values: list[float], first: int, fresh: Sequence[float]) -> None:
    values[first : first + len(fresh)] = fresh
