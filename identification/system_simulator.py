"""Free runs of a system of FMUs over the windows of a study: the simulator behind output-error estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from identification.windows import Cut
from orchestrator.assembly import Assembled, OpenSystem
from orchestrator.engine import Simulation, Timing
from orchestrator.slave import Value
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class SystemFactory:
    """Opens the system of a study in whatever process calls it.

    Attributes:
        outputs: component.variable of the outputs that are compared, in order.
    """

    assembled: Assembled
    cuts: Sequence[Cut]
    outputs: tuple[str, ...]
    values: Mapping[str, Value]

    def __call__(self) -> SystemSimulator:
        return SystemSimulator(self)


class SystemSimulator:
    """A system that is opened once and reset for each run."""

    def __init__(self, factory: SystemFactory) -> None:
        self._factory = factory
        self._opened = OpenSystem(factory.assembled)
        step = factory.cuts[0].step
        longest = max(len(cut.measured) for cut in factory.cuts) - 1
        try:
            self._simulation: Simulation = self._opened.simulation(Timing(stop=longest * step, step=step))
        except BaseException:
            self._opened.close()
            raise

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, m) outputs of a window; `values` go over the trace's own, and those over the study's."""
        cut = self._factory.cuts[window]
        stop: Fraction = (len(cut.measured) - 1) * cut.step
        merged = {**self._factory.values, **cut.constants, **values}
        result = self._simulation.run(merged, cut.stimuli, self._factory.outputs, stop=stop)
        return np.column_stack([result.trace[name] for name in self._factory.outputs])

    def close(self) -> None:
        """Free the FMUs."""
        self._opened.close()
