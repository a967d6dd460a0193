"""What a refinement minimises: the output error of a model over records, with exact derivatives and constraints.

One-step errors are included: they are the output error of the predictor, whose inputs are inputs and outputs alike and
whose matrices are A - K C, [B - K D, K], C and [D, 0].
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import eig

from identification.linear.hankel import absorbed
from identification.linear.input_matrices import fit_inputs
from identification.linear.local_coordinates import Directions, flattened, local_directions
from identification.linear.model import LinearModel
from identification.linear.poles import Poles, constrained, integrator
from identification.linear.recursion import recursion
from orchestrator.trace import BoolArray, FloatArray

_CHUNK = 2**17  # numbers in the sensitivities of one chunk: what a processor's cache holds


@dataclass(frozen=True, eq=False)
class PredictionProblem:
    """Weighted output error of a model, the candidate, whose inputs may hold measured outputs.

    Attributes:
        data: (inputs, weighted outputs) of each record.
        feedthrough: where D is free.
        measured: columns of the inputs that are measured outputs: 0 for output error, p for innovations.
        poles: what the model without the predictor's correction keeps.
        starts: whether initial states are estimated.
    """

    data: tuple[tuple[FloatArray, FloatArray], ...]
    feedthrough: BoolArray
    measured: int
    poles: Poles
    starts: bool

    @property
    def samples(self) -> int:
        return sum(len(y) for _, y in self.data)

    def gain(self, model: LinearModel) -> FloatArray:
        """(n, p) the gain in a predictor; (n, 0) in a model for output error."""
        return model.b[:, model.b.shape[1] - self.measured :]

    def open_loop(self, model: LinearModel) -> FloatArray:
        """A (n, n) without the predictor's correction."""
        return model.a + self.gain(model) @ model.c[: self.measured]

    def admitted(self, model: LinearModel) -> bool:
        """Whether all poles that have to be inside the unit circle are."""
        predictor = np.abs(np.linalg.eigvals(model.a)).max() < 1 if self.measured else True
        if self.poles == "free":
            return bool(predictor)
        values = np.linalg.eigvals(self.open_loop(model)).astype(complex)
        if self.poles == "integrating":
            values = np.delete(values, integrator(values))
        return bool(predictor and np.abs(values).max(initial=0.0) < 1)

    def placed(self, model: LinearModel) -> LinearModel:
        """The model with its integrator on 1 again, which a step along the directions keeps to first order."""
        if self.poles != "integrating":
            return model
        before = self.open_loop(model)
        return replace(model, a=model.a + constrained(before, "integrating")[0] - before)

    def directions(self, model: LinearModel) -> Directions:
        """The degrees of freedom, those of an integrator's pole left out."""
        held = [self._integrator_gradient(model)] if self.poles == "integrating" else []
        return local_directions(model, self.feedthrough, held)

    def _integrator_gradient(self, model: LinearModel) -> FloatArray:
        """Of the pole on 1 of A + K C: w' (dA + dK C + K dC) v."""
        values, left, right = eig(self.open_loop(model), left=True, right=True)
        w, v = left[:, integrator(values)].real, right[:, integrator(values)].real
        b = np.zeros_like(model.b)
        b[:, model.b.shape[1] - self.measured :] = np.outer(w, model.c[: self.measured] @ v)
        c = np.outer(np.append(w @ self.gain(model), np.zeros(len(model.c) - self.measured)), v)
        gradient = flattened(np.outer(w, v), b, c, np.zeros(int(self.feedthrough.sum())))
        return np.asarray(gradient / np.linalg.norm(gradient))

    def starts_of(self, model: LinearModel) -> FloatArray:
        """(R, n) least-squares initial states, or zeros."""
        if not self.starts:
            return np.zeros((len(self.data), model.order))
        left = [(u[:, :0], y - model.simulate(u)) for u, y in self.data]
        return fit_inputs(model.a, model.c, left, self.feedthrough[:, :0]).starts

    def errors(self, model: LinearModel, starts: FloatArray) -> list[FloatArray]:
        """(K, p) of each record."""
        return [y - model.simulate(u, start) for (u, y), start in zip(self.data, starts, strict=True)]

    def rows(self, model: LinearModel, directions: Directions, record: int, start: FloatArray) -> Iterator[FloatArray]:
        """Rows (p K', n + t + 1) of [initial state, directions, error] for chunks of a record, instant by instant."""
        u, y = self.data[record]
        n, p, t = model.order, len(model.outputs), len(directions)
        length = max(16, _CHUNK // ((n + t) * n))
        state, slopes = start[None], np.concatenate([np.eye(n), np.zeros((t, n))])
        into_a, into_b = (
            directions.a.transpose(2, 0, 1).reshape(n, -1),
            directions.b.transpose(2, 0, 1).reshape(-1, t * n),
        )
        into_c, into_d = (
            directions.c.transpose(2, 0, 1).reshape(n, -1),
            directions.d.transpose(2, 0, 1).reshape(-1, t * p),
        )
        for begin in range(0, len(u), length):
            part = u[begin : begin + length]
            x, state = recursion(model.a, (part @ model.b.T)[:, None], state)
            force = np.zeros((len(part), n + t, n))
            force[:, n:] = (x[:, 0] @ into_a + part @ into_b).reshape(len(part), t, n)
            changes, slopes = recursion(model.a, force, slopes)
            seen = changes @ model.c.T
            seen[:, n:] += (x[:, 0] @ into_c + part @ into_d).reshape(len(part), t, p)
            error = y[begin : begin + length] - x[:, 0] @ model.c.T - part @ model.d.T
            yield np.concatenate([seen.transpose(0, 2, 1), error[:, :, None]], axis=2).reshape(-1, n + t + 1)

    def triangle(self, model: LinearModel, directions: Directions, starts: FloatArray) -> FloatArray:
        """(t + 1, t + 1) upper triangle of [Jacobian, error] over all records, initial states projected out."""
        total, own = np.zeros((0, len(directions) + 1)), model.order * self.starts
        for record, start in enumerate(starts):
            triangle = np.zeros((0, own + len(directions) + 1))
            for rows in self.rows(model, directions, record, start):
                triangle = absorbed(triangle, rows[:, model.order - own :])
            total = absorbed(total, triangle[own:, own:])
        return total
