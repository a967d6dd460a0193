"""Free runs of a system of FMUs over the windows of a study: the simulator behind output-error estimation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from identification.output_error.windows import FreeRunWindow
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


class SystemSimulator:
    """A system that is opened once and reset for each run."""

    def __init__(self, factory: SystemFactory) -> None:
        self._factory = factory
        self._opened = OpenSystem(factory.assembled)
        try:
            self._simulation: Simulation = self._opened.simulation(factory.timing)
        except BaseException:
            self._opened.close()
            raise

    def simulate(self, window: int, values: Mapping[str, float]) -> FloatArray:
        """(K, m) what a window's outputs are recorded as; `values` go over the trace's own, those over the study's.

        Values of names without a dot are delays.
        """
        cut = self._factory.windows[window]
        own = {name: value for name, value in values.items() if "." in name}
        merged = {**self._factory.values, **cut.constants, **own, **cut.start_values(values)}
        run = Run(merged, cut.driven(values), self._factory.outputs, cut.stop)
        return cut.recorded(self._simulation.rows(run), values)

    def close(self) -> None:
        """Free the FMUs."""
        self._opened.close()
