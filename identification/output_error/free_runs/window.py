"""What a window of a trace says of the free run over it; all that another process has to know to simulate it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from identification.output_error.search.problem import Window
from identification.output_error.times.delays import Command, Delay, StartReading, late_outputs
from orchestrator.crossing import Crossing
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray


@dataclass(frozen=True, eq=False)
class FreeRunWindow(Window):
    """A window with what drives its free run and where it starts, on the run's communication instants.

    Attributes:
        start: where in the trace it begins [s].
        step: between two instants [s].
        count: instants of the free run, K.
        at: (K',) when outputs are compared, in steps from its beginning: all instants, or samples of a recording that
            come less often, but for those that a delay leaves out.
        stimuli: component.input -> (K,) values; of delayed ones, with the delay that the study starts from.
        commands: the inputs that count by their means over each step: the delayed ones, and others that are to.
        delays: of the outputs those that free runs bring, as parameters are; None where stamps are corrected.
        initial: component.variable -> measured start value, with the delay that the study starts from.
        readings: those that are read off a delayed output.
        constants: component.variable -> value that holds for this trace.
        stepwise: columns of outputs that change in steps.
        crossings: how its signals got to the units of the variables.
    """

    start: float
    step: Fraction
    count: int
    at: FloatArray
    stimuli: Mapping[str, FloatArray]
    commands: Mapping[str, Command]
    delays: tuple[Delay | None, ...]
    initial: Mapping[str, float]
    readings: Mapping[str, StartReading]
    constants: Mapping[str, Value]
    stepwise: frozenset[int] = frozenset()
    crossings: tuple[Crossing, ...] = ()

    @property
    def run_time(self) -> FloatArray:
        """(K,) instants of the free run in the trace's time [s]."""
        return np.asarray(self.start + np.arange(self.count) * float(self.step))

    @property
    def time(self) -> FloatArray:
        """(K',) instants that are compared in the trace's time [s]."""
        return np.asarray(self.start + self.at * float(self.step))

    @property
    def steps(self) -> FloatArray:
        return self.at

    @property
    def stop(self) -> Fraction:
        """How long the free run is [s]."""
        return (self.count - 1) * self.step

    def driven(self, values: Mapping[str, float]) -> dict[str, FloatArray]:
        """component.input -> (K,) values, with delays of these values."""
        return {
            **self.stimuli,
            **{name: held.values(self.run_time, held.delay.at(values)) for name, held in self.commands.items()},
        }

    def start_values(self, values: Mapping[str, float]) -> dict[str, float]:
        """component.variable -> start value read off a delayed output, with delays of these values."""
        return {name: reading.value(reading.delay.at(values)) for name, reading in self.readings.items()}

    def recorded(self, simulated: FloatArray, values: Mapping[str, float]) -> FloatArray:
        """(K', m) what would have been recorded of a free run's outputs (K, m), with delays of these values."""
        delays = [None if delay is None else delay.at(values) for delay in self.delays]
        return late_outputs(simulated, float(self.step), delays, self.at, self.stepwise)
