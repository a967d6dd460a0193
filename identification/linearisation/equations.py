"""Slopes of a library model by differences of its functions, of many sets of parameters at once: they take arrays.

What a model samples without remembering it, such as a measuring channel, is shown as it is at the samples.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import numpy as np

from fmus.errors import IdentificationError
from fmus.modelling.model import Model, namespace, start_values
from identification.linearisation.slopes import DIFFERENCES, SLOW, WIDTHS, Sampling, Slopes, Standing, apart, quarters
from orchestrator.trace import FloatArray

COARSE = 1e-2  # of those that tell a step of rounding from no slope at all
Parameters = Mapping[str, Any]  # name -> number, or (N,)
Results = tuple[list[Any], list[Any], list[Any]]  # rates, outputs, sampled states


def slopes(place: str, model: Model, parameters: Parameters, count: int = 1, at: Standing | None = None) -> Slopes:
    """The model's matrices for N sets of parameters over its own.

    Args:
        place: of the component, for messages.
        parameters: each one number, or one of each set.
        at: where it is; None takes where it starts, and rests.

    Raises:
        IdentificationError: it does not rest where it starts, remembers what it samples, or has no slope there.
    """
    equations = ModelEquations(model, parameters, at)
    moving = _moving(place, equations, count)
    n, m, p = len(equations.states), len(equations.inputs), len(equations.outputs)
    wide = _smooth(place, equations, count, n + p)
    if np.any(wide[:, :, n + m :]):
        problem = f"'{model.name}' remembers what it samples"
        raise IdentificationError(place, problem, "leave it out of the plant, or make it part of the controller")
    names = equations.states, equations.inputs, equations.outputs
    return Slopes(*quarters(wide[:, :, : n + m], n), *names, DIFFERENCES, moving)


def sampling(
    place: str, model: Model, parameters: Parameters, period: float, at: Standing
) -> tuple[Slopes | None, Sampling]:
    """What a model does in continuous time, and what it does at its instants, which takes its continuous states among
    its inputs; None where it does nothing in between.

    Raises:
        IdentificationError: as `slopes`; or what it samples changes its rates.
    """
    equations = ModelEquations(model, parameters, at)
    n, m, p = len(equations.states), len(equations.inputs), len(equations.outputs)
    [wide] = _smooth(place, equations, 1, n + p + len(equations.sampled))
    rates, outputs, new = wide[:n], wide[n : n + p], wide[n + p :]
    if np.any(rates[:, n + m :]):
        problem = f"'{model.name}' has rates that depend on what it samples"
        raise IdentificationError(place, problem, "leave it out of the system")
    by_inputs = [*range(n, n + m), *range(n)]
    parts = new[:, n + m :], new[:, by_inputs], outputs[:, n + m :], outputs[:, by_inputs]
    names = (*equations.inputs, *equations.states), equations.outputs
    found = Sampling(*parts, *names, period, DIFFERENCES)
    if not n:
        return None, found
    shown = np.eye(n)[None], np.zeros((1, n, m))
    between = rates[None, :, :n], rates[None, :, n : n + m], *shown
    moving = _moving(place, equations, 1)
    return Slopes(*between, equations.states, equations.inputs, equations.states, DIFFERENCES, moving), found


class ModelEquations:
    """A model's functions of one vector: continuous states, inputs, sampled states.

    Attributes:
        at: where it is; None takes where it starts.
        names: of the vector's entries; rest: name -> what it is there.
    """

    def __init__(self, model: Model, parameters: Parameters, at: Standing | None = None) -> None:
        self.model, self.at = model, at
        values = {**start_values(model), **parameters}
        self.states = tuple(state.name for state in model.continuous)
        self.sampled = tuple(state.name for state in model.sampled)
        self.inputs = tuple(variable.name for variable in model.of("input"))
        self.outputs = tuple(variable.name for variable in model.of("output"))
        self._p = namespace({variable.name: values[variable.name] for variable in model.of("parameter")})
        start = {s.name: values[s.start] if isinstance(s.start, str) else s.start for s in model.states}
        self.names = (*self.states, *self.inputs, *self.sampled)
        known = start if at is None else {**start, **at.states, **at.inputs}
        self.rest: dict[str, Any] = {name: known.get(name, values.get(name)) for name in self.names}

    def __call__(self, point: Mapping[str, Any]) -> Results:
        """Rates, outputs and sampled states at a point, the last two after sampling."""
        model, t = self.model, self.at.time if self.at else 0.0
        x = SimpleNamespace(**{name: point[name] for name in (*self.states, *self.sampled)})
        u = SimpleNamespace(**{name: point[name] for name in self.inputs})
        rates = dict(model.derivatives(t, x, u, self._p)) if model.derivatives else {}
        new = dict(model.update(t, x, u, self._p)) if model.update else {}
        after = SimpleNamespace(**{**vars(x), **new})
        shown = {**vars(after), **(dict(model.outputs(t, after, u, self._p)) if model.outputs else {})}
        return (
            [rates[name] for name in self.states],
            [shown[name] for name in self.outputs],
            [new[name] for name in self.sampled],
        )

    def differences(self, width: float, count: int = 1) -> FloatArray:
        """(N, rows, columns) central differences of all results by all variables, of N sets of parameters."""
        columns = []
        for name in self.names:
            above, below = ({**self.rest, name: self.rest[name] + sign * width} for sign in (1, -1))
            ends = [_stacked(self(point), count) for point in (above, below)]
            columns.append((ends[0] - ends[1]) / (2 * width))
        rows = len(self.states) + len(self.outputs) + len(self.sampled)
        return np.stack(columns, axis=2) if columns else np.zeros((count, rows, 0))


def _moving(place: str, equations: ModelEquations, count: int) -> float:
    """How fast a state changes at most; where a model starts it has to rest."""
    rates = np.abs(_stacked([equations(equations.rest)[0]], count)).max(axis=0)
    if equations.at is None and np.any(rates > SLOW):
        name = equations.states[int(np.argmax(rates))]
        problem = f"does not rest where it starts: '{name}' changes by {rates.max():.3g} a second"
        raise IdentificationError(place, problem, "give start values at which it rests")
    return float(rates.max(initial=0.0))


def _smooth(place: str, equations: ModelEquations, count: int, rows: int) -> FloatArray:
    """(N, rows, columns) the differences of the first results, which have to be slopes."""
    model = equations.model
    wide, narrow = (equations.differences(width, count)[:, :rows] for width in WIDTHS)
    if not np.isfinite(wide).all() or apart(wide, narrow):
        fix = "switch off what does, such as dry friction, play, noise and rounding, by its parameters"
        raise IdentificationError(place, f"'{model.name}' jumps or bends where it rests", fix)
    if model.update is not None and np.any((wide == 0) & (equations.differences(COARSE, count)[:, :rows] != 0)):
        raise IdentificationError(place, f"'{model.name}' rounds what it samples", "set its `bits` to 0")
    return wide


def _stacked(results: Sequence[Sequence[Any]], count: int) -> FloatArray:
    """(N, R) all results, one after the other."""
    values = [np.broadcast_to(np.asarray(value, dtype=float), (count,)) for group in results for value in group]
    return np.stack(values, axis=1) if values else np.zeros((count, 0))
