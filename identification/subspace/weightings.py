"""What each subspace method takes the singular vectors of, from one triangular factor of the data.

ORSE projects future outputs beside future inputs. MOESP, N4SID and CVA keep of that what the past tells, which keeps
noise out, and weigh it differently. In closed loop the past's autoregression stands for all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from identification.linear.hankel import HankelRows
from orchestrator.trace import FloatArray

Weighting = Literal["orse", "n4sid", "moesp", "cva"]
_RANK = 1e-10


@dataclass(frozen=True)
class Blocks:
    """Which rows the factor has: all inputs first, then past outputs, then the outputs in question.

    Attributes:
        groups: of rows, one below the other.
        given: rows of future inputs.
        inputs: rows of all inputs.
        known: rows of these and past outputs.
        outputs: rows of the outputs in question.
        past: block rows of the past.
    """

    groups: tuple[HankelRows, ...]
    given: int
    inputs: int
    known: int
    outputs: int
    past: int

    @property
    def count(self) -> int:
        """All rows."""
        return self.known + self.outputs


def blocks(inputs: int, outputs: int, past: int, seen: int, given: int, asked: int) -> Blocks:
    """The rows for so many inputs and outputs and so many block rows.

    Args:
        past, seen: of past inputs and of past outputs.
        given, asked: of inputs and of outputs from now on.
    """
    u, y = tuple(range(inputs)), tuple(range(inputs, inputs + outputs))
    groups = (HankelRows(u, past, given), HankelRows(u, 0, past), HankelRows(y, 0, seen), HankelRows(y, past, asked))
    all_inputs = inputs * (given + past)
    kept = tuple(group for group in groups if group.lags)
    return Blocks(kept, inputs * given, all_inputs, all_inputs + outputs * seen, outputs * asked, past)


Basis = tuple[FloatArray, FloatArray]  # (q p, r) columns in falling importance, and (r,) singular values


def orse(lower: FloatArray, rows: Blocks) -> Basis:
    """Future outputs less what future inputs explain (thesis, Eq. 2-21)."""
    return _left(lower[rows.known :, rows.given :])


def moesp(lower: FloatArray, rows: Blocks) -> Basis:
    """Of these what the past explains."""
    return _left(lower[rows.known :, rows.given : rows.known])


def n4sid(lower: FloatArray, rows: Blocks) -> Basis:
    """The oblique projection: what the past predicts, in the units of the outputs."""
    given, known = rows.given, rows.known
    past = lower[known:, given:known] @ _inverse(lower[given:known, given:known])
    return _left(past @ lower[given:known, :known])


def cva(lower: FloatArray, rows: Blocks) -> Basis:
    """Canonical correlations: as MOESP, with future outputs whitened."""
    root, sizes = orse(lower, rows)
    seen = sizes > _RANK * sizes[0]
    basis, values = _left(root[:, seen].T / sizes[seen, None] @ lower[rows.known :, rows.given : rows.known])
    return (root[:, seen] * sizes[seen]) @ basis, values


WEIGHTINGS: Mapping[Weighting, Callable[[FloatArray, Blocks], Basis]] = {
    "orse": orse,
    "n4sid": n4sid,
    "moesp": moesp,
    "cva": cva,
}


def predicted(lower: FloatArray, rows: Blocks, block: int, weighting: Weighting) -> Basis:
    """What the past predicts of `block` block rows, by the coefficients of an autoregression: for data of closed loops.

    The observability matrix found is the predictor's, of A - K C and C. Only "cva" weighs it: by the whitened error.
    """
    given, known, p, history = rows.given, rows.known, rows.outputs, rows.past
    coefficients = lower[known:, :known] @ _inverse(lower[:known, :known])
    m = (rows.inputs - given) // history
    of_inputs, of_outputs = coefficients[:, given : rows.inputs], coefficients[:, rows.inputs :]
    by_lag = np.concatenate([of_inputs.reshape(p, history, m), of_outputs.reshape(p, history, p)], axis=2)
    ahead = np.zeros((block, p, history, m + p))
    for i in range(block):
        ahead[i, :, i:] = by_lag[:, : history - i]
    map_ = np.concatenate([ahead[..., :m].reshape(block * p, -1), ahead[..., m:].reshape(block * p, -1)], axis=1)
    predicted = map_ @ lower[given:known, :known]
    if weighting != "cva":
        return _left(predicted)
    root, sizes = _left(lower[known:, known:])
    sizes = np.maximum(sizes, _RANK * sizes[0])
    whiten, colour = root.T / sizes[:, None], root * sizes
    basis, values = _left(np.kron(np.eye(block), whiten) @ predicted)
    return np.kron(np.eye(block), colour) @ basis, values


def _left(matrix: FloatArray) -> Basis:
    """Left singular vectors and singular values."""
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(left), np.asarray(values)


def _inverse(matrix: FloatArray) -> FloatArray:
    """The pseudo-inverse, directions at rounding level left out."""
    return np.asarray(np.linalg.pinv(matrix, rcond=_RANK))
