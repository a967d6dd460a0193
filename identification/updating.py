"""After modes were left out: the remaining model's B or C computed anew, by least squares.

The flexible-manipulator thesis, Section 3.1: A and one of the two stay, so that the problem is linear and has one
answer, unlike a search over all elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear_model import LinearModel
from identification.modes import from_modes, modes
from identification.records import Record
from orchestrator.trace import FloatArray


def reduced(model: LinearModel, kept: Sequence[int]) -> LinearModel:
    """The model with only these of its modes (numbers as in `modes`), in real form (3-9, 3-10)."""
    found = modes(model)
    if not kept:
        raise IdentificationError("reduction", "no mode is kept", "keep at least one")
    return from_modes([found[i] for i in kept], model)


def updated_output(model: LinearModel, records: Sequence[Record]) -> LinearModel:
    """C by least squares of the outputs on the states from rest; A, B and D stay (3-20).

    Raises:
        IdentificationError: the states do not move independently under these inputs.
    """
    states = np.concatenate([model.states(record.u) for record in records])
    measured = np.concatenate([record.y - record.u @ model.d.T for record in records])
    return replace(model, c=_solved(states, measured, "C").T)


def updated_input(model: LinearModel, records: Sequence[Record], scale: FloatArray | None = None) -> LinearModel:
    """B by least squares of the outputs from rest; A, C and D stay (3-17).

    Args:
        scale: (p,) size of each output, by which its errors are divided; the rms of the records by default. As
            published, the outputs count as they are: give ones.

    Raises:
        IdentificationError: the outputs do not tell the elements of B apart.
    """
    measured = [record.y - record.u @ model.d.T for record in records]
    sizes = np.sqrt(np.mean(np.concatenate(measured) ** 2, axis=0)) if scale is None else scale
    rows = [_by_input(model, record.u) for record in records]
    outputs = range(len(model.outputs))
    regressors = np.concatenate([row[output] / sizes[output] for row in rows for output in outputs])
    targets = np.concatenate([y[:, output] / sizes[output] for y in measured for output in outputs])
    solved = _solved(regressors, targets[:, None], "B")
    return replace(model, b=solved.reshape(len(model.inputs), model.order).T)


def _by_input(model: LinearModel, u: FloatArray) -> FloatArray:
    """(p, K, m n) what each element of B gives to each output (3-14): the states of the transposed system."""
    dual = [
        replace(model, a=model.a.T.copy(), b=row[:, None], c=np.eye(model.order), d=np.zeros((model.order, 1)),
                inputs=("u",), outputs=tuple(f"x{i}" for i in range(model.order)))
        for row in model.c
    ]  # fmt: skip
    return np.stack([np.hstack([each.states(column[:, None]) for column in u.T]) for each in dual])


def _solved(regressors: FloatArray, targets: FloatArray, what: str) -> FloatArray:
    solution, _, rank, _ = np.linalg.lstsq(regressors, targets, rcond=None)
    if rank < regressors.shape[1]:
        raise IdentificationError(f"update of {what}", f"the data tell {rank} of {regressors.shape[1]} elements apart",
                                  "keep fewer modes, or use richer records")  # fmt: skip
    return np.asarray(solution, dtype=float)
