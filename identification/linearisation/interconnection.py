"""Components in continuous time joined to one plant, sampled exactly under held inputs; N of them side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linearisation.slopes import Slopes
from orchestrator.system import Connection, Endpoint
from orchestrator.trace import FloatArray

HIDDEN = 1e-9  # singular value, of the matrix's size, below which a direction is neither reached nor seen


@dataclass(frozen=True)
class ShownOutput:
    """An output of a plant: factor * a variable of a component.

    Attributes:
        factor: in the output's unit per unit of the variable.
    """

    end: Endpoint
    factor: float = 1.0


def joined(
    parts: Mapping[str, Slopes],
    connections: Sequence[Connection],
    inputs: Mapping[str, Endpoint],
    outputs: Mapping[str, ShownOutput],
    step: float,
    place: str,
) -> list[LinearModel]:
    """The plants from inputs to outputs, sampled every `step` [s], of what the inputs reach and the outputs show.

    Args:
        parts: component -> its N linear models.
        inputs: name -> component.input that is driven from outside.

    Raises:
        IdentificationError: circles of direct feed-through that have no solution.
    """
    ins = [Endpoint(name, variable) for name, part in parts.items() for variable in part.inputs]
    outs = [Endpoint(name, variable) for name, part in parts.items() for variable in part.outputs]
    inner, outer = np.zeros((len(ins), len(outs))), np.zeros((len(ins), len(inputs)))
    for link in connections:
        inner[ins.index(link.target), outs.index(link.source)] += link.factor
    for column, end in enumerate(inputs.values()):
        outer[ins.index(end), column] = 1.0
    shown = np.zeros((len(outputs), len(outs)))
    for row, seen in enumerate(outputs.values()):
        shown[row, outs.index(seen.end)] = seen.factor
    a, b, c, d = connected(parts, inner, outer, place)
    names = tuple(inputs), tuple(outputs)
    a, b, c = reached_and_seen(a, b, shown @ c)
    moved, driven = held(a, b, step)
    return [LinearModel(*matrices, step, *names) for matrices in zip(moved, driven, c, shown @ d, strict=True)]


def connected(
    parts: Mapping[str, Slopes], inner: FloatArray, outer: FloatArray, place: str
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """N systems in continuous time, from outer inputs to all outputs of their components.

    Args:
        inner: (inputs, outputs) of all components, what outputs give to inputs.
        outer: (inputs, outer inputs).

    Raises:
        IdentificationError: circles of direct feed-through that have no solution.
    """
    a, b, c, d = (blocks([getattr(part, name) for part in parts.values()]) for name in "abcd")
    around = np.eye(d.shape[1]) - d @ inner
    if np.any(np.abs(np.linalg.det(around)) < 1e-12):
        raise IdentificationError(place, "has a circle of direct feed-through without a solution", "break it up")
    y = np.linalg.solve(around, np.concatenate([c, d @ outer], axis=2))  # of states and outer inputs
    n = a.shape[1]
    return a + b @ inner @ y[:, :, :n], b @ (inner @ y[:, :, n:] + outer), y[:, :, :n], y[:, :, n:]


def blocks(matrices: Sequence[FloatArray]) -> FloatArray:
    """(N, rows, columns) block diagonal."""
    count = max((len(matrix) for matrix in matrices), default=1)
    rows, columns = (sum(matrix.shape[axis] for matrix in matrices) for axis in (1, 2))
    whole, row, column = np.zeros((count, rows, columns)), 0, 0
    for matrix in matrices:
        height, width = matrix.shape[1:]
        whole[:, row : row + height, column : column + width] = matrix
        row, column = row + height, column + width
    return whole


def reached_and_seen(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What of N systems their inputs reach and their outputs show (Kalman): one subspace for all of them."""
    basis = _common(a, b)
    a, b, c = basis.T @ a @ basis, basis.T @ b, c @ basis
    basis = _common(a.swapaxes(1, 2), c.swapaxes(1, 2))
    return basis.T @ a @ basis, basis.T @ b, c @ basis


def _common(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, r) the basis of what the first system reaches, with what any other reaches beyond it."""
    basis = _staircase(a[0], b[0])
    for _ in range(len(a)):
        beyond = a @ basis - basis @ (basis.T @ (a @ basis))
        new = b - basis @ (basis.T @ b)
        size = HIDDEN * np.linalg.norm(a, axis=(1, 2))
        outside = (np.linalg.norm(beyond, axis=(1, 2)) > size) | (
            np.linalg.norm(new, axis=(1, 2)) > HIDDEN * np.linalg.norm(b, axis=(1, 2))
        )
        if not outside.any():
            break
        other = int(np.argmax(outside))
        basis = _staircase(a[other], np.hstack([basis, b[other]]))
    return basis


def _staircase(a: FloatArray, b: FloatArray) -> FloatArray:
    """(n, r) an orthonormal basis of what b reaches through a, direction by direction."""
    size = float(np.linalg.norm(a, 2)) if a.size else 0.0
    basis = np.zeros((len(a), 0))
    new, scale = b, float(np.linalg.norm(b)) if b.size else 0.0
    while new.size and scale > 0 and basis.shape[1] < len(a):
        new = new - basis @ (basis.T @ new)
        new = new - basis @ (basis.T @ new)
        u, s, _ = np.linalg.svd(new, full_matrices=False)
        found = u[:, s > HIDDEN * scale]
        if not found.size:
            break
        basis = np.hstack([basis, found])
        new, scale = a @ found, size
    return basis


def held(a: FloatArray, b: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """A and B of N systems over a step [s] in which their inputs are held."""
    count, n, m = b.shape
    block = np.zeros((count, n + m, n + m))
    block[:, :n, :n], block[:, :n, n:] = a, b
    whole = expm(block * step)
    return whole[:, :n, :n], whole[:, :n, n:]
