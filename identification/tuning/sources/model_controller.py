"""A controller of the library, or of a model file, linearised through its own equations by central differences.

It rests where it starts: what is measured and asked for is zero, and it is enabled. Of equations that are linear there
the differences are exact to rounding; those of two widths have to agree, so that a jump or a kink there is told.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from types import SimpleNamespace

import numpy as np

from fmus.errors import IdentificationError
from fmus.modelling.instance import Instance
from fmus.modelling.model import Model, namespace, start_values
from fmus.modelling.symbolic import conflicts
from identification.linear.model import LinearModel
from identification.linearisation.slopes import differ
from orchestrator.fmi.interface import Value
from orchestrator.trace import FloatArray

WIDTHS = (1e-3, 1e-5)  # of the differences, in the variables' units
Equations = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]


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
        self.inputs = tuple(variable.name for variable in model.of("input"))
        self.outputs = tuple(variable.name for variable in model.of("output"))
        self._values = {key: float(value) for key, value in {**start_values(model), **values}.items()}
        self._states = [state.name for state in model.sampled]
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
        rest_x, rest_u, equations = self._equations({**self._values, **values})
        of_x = [_slope(lambda x: equations(x, rest_u), rest_x, i, width) for i in range(len(rest_x))]
        of_u = [_slope(lambda u: equations(rest_x, u), rest_u, i, width) for i in range(len(rest_u))]
        states, shown = len(self._states), len(self.outputs)
        a, c = (_columns([column[part] for column in of_x], size) for part, size in ((0, states), (1, shown)))
        b, d = (_columns([column[part] for column in of_u], size) for part, size in ((0, states), (1, shown)))
        return a, b, c, d

    def _equations(self, given: Mapping[str, float]) -> tuple[FloatArray, FloatArray, Equations]:
        """States and inputs where it rests, and (states, inputs) -> new states and what is shown from then on."""
        model, states = self._model, self._states
        p = namespace({variable.name: given[variable.name] for variable in model.of("parameter")})
        starts = [given[s.start] if isinstance(s.start, str) else float(s.start) for s in model.sampled]

        def equations(x: FloatArray, u: FloatArray) -> tuple[FloatArray, FloatArray]:
            before = SimpleNamespace(**dict(zip(states, x.tolist(), strict=True)))
            driven = SimpleNamespace(**dict(zip(self.inputs, u.tolist(), strict=True)))
            assert model.update is not None
            new = model.update(0.0, before, driven, p)
            after = SimpleNamespace(**{name: float(new[name]) for name in states})
            shown = dict(vars(after)) | dict(model.outputs(0.0, after, driven, p) if model.outputs else {})
            return np.array([vars(after)[name] for name in states]), np.array([float(shown[n]) for n in self.outputs])

        return np.array(starts), np.array([given[name] for name in self.inputs]), equations


def _slope(
    function: Callable[[FloatArray], tuple[FloatArray, FloatArray]], rest: FloatArray, number: int, width: float
) -> tuple[FloatArray, FloatArray]:
    """The central differences of both results by one variable."""
    above, below = rest.copy(), rest.copy()
    above[number] += width
    below[number] -= width
    span = above[number] - below[number]
    one, other = function(above), function(below)
    return (one[0] - other[0]) / span, (one[1] - other[1]) / span


def _columns(columns: list[FloatArray], rows: int) -> FloatArray:
    return np.column_stack(columns) if columns else np.zeros((rows, 0))


def _moved_and_shown(a: FloatArray, b: FloatArray, c: FloatArray) -> list[int]:
    """Numbers of the states that an input reaches and that reach an output, by what is not zero."""
    moved, shown = (b != 0).any(axis=1), (c != 0).any(axis=0)
    for _ in range(len(a)):
        moved = moved | (a[:, moved] != 0).any(axis=1)
        shown = shown | (a[shown] != 0).any(axis=0)
    return [int(i) for i in np.flatnonzero(moved & shown)]
