"""A run that is stepped from outside, one communication step at a time, by whoever owns the clock.

Its inputs are set and its outputs read between steps. It takes the steps that a run takes whose stimuli are those
inputs, and leaves the same record.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Generic, TypeVar

import numpy as np

from orchestrator.engine.loop import Loop, Stepper
from orchestrator.engine.recording import Recorder
from orchestrator.engine.tuned import Tuned, ValueChange
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray

HELD = 1 << 60  # ticks for which the one row of stimuli holds: longer than any run
FARTHEST = 1 << 40  # tick up to which the times are to be exact

R = TypeVar("R")


class LiveRun(Generic[R]):
    """A run under way; `Simulation.live` begins one.

    `outputs` has, after step k, what is to be seen from outside at t_k: of dynamics the values at the beginning of the
    step, of samplers and gains those with which they react to the inputs of the step.

    Args:
        outputs: (component.output, its slot, whether it is instant).
        conclude: makes the result, of the time that the steps took [s].

    Attributes:
        inputs: component.input of the entries of `given`.
        given: (n,) values of the inputs from the next step on, to be written in place.
        names: component.output of the entries of `outputs`.
        outputs: their values, once a step was taken.
        steps: how many were taken.
        tuned: what can be changed between steps.
    """

    def __init__(
        self,
        loop: Loop,
        engine: Stepper,
        recorder: Recorder,
        every: int,
        inputs: Sequence[str],
        outputs: Sequence[tuple[str, int, bool]],
        conclude: Callable[[float], R],
        tuned: Tuned,
    ) -> None:
        self.inputs = tuple(inputs)
        self.given: FloatArray = loop.stimuli[0] if inputs else np.zeros(0)
        self.names = tuple(name for name, _, _ in outputs)
        self.outputs = [0.0] * len(outputs)
        self.steps = 0
        self.tuned = tuned
        self._loop, self._engine, self._recorder, self._every, self._conclude = loop, engine, recorder, every, conclude
        self._instant = _where(outputs, True)
        self._deferred = _where(outputs, False)
        self._seconds, self._whole = 0.0, True

    @property
    def time(self) -> float:
        """Up to where it has stepped [s]."""
        return self._loop.time(self.steps * self._every)

    def change(self, name: str, value: Value, by: str) -> ValueChange:
        """Give what can be changed a checked value, from the next step on; what came of it.

        Raises:
            FmuError: its FMU refuses.
        """
        return self.tuned.change(name, value, self.steps, self.time, by)

    def step(self) -> None:
        """Take a communication step.

        Raises:
            FmuError: an FMU failed; no further step can be taken.
        """
        begun = perf_counter()
        engine, recorder = self._engine, self._recorder
        last, self._whole = engine.tick + self._every, False
        self._look(self._deferred)
        while engine.tick < last:
            engine.advance(last, recorder)
            if recorder.full(engine.recorded):
                recorder.empty(engine.recorded)
        self._look(self._instant)
        self.steps, self._whole = self.steps + 1, True
        self._seconds += perf_counter() - begun

    def flush(self) -> None:
        """Pass on what has been recorded until now."""
        self._recorder.empty(self._engine.recorded)

    def result(self) -> R:
        """What the run gave up to its last whole step; it cannot be stepped any more.

        The time that its account says is what the steps took, not what passed between them.
        """
        self._engine.finish()
        if self._whole and self._loop.tick % self._recorder.every == 0:
            self._loop.record(self._recorder)
        self._recorder.empty(self._loop.recorded)
        return self._conclude(self._seconds)

    def _look(self, places: tuple[list[int], list[int]]) -> None:
        for place, value in zip(places[0], self._engine.held(places[1]), strict=True):
            self.outputs[place] = value


def _where(outputs: Sequence[tuple[str, int, bool]], instant: bool) -> tuple[list[int], list[int]]:
    """Places among the outputs, and slots, of those that are instant or that are not."""
    chosen = [(place, slot) for place, (_, slot, at_once) in enumerate(outputs) if at_once == instant]
    return [place for place, _ in chosen], [slot for _, slot in chosen]
