"""Slopes of a library model where it rests, of many sets of parameters at once: its functions take arrays.

    x' = A x + B u,   y = C x + D u

What a model samples without remembering it, such as a measuring channel, is shown as it is at the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from fmus.modelling.model import Model, namespace, start_values
from orchestrator.trace import FloatArray

WIDTHS = (1e-4, 1e-6)  # of the central differences, in the variables' units
COARSE = 1e-2  # of those that tell a step of rounding from no slope at all
ALIKE = 1e-4  # relative, how far slopes of both widths may be apart
SLOW = 1e-9  # of the states' rates, below which a model rests
Parameters = Mapping[str, Any]  # name -> number, or (N,)
Results = tuple[list[Any], list[Any]]  # rates and outputs


@dataclass(frozen=True, eq=False)
class Slopes:
    """N linear models of one component, in continuous time.

    Attributes:
        a, b, c, d: (N, n, n), (N, n, m), (N, p, n), (N, p, m).
        states, inputs, outputs: names.
        by: what they were found by, where that is to be told.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    by: str = ""


def slopes(place: str, model: Model, parameters: Parameters, count: int = 1) -> Slopes:
    """The model's matrices for N sets of parameters over its own.

    Args:
        place: of the component, for messages.
        parameters: each one number, or one of each set.

    Raises:
        IdentificationError: it does not rest where it starts, remembers what it samples, or has no slope there.
    """
    equations = _Equations(model, parameters)
    _require_rest(place, equations, count)
    wide, narrow = (_differences(equations, width, count) for width in WIDTHS)
    apart = np.abs(wide - narrow) > ALIKE * np.maximum(np.abs(wide), np.abs(narrow)) + 1e-6
    if not np.isfinite(wide).all() or apart.any():
        fix = "switch off what does, such as dry friction, play, noise and rounding, by its parameters"
        raise IdentificationError(place, f"'{model.name}' jumps or bends where it rests", fix)
    if model.update is not None and np.any((wide == 0) & (_differences(equations, COARSE, count) != 0)):
        raise IdentificationError(place, f"'{model.name}' rounds what it samples", "set its `bits` to 0, for tuning")
    n, m = len(equations.states), len(equations.inputs)
    if np.any(wide[:, :, n + m :]):
        problem = f"'{model.name}' remembers what it samples"
        raise IdentificationError(place, problem, "leave it out of the plant, or make it part of the controller")
    top, bottom = wide[:, :n], wide[:, n:]
    names = equations.states, equations.inputs, equations.outputs
    return Slopes(top[:, :, :n], top[:, :, n : n + m], bottom[:, :, :n], bottom[:, :, n : n + m], *names)


class _Equations:
    """A model's functions of one vector: continuous states, inputs, sampled states."""

    def __init__(self, model: Model, parameters: Parameters) -> None:
        self.model = model
        values = {**start_values(model), **parameters}
        self.states = tuple(state.name for state in model.continuous)
        self.sampled = tuple(state.name for state in model.sampled)
        self.inputs = tuple(variable.name for variable in model.of("input"))
        self.outputs = tuple(variable.name for variable in model.of("output"))
        self._p = namespace({variable.name: values[variable.name] for variable in model.of("parameter")})
        start = {s.name: values[s.start] if isinstance(s.start, str) else s.start for s in model.states}
        self.names = (*self.states, *self.inputs, *self.sampled)
        self.rest: dict[str, Any] = {name: start.get(name, values.get(name)) for name in self.names}

    def __call__(self, point: Mapping[str, Any]) -> Results:
        """Rates and outputs at a point, the outputs after sampling."""
        model = self.model
        x = SimpleNamespace(**{name: point[name] for name in (*self.states, *self.sampled)})
        u = SimpleNamespace(**{name: point[name] for name in self.inputs})
        rates = dict(model.derivatives(0.0, x, u, self._p)) if model.derivatives else {}
        new = dict(model.update(0.0, x, u, self._p)) if model.update else {}
        after = SimpleNamespace(**{**vars(x), **new})
        shown = {**vars(after), **(dict(model.outputs(0.0, after, u, self._p)) if model.outputs else {})}
        return [rates[name] for name in self.states], [shown[name] for name in self.outputs]


def _require_rest(place: str, equations: _Equations, count: int) -> None:
    moving = np.abs(_stacked([equations(equations.rest)[0]], count)).max(axis=0)
    if np.any(moving > SLOW):
        name = equations.states[int(np.argmax(moving))]
        problem = f"does not rest where it starts: '{name}' changes by {moving.max():.3g} a second"
        raise IdentificationError(place, problem, "give start values at which it rests")


def _differences(equations: _Equations, width: float, count: int) -> FloatArray:
    """(N, rows, columns) central differences of all results by all variables."""
    columns = []
    for name in equations.names:
        rest = equations.rest[name]
        above, below = ({**equations.rest, name: rest + sign * width} for sign in (1, -1))
        ends = [_stacked(equations(point), count) for point in (above, below)]
        columns.append((ends[0] - ends[1]) / (2 * width))
    rows = len(equations.states) + len(equations.outputs)
    return np.stack(columns, axis=2) if columns else np.zeros((count, rows, 0))


def _stacked(results: Sequence[Sequence[Any]], count: int) -> FloatArray:
    """(N, R) all results, one after the other."""
    values = [np.broadcast_to(np.asarray(value, dtype=float), (count,)) for group in results for value in group]
    return np.stack(values, axis=1) if values else np.zeros((count, 0))
