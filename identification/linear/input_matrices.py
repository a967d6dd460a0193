"""B, D and the initial states of a model whose A and C are known: a linear least-squares problem.

    y[k] = C A^k x0 + sum over j < k of C A^(k-1-j) B u[j] + D u[k]

Every response the unknowns weigh is simulated in the transposed system, one run for a pair of output and input,
instead of one for each element of B. Records are taken in chunk by chunk, and each record's initial state is
eliminated with it, so that neither long nor many records need much memory.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.linear.hankel import absorbed
from identification.linear.recursion import recursion
from orchestrator.trace import BoolArray, FloatArray

_CHUNK = 1024
_GROWTH = 1e6  # an unstable model is fitted over stretches in which it grows no more than this
_NEGLIGIBLE = 1e-12
_OVERFLOW = 1e100  # squares of what is beyond cannot be added up


@dataclass(frozen=True, eq=False)
class InputFit:
    """b : (n, m), d : (p, m), and starts : (R, n), the state before the first sample of every record."""

    b: FloatArray
    d: FloatArray
    starts: FloatArray


@single_threaded
def fit_inputs(
    a: FloatArray,
    c: FloatArray,
    records: Sequence[tuple[FloatArray, FloatArray]],
    feedthrough: BoolArray,
    *,
    starts: bool = True,
) -> InputFit:
    """Least-squares B, D and initial states over all records.

    Args:
        a, c: (n, n) and (p, n).
        records: (u, y), (K, m) and (K, p).
        feedthrough: (p, m), where D may differ from 0.
        starts: estimate the initial states, instead of starting each record at 0.

    A record in which an unstable A would grow beyond reason is fitted in stretches, each from a state of its own.

    Raises:
        IdentificationError: A is so unstable that a record started at 0 overflows.

    Source: the flexible-manipulator thesis, Eqs. 2-13 to 2-17, with initial states.
    """
    local, shared = a.shape[0] * starts, a.shape[0] * feedthrough.shape[1] + int(feedthrough.sum())
    total, heads = np.zeros((0, shared + 1)), []
    for u, y in records:
        length = _stretch(a) if starts else len(u)
        for begin in range(0, len(u), length):
            triangle = np.zeros((0, local + shared + 1))
            for rows in _rows(a, c, u[begin : begin + length], y[begin : begin + length], feedthrough):
                triangle = absorbed(triangle, rows[:, a.shape[0] - local :])
            total = absorbed(total, triangle[local:, local:])
            if begin == 0:
                heads.append(triangle[:local])
    solution = least_squares(total[:, :-1], total[:, -1])
    split = a.shape[0] * feedthrough.shape[1]
    d = np.zeros(feedthrough.shape)
    d[feedthrough] = solution[split:]
    found = [least_squares(head[:, :local], head[:, -1] - head[:, local:-1] @ solution) for head in heads]
    return InputFit(
        solution[:split].reshape(feedthrough.shape[1], a.shape[0]).T,
        d,
        np.array(found) if starts else np.zeros((len(records), a.shape[0])),
    )


def least_squares(columns: FloatArray, target: FloatArray) -> FloatArray:
    """The shortest solution with columns scaled to length 1, directions without effect left out."""
    lengths = np.linalg.norm(columns, axis=0)
    lengths = np.where(lengths > 0, lengths, 1.0)
    return np.asarray(np.linalg.lstsq(columns / lengths, target, rcond=_NEGLIGIBLE)[0] / lengths)


def _stretch(a: FloatArray) -> int:
    """Samples after which A has grown by `_GROWTH`."""
    radius = float(np.abs(np.linalg.eigvals(a)).max(initial=0.0))
    longest = np.iinfo(np.int64).max
    return longest if radius <= 1 else max(4 * len(a), int(min(np.log(_GROWTH) / np.log(radius), longest / 2)))


def _rows(a: FloatArray, c: FloatArray, u: FloatArray, y: FloatArray, feedthrough: BoolArray) -> Iterator[FloatArray]:
    """Rows (p K', n + n m + d + 1) of [x0, B input by input, D, y] for chunks of a record, instant by instant."""
    (outputs, order), inputs = c.shape, u.shape[1]
    state = np.concatenate([np.zeros((outputs * inputs, order)), c])
    for begin in range(0, len(u), _CHUNK):
        part, target = u[begin : begin + _CHUNK], y[begin : begin + _CHUNK]
        force = np.zeros((len(part), len(state), order))
        force[:, : outputs * inputs] = np.einsum("pn,km->kpmn", c, part).reshape(len(part), -1, order)
        x, state = recursion(a.T, force, state)
        if not np.abs(state).max(initial=0.0) < _OVERFLOW:
            raise IdentificationError(
                "model",
                f"of order {order} is unstable and overflows within a record",
                "estimate initial states, or ask for stable poles",
            )
        rows = [
            x[:, outputs * inputs :],
            x[:, : outputs * inputs].reshape(len(part), outputs, inputs * order),
            _direct(part, feedthrough),
            target[:, :, None],
        ]
        yield np.concatenate(rows, axis=2).reshape(len(part) * outputs, -1)


def _direct(u: FloatArray, feedthrough: BoolArray) -> FloatArray:
    """(K, p, d) what each element of D sees."""
    where, which = np.nonzero(feedthrough)
    columns = np.zeros((len(u), len(feedthrough), len(where)))
    columns[:, where, np.arange(len(where))] = u[:, which]
    return columns
