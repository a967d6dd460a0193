"""Modes left out: what that does, as a bound before and measured after, and B or C computed anew by least squares.

The flexible-manipulator thesis, Section 3.1: A and one of the two stay, so that the problem is linear and has one
answer, unlike a search over all elements.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.input_matrices import fit_inputs
from identification.linear.model import LinearModel
from identification.linear.modes import Mode, dropping_bound, from_modes, labels, modes
from identification.linear.records import InputOutputData
from orchestrator.trace import FloatArray

UpdatedMatrix = Literal["input", "output", "none"]
_UNMOVED = 1e-9  # of the mode that inputs move most


def reduced(model: LinearModel, kept: Sequence[int]) -> LinearModel:
    """The model with only these of its modes (numbers as in `modes`), in real form (3-9, 3-10)."""
    found = modes(model)
    if not kept:
        raise IdentificationError("reduction", "no mode is kept", "keep at least one")
    return from_modes([found[i] for i in kept], model)


def without_constants(model: LinearModel, inputs: Sequence[FloatArray]) -> LinearModel:
    """The model without the states that only add a constant: eigenvalue 1, moved by no input, each (K, m), to rounding.

    Such a state stands for an offset of the outputs. Which side of 1 its eigenvalue comes to lie on is rounding alone.
    """
    try:
        found = modes(model)
    except IdentificationError:  # two equal eigenvalues without modal coordinates are no constant
        return model
    moved = np.array([max(mode.response_magnitude(u) for u in inputs) for mode in found])
    kept = [i for i, mode in enumerate(found) if not mode.integrating or moved[i] > _UNMOVED * moved.max()]
    return reduced(model, kept) if kept and len(kept) < len(found) else model


def updated(model: LinearModel, records: Sequence[InputOutputData], matrix: UpdatedMatrix) -> LinearModel:
    """The model with B ("input") or C ("output") computed anew from these records, or as it is ("none")."""
    if matrix == "none":
        return model
    return updated_input(model, records) if matrix == "input" else updated_output(model, records)


def updated_output(model: LinearModel, records: Sequence[InputOutputData]) -> LinearModel:
    """C by least squares of the outputs on the states from rest; A, B and D stay (3-20).

    Raises:
        IdentificationError: the states do not move independently under these inputs.
    """
    states = np.concatenate([model.states(record.u) for record in records])
    measured = np.concatenate([record.y - record.u @ model.d.T for record in records])
    solution, _, rank, _ = np.linalg.lstsq(states, measured, rcond=None)
    if rank < model.order:
        raise IdentificationError(
            "update of C",
            f"the records move {rank} of {model.order} states independently",
            "keep fewer modes, or use richer records",
        )
    return replace(model, c=np.asarray(solution.T, dtype=float))


def updated_input(
    model: LinearModel, records: Sequence[InputOutputData], scale: FloatArray | None = None
) -> LinearModel:
    """B by least squares of the outputs from rest; A, C and D stay (3-17).

    Args:
        scale: (p,) size of each output, by which its errors are divided; the rms of the records by default. As
            published, the outputs count as they are: give ones.
    """
    measured = [record.y - record.u @ model.d.T for record in records]
    sizes = np.sqrt(np.mean(np.concatenate(measured) ** 2, axis=0)) if scale is None else scale
    data = [(record.u, y / sizes) for record, y in zip(records, measured, strict=True)]
    fixed = np.zeros(model.d.shape, dtype=bool)
    return replace(model, b=fit_inputs(model.a, model.c / sizes[:, None], data, fixed, starts=False).b)


@dataclass(frozen=True)
class DroppedMode:
    """What leaving out one mode alone does, over the greatest mean magnitude of an output's response.

    Attributes:
        bound: on the mean absolute error of any output: its MRM.
        measured: the largest of an output, by the free run without it.
    """

    label: str
    bound: float
    measured: float


@dataclass(frozen=True)
class Reduction:
    """What leaving out several modes does, before B or C are computed anew; as of one mode.

    Attributes:
        dropped: labels of the modes that are left out.
    """

    dropped: tuple[str, ...]
    bound: float
    measured: float

    def __str__(self) -> str:
        error = f"{100 * self.measured:.2g} %, at most {100 * self.bound:.2g} % by the sum of their MRMs"
        return f"without modes {', '.join(self.dropped) or 'none'} the mean absolute error is {error}"


def one_by_one(model: LinearModel, u: FloatArray) -> list[DroppedMode]:
    """What leaving out each of the modes does under u (K, m), from rest."""
    found = modes(model)
    every = range(len(found))
    return [DroppedMode(labels(found)[i], *_errors(model, found, [j for j in every if j != i], u)) for i in every]


def together(model: LinearModel, kept: Sequence[int], u: FloatArray) -> Reduction:
    """What leaving out all modes but these does under u (K, m), from rest."""
    found = modes(model)
    dropped = tuple(label for i, label in enumerate(labels(found)) if i not in set(kept))
    return Reduction(dropped, *_errors(model, found, kept, u))


def _errors(model: LinearModel, found: Sequence[Mode], kept: Sequence[int], u: FloatArray) -> tuple[float, float]:
    """The bound and the measured error, over the size of the response."""
    whole = model.simulate(u)
    left = from_modes([found[i] for i in kept], model).simulate(u) if kept else u @ model.d.T
    with np.errstate(over="ignore", invalid="ignore"):
        size, error = (float(np.abs(y).mean(axis=0).max()) for y in (whole, whole - left))
    size = size if size > 0 else 1.0
    return dropping_bound(found, kept, u) / size, error / size
