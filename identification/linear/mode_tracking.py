"""Modes followed over models of rising order, and how sure their frequencies and dampings are.

A mode of the system comes back at every order in nearly the same place; one that only fits noise wanders.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.linear.model import LinearModel
from identification.linear.modes import Mode, modes
from orchestrator.trace import ComplexArray, FloatArray

_FREQUENCY, _DAMPING = 0.01, 0.05  # relative changes from one order to the next up to which a mode is the same
_SHAPE = 0.98  # least agreement of its output shapes


@dataclass(frozen=True)
class Sighting:
    """A mode at one order.

    Attributes:
        in_frequency, in_damping, in_shape: whether some mode of the order before was there, and agreed in that, too.
    """

    order: int
    mode: Mode
    in_frequency: bool
    in_damping: bool
    in_shape: bool

    @property
    def stable(self) -> bool:
        """Whether it agrees in all three with the order before."""
        return self.in_frequency and self.in_damping and self.in_shape


def shape_agreement(first: Mode, second: Mode) -> float:
    """Modal assurance criterion of two output shapes: 1 for parallel ones, 0 for orthogonal ones."""
    product = abs(np.vdot(first.c, second.c)) ** 2
    size = float(np.vdot(first.c, first.c).real * np.vdot(second.c, second.c).real)
    return float(product / size) if size > 0 else 0.0


def stabilisation(models: Sequence[LinearModel]) -> list[Sighting]:
    """The points of a stabilisation diagram: the pairs of every model, judged against the model before."""
    sightings: list[Sighting] = []
    before: list[Mode] = []
    for model in sorted(models, key=lambda model: model.order):
        pairs = [mode for mode in modes(model) if mode.paired]
        sightings += [_sighted(model.order, mode, before) for mode in pairs]
        before = pairs
    return sightings


def _sighted(order: int, mode: Mode, before: Sequence[Mode]) -> Sighting:
    near = [other for other in before if abs(other.frequency - mode.frequency) <= _FREQUENCY * mode.frequency]
    if not near:
        return Sighting(order, mode, False, False, False)
    closest = max(near, key=lambda other: shape_agreement(other, mode))
    in_damping = abs(closest.damping - mode.damping) <= _DAMPING * abs(mode.damping)
    return Sighting(order, mode, True, in_damping, shape_agreement(closest, mode) >= _SHAPE)


@dataclass(frozen=True)
class ModeSpread:
    """Standard deviations of a mode's natural frequency [Hz] and damping ratio."""

    frequency: float
    damping: float


def spreads(model: LinearModel, sensitivity: FloatArray, covariance: FloatArray) -> list[ModeSpread]:
    """One for each of `modes(model)`, to first order.

    Args:
        sensitivity: (P, n, n) derivative of A by each of P parameters.
        covariance: (P, P) of the parameters.

    An eigenvalue moves by w^H dA v / w^H v with its left and right eigenvectors; frequency and damping follow from it
    by (2-28). Modes without a frequency have nan.
    """
    values, vectors = np.linalg.eig(model.a)
    inverse = np.linalg.inv(vectors)
    found = []
    for mode in modes(model):
        i = int(np.argmin(abs(values - mode.eigenvalue)))
        slope = np.einsum("j,pjk,k->p", inverse[i], sensitivity, vectors[:, i])
        found.append(_spread(mode, slope, covariance))
    return found


def _spread(mode: Mode, slope: ComplexArray, covariance: FloatArray) -> ModeSpread:
    """From the slope (P,) of the eigenvalue."""
    if not mode.frequency > 0:
        return ModeSpread(float("nan"), float("nan"))
    pole = mode.pole
    moved = slope / (mode.eigenvalue * mode.step)
    size = abs(pole)
    by_size = (pole.real * moved.real + pole.imag * moved.imag) / size
    by_damping = -moved.real / size + pole.real * by_size / size**2
    with np.errstate(invalid="ignore"):  # what is not determined is nan in the covariance, and stays so
        variances = by_size @ covariance @ by_size, by_damping @ covariance @ by_damping
        return ModeSpread(float(np.sqrt(variances[0]) / (2 * np.pi)), float(np.sqrt(variances[1])))
