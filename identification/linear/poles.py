"""Poles put where a model is known to have them: inside the unit circle, or one of them on 1."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.linalg import eig

from fmus.errors import IdentificationError
from identification.linear.model import UNIT_CIRCLE, LinearModel
from orchestrator.trace import ComplexArray, FloatArray

Poles = Literal["free", "stable", "integrating"]
LARGEST = 0.9999  # modulus of a pole that was moved inside; the manipulator thesis, Section 3.5, does the same
_SHARED = 1e-12  # overlap of a pole's left and right eigenvector below which another pole shares it


@dataclass(frozen=True)
class PoleMove:
    """One pole, or one of a pair, put elsewhere in the z-plane."""

    before: complex
    after: complex


def constrained(a: FloatArray, poles: Poles) -> tuple[FloatArray, tuple[PoleMove, ...]]:
    """A (n, n) with its poles where they belong, and which were moved; all eigenvectors stay.

    Poles on or outside the unit circle are reflected inside, to a modulus of at most `LARGEST`. An integrating model
    has its real pole nearest to 1 there, however far it was: look at the moves.

    Raises:
        IdentificationError: an integrating model has no real pole.
    """
    if poles == "free" or not len(a):
        return a, ()
    return _placed(a, lambda values: _wanted(values, poles))


def stabilised(model: LinearModel) -> LinearModel:
    """The model with every pole outside the unit circle moved to a modulus of `LARGEST`, its angle kept.

    A pole on the circle to rounding, an integrator, stays; so does a stable model, bit for bit. The response changes:
    update C or B afterwards.

    Raises:
        IdentificationError: two unstable poles share an eigenvector.

    Source: the flexible-manipulator thesis, Section 3.5.
    """
    if model.stable:
        return model

    def inside(values: ComplexArray) -> ComplexArray:
        modulus = np.abs(values)
        return np.where(modulus > UNIT_CIRCLE, values * LARGEST / np.maximum(modulus, LARGEST), values)

    return replace(model, a=_placed(model.a, inside)[0])


def _placed(
    a: FloatArray, wanted_of: Callable[[ComplexArray], ComplexArray]
) -> tuple[FloatArray, tuple[PoleMove, ...]]:
    """A (n, n) with some poles elsewhere and all eigenvectors as they were, and which were moved.

    Only the eigenvectors of the poles that move enter, not the whole modal basis, whose condition may be bad.
    """
    values, left, right = eig(a, left=True, right=True)
    wanted = wanted_of(values)
    moving = np.flatnonzero(wanted != values)
    overlaps = np.sum(left[:, moving].conj() * right[:, moving], axis=0)
    if np.abs(overlaps).min(initial=1.0) < _SHARED:
        raise IdentificationError("model", "two poles to be moved have one eigenvector", "choose another order")
    change = (right[:, moving] / overlaps * (wanted - values)[moving]) @ left[:, moving].conj().T
    return a + change.real, _moves(values, wanted)


def injecting(a: FloatArray, c: FloatArray, poles: Poles) -> tuple[FloatArray, tuple[PoleMove, ...]]:
    """The gain G (n, p) with which A + G C has its poles where they belong, as `constrained`, and which were moved.

    A predictor A - K C stays what it is when G is added to K as well.

    Args:
        c: (p, n).
    """
    gain = np.zeros(c.T.shape)
    if poles == "free" or not len(a):
        return gain, ()
    values = np.linalg.eigvals(a).astype(complex)
    moves = _moves(values, _wanted(values, poles))
    for move in moves:
        if move.before.imag >= 0:
            gain += _moving(a + gain @ c, c, move)
    return gain, moves


def _moving(a: FloatArray, c: FloatArray, move: PoleMove) -> FloatArray:
    """The gain (n, p) that moves one pole, or a pair, and no other."""
    values, right = np.linalg.eig(a)
    v = right[:, np.argmin(np.abs(values - move.before))]
    paired = move.before.imag != 0
    shape = np.linalg.qr(np.column_stack([v.real, v.imag] if paired else [v.real]))[0]
    aims = [move.after, move.after.conjugate()] if paired else [move.after]
    from scipy.signal import place_poles  # noqa: PLC0415 - loads slowly

    return np.asarray(-shape @ place_poles((shape.T @ a @ shape).T, (c @ shape).T, aims).gain_matrix.T)


def _wanted(values: ComplexArray, poles: Poles) -> ComplexArray:
    """Where the poles (n,) belong."""
    wanted = np.where(np.abs(values) >= 1, _inside(values), values)
    if poles == "integrating":
        wanted[integrator(values)] = 1.0
    return wanted


def _moves(values: ComplexArray, wanted: ComplexArray) -> tuple[PoleMove, ...]:
    return tuple(PoleMove(complex(values[i]), complex(wanted[i])) for i in np.flatnonzero(wanted != values))


def integrator(values: ComplexArray) -> int:
    """Which of the poles (n,) is the real one nearest to 1."""
    real = np.flatnonzero(values.imag == 0)
    if not len(real):
        raise IdentificationError(
            "model", f"of order {len(values)} has no real pole to put on 1", "choose another order"
        )
    return int(real[np.argmin(np.abs(values[real] - 1))])


def _inside(values: ComplexArray) -> ComplexArray:
    modulus = np.maximum(np.abs(values), 1e-300)
    return np.asarray(values / modulus * np.minimum(1 / modulus, LARGEST))
