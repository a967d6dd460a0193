"""A controller of the library, or of a model file, linearised through its own equations by central differences.

It rests where it starts: what is measured and asked for is zero, and it is enabled. Of equations that are linear there
the differences are exact to rounding; those of two widths have to agree, so that a jump or a kink there is told.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fmus.errors import IdentificationError
from fmus.modelling.instance import Instance
from fmus.modelling.model import Model, start_values
from fmus.modelling.symbolic import conflicts
from identification.linear.model import LinearModel
from identification.linearisation.equations import ModelEquations
from identification.linearisation.slopes import differ
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray

WIDTHS = (1e-3, 1e-5)  # of the differences, in the variables' units


class ModelController:
    """The matrices of a sampled model for values of its parameters.

    Attributes:
        inputs, outputs: its variables.

    Raises:
        IdentificationError: it has continuous states, is a plant, or has no slope where it rests.
    """

    def __init__(self, name: str, model: Model, values: Mapping[str, Value]) -> None:
        if model.continuous or model.update is None or model.sample_time is None or model.plant:
            fix = "choose one with `update`, such as pdp"
            raise IdentificationError(name, f"model '{model.name}' is no sampled controller", fix)
        self.name, self._model, self._sample_time = name, model, model.sample_time
        self._values = {key: float(value) for key, value in {**start_values(model), **values}.items()}
        equations = ModelEquations(model, self._values)
        self.inputs, self.outputs, self._states = equations.inputs, equations.outputs, equations.sampled
        self._require_fitting()
        self.require_slopes({})

    def _require_fitting(self) -> None:
        """See that its own parameters fit together, as its FMU would."""
        conflict = Instance(self._model, self._values).conflict(conflicts(self._model))
        if conflict:
            raise IdentificationError(self.name, conflict)

    def step(self, values: Mapping[str, float]) -> float:
        """Its sampling time [s] with these parameters over its own."""
        return {**self._values, **values}[self._sample_time]

    def linear(self, values: Mapping[str, float]) -> LinearModel:
        """The controller with these parameters over its own, without states that nothing moves or shows.

        Raises:
            IdentificationError: its slopes are not finite there.
        """
        a, b, c, d = self._slopes(values, WIDTHS[0])
        if not all(np.isfinite(matrix).all() for matrix in (a, b, c, d)):
            raise IdentificationError(self.name, "has no finite slope where it rests", "mend its equations")
        kept = _moved_and_shown(a, b, c)
        a, b, c = a[np.ix_(kept, kept)], b[kept], c[:, kept]
        return LinearModel(a, b, c, d, self.step(values), self.inputs, self.outputs)

    def require_slopes(self, values: Mapping[str, float]) -> None:
        """See that it is as good as linear where it rests.

        Raises:
            IdentificationError: it jumps or bends there.
        """
        wide, narrow = (self._slopes(values, width) for width in WIDTHS)
        for one, other, row in zip(wide, narrow, (self._states, self._states, self.outputs, self.outputs), strict=True):
            if (apart := differ(one, other)).any():
                name = row[int(np.nonzero(apart)[0][0])]
                raise IdentificationError(
                    f"{self.name}.{name}",
                    "jumps or bends where the controller rests, so that it has no linear model there",
                    "give it a band, or parameters without friction compensation, for tuning",
                )

    def _slopes(
        self, values: Mapping[str, float], width: float
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """A, B, C, D of all states."""
        m, p = len(self.inputs), len(self.outputs)
        [whole] = ModelEquations(self._model, {**self._values, **values}).differences(width)
        return whole[p:, m:], whole[p:, :m], whole[:p, m:], whole[:p, :m]


def _moved_and_shown(a: FloatArray, b: FloatArray, c: FloatArray) -> list[int]:
    """Numbers of the states that an input reaches and that reach an output, by what is not zero."""
    moved, shown = (b != 0).any(axis=1), (c != 0).any(axis=0)
    for _ in range(len(a)):
        moved = moved | (a[:, moved] != 0).any(axis=1)
        shown = shown | (a[shown] != 0).any(axis=0)
    return [int(i) for i in np.flatnonzero(moved & shown)]
