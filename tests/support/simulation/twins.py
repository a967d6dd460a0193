"""Library models in plain Python as components of a simulation, and differences of their runs."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from fmus import library
from fmus.modelling.instance import Instance
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.interface import Interface, Value
from orchestrator.trace import FloatArray


class Twin:
    """A model of the library that runs as its functions say; no FMU.

    Attributes:
        inner: steps that its solver takes for one step of the loop; differences say nothing across a change of them.
    """

    warnings = 0

    def __init__(self, model: str, name: str, interface: Interface) -> None:
        self.name, self.interface, self.inner = name, interface, 0
        self._model = library.find(model)
        self.reset()

    def set(self, values: Mapping[str, Value]) -> None:
        for variable, value in values.items():
            self._instance.set(variable, value)  # type: ignore[arg-type]

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._instance.begin(start)

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._inputs, self._outputs = inputs, outputs

    def write(self, values: Sequence[float]) -> None:
        for variable, value in zip(self._inputs, values, strict=True):
            self._instance.set(variable, value)

    def read(self) -> Sequence[float]:
        return [float(self._instance.get(variable)) for variable in self._outputs]

    def run(self) -> None:
        pass

    def step(self, time: float, duration: float) -> None:
        if self._model.solver_step:
            self.inner = math.ceil(duration / self._model.solver_step(self._instance.p) - 1e-9)
        self._instance.step(time, duration)

    def terminate(self) -> None:
        pass

    def reset(self) -> bool:
        self._instance = Instance(self._model)
        return False

    def close(self) -> None:
        pass


def width(value: float) -> float:
    """Of a difference by a value [its unit]."""
    return 1e-4 * (abs(value) or 1e-2)


def slopes(simulation: Simulation, run: Run, by: Sequence[str]) -> tuple[FloatArray, bool]:
    """(K, n, d) derivatives of a run of twins by differences of the fourth order, and whether these can be believed:
    all runs took the same inner steps, and none crossed a switch that the others did not."""
    taken, columns, smooth = set(), [], True
    for name in by:
        step = width(float(run.values[name]))
        sides = {}
        for shift in (-2, -1, 1, 2):
            moved = {**run.values, name: float(run.values[name]) + shift * step}
            sides[shift] = simulation.rows(Run(moved, run.stimuli, run.record)).copy()
            taken.add(tuple(twin.inner for twin in simulation.components.values()))  # type: ignore[attr-defined]
        near, far = (sides[1] - sides[-1]) / (2 * step), (sides[2] - sides[-2]) / (4 * step)
        rounding = 1e-14 * np.linalg.norm(sides[1]) / step
        smooth &= bool(np.linalg.norm(near - far) < 2e-6 * np.linalg.norm(near) + rounding)
        columns.append((4 * near - far) / 3)
    return np.stack(columns, axis=2), len(taken) == 1 and smooth
