"""Free runs of a system of FMUs over the windows of a study: the simulator behind output-error estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from identification.output_error.free_runs.window import FreeRunWindow
from orchestrator.assembly.assembly import Assembled, OpenSystem
from orchestrator.engine import Run, Simulation, Timing
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class SystemFactory:
    """Opens the system of a study in whatever process calls it.

    Attributes:
        outputs: component.variable of the outputs that are compared, in order.
        timing: of the longest window; an output that is compared has to be finite whatever it says.
    """

    assembled: Assembled
    windows: Sequence[FreeRunWindow]
    outputs: tuple[str, ...]
    values: Mapping[str, Value]
    timing: Timing

    def __call__(self) -> SystemSimulator:
        return SystemSimulator(self)


class FreeRuns:
    """Free runs over windows, of a system that is open and reset for each run."""

    def __init__(
        self,
        simulation: Simulation,
        windows: Sequence[FreeRunWindow],
        outputs: tuple[str, ...],
        values: Mapping[str, Value],
    ) -> None:
        self._simulation, self._windows, self._outputs, self._values = simulation, windows, outputs, values

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, m) what a window's outputs are recorded as; `values` go over the trace's own, those over the study's.

        Values of names without a dot are delays.
        """
        return self._windows[window].recorded(self._simulation.rows(self._run(window, values)), values)

    def sensitivities(self, window: int, values: Mapping[str, float], by: Sequence[str]) -> FloatArray:
        """(K, m, 1 + d) the same, and behind it the derivatives by values that the FMUs are given."""
        found = self._simulation.sensitivities(self._run(window, values), by)
        slices = [found.rows, *np.moveaxis(found.slopes, 2, 0)]
        return np.stack([self._windows[window].recorded(one, values) for one in slices], axis=2)

    def _run(self, window: int, values: Mapping[str, float]) -> Run:
        cut = self._windows[window]
        own = {name: value for name, value in values.items() if "." in name}
        merged = {**self._values, **cut.constants, **own, **cut.start_values(values)}
        return Run(merged, cut.driven(values), self._outputs, cut.stop)

    def close(self) -> None:
        """Nothing: who has opened the system closes it."""


class SystemSimulator(FreeRuns):
    """A system that is opened once."""

    def __init__(self, factory: SystemFactory) -> None:
        self._opened = OpenSystem(factory.assembled)
        try:
            simulation: Simulation = self._opened.simulation(factory.timing)
        except BaseException:
            self._opened.close()
            raise
        super().__init__(simulation, factory.windows, factory.outputs, factory.values)

    def close(self) -> None:
        """Free the FMUs."""
        self._opened.close()
