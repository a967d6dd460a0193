"""Where a lightly damped second-order system resonates: from its parameters, or a few points of its gain.

The pendulum thesis' statistics (Eqs. 89, 90, 100) are given as published and corrected. All but the largest
amplitude enter them through a Taylor expansion, so `resonance_of_inverse_parabola` or, with more points, a
fit of log|G| (`identification.log_gain`) is the method to use.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmus.errors import IdentificationError

FloatArray = NDArray[np.float64]

GRAVITY = 9.81  # [m/s^2], the value of the thesis


def resonance_frequency(
    p1: ArrayLike,
    p2: ArrayLike,
    p3: ArrayLike,
    added_mass: ArrayLike = 0.0,
    added_length: ArrayLike = 0.0,
    *,
    gravity: float = GRAVITY,
) -> FloatArray:
    """Frequency of the largest gain of p1 a + p2 w + p3 q = p4 v with an added mass [rad/s] (Eqs. 77 and 79).

    0 where the damping leaves no resonance (Lemma 6). Arguments broadcast.

    Args:
        p1: moment of inertia [kg m^2].
        p2: viscous friction [N m s/rad].
        p3: gravity torque [N m].
        added_mass: [kg], at the distance `added_length` [m] from the axis.
        gravity: [m/s^2].
    """
    mass, length = np.asarray(added_mass, dtype=float), np.asarray(added_length, dtype=float)
    inertia = p1 + mass * length**2
    squared = (p3 + mass * gravity * length) / inertia - (np.asarray(p2) / inertia) ** 2 / 2
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def decibel(gain: ArrayLike) -> FloatArray:
    """20 log10 of `gain`, the form in which the thesis' scripts hand amplitudes to Eq. 100."""
    return np.asarray(20 * np.log10(np.asarray(gain, dtype=float)))


@dataclass(frozen=True)
class PeakShape:
    """|G|^2 near its peak, height - curvature (w^2 - w_opt^2)^2: A and B of Eq. 91.

    Attributes:
        height: |G|^2 at the peak, A.
        curvature: B [1 / (rad/s)^4 times the unit of `height`].
    """

    height: float
    curvature: float


def peak_shape(a0: float, a1: float, b0: float) -> PeakShape:
    """A and B of G = b0 / (s^2 + a1 s + a0), corrected: |G|^2 has b0^2, not b0, in its numerator."""
    inverse = a1**2 * (a0 - a1**2 / 4)
    return PeakShape(b0**2 / inverse, b0**2 / inverse**2)


def peak_shape_as_published(a0: float, a1: float, b0: float) -> PeakShape:
    """A and B as Eq. 91 prints them, with b0 in place of b0^2: right only for b0 = 1."""
    inverse = a1**2 * (a0 - a1**2 / 4)
    return PeakShape(b0 / inverse, b0 / inverse**2)


def resonance_from_curvature(frequency: ArrayLike, gain: ArrayLike, shape: PeakShape) -> float:
    """Eq. 89 from the two largest of `gain` (K,) at `frequency` (K,) [rad/s]: exact for a parabola in w^2.

    The formula is right as published; pass `peak_shape` for the corrected B, `peak_shape_as_published` for
    the printed one.
    """
    (x1, x2), (g1, g2) = _two_largest(frequency, gain)
    _distinct([x1, x2])
    return _root((x1 + x2) / 2 + (g1**2 - g2**2) / (x1 - x2) / (2 * shape.curvature))


def resonance_from_height(frequency: ArrayLike, gain: ArrayLike, shape: PeakShape) -> float:
    """Eq. 90 corrected [rad/s]: weights sqrt(A - g^2), as Eq. 95 requires; exact for a parabola in w^2.

    The resonance must lie between the frequencies of the two largest gains (Lemma 7).

    Raises:
        IdentificationError: a gain is above the peak, or both are at it.
    """
    (x1, x2), (g1, g2) = _two_largest(frequency, gain)
    if g1**2 > shape.height * (1 + 1e-12) or g2**2 >= shape.height:
        raise IdentificationError(
            "Eq. 90", f"gains {g1:g} and {g2:g} are not below the peak {shape.height**0.5:g}", "check A"
        )
    alpha, beta = np.sqrt(shape.height - g2**2), np.sqrt(max(shape.height - g1**2, 0.0))
    return _root((alpha * x1 + beta * x2) / (alpha + beta))


def resonance_from_height_as_published(frequency: ArrayLike, gain: ArrayLike, shape: PeakShape) -> float:
    """Eq. 90 as published [rad/s]: weights sqrt(g^2 + A), a sign error, so it stays near the mid-point."""
    (x1, x2), (g1, g2) = _two_largest(frequency, gain)
    alpha, beta = np.sqrt(g2**2 + shape.height), np.sqrt(g1**2 + shape.height)
    return _root((alpha * x1 + beta * x2) / (alpha + beta))


def resonance_from_two_largest_as_published(frequency: ArrayLike, amplitude: ArrayLike) -> float:
    """Eq. 100 as published [rad/s]: Eq. 90 as published with A replaced by the largest amplitude squared.

    Args:
        frequency: (K,) [rad/s].
        amplitude: (K,) gains, or, to reproduce Tables 1 and 4, gains in dB (`decibel`): the scripts feed dB.
    """
    (_, _), (g1, _) = _two_largest(frequency, amplitude)
    return resonance_from_height_as_published(frequency, amplitude, PeakShape(g1**2, np.nan))


def resonance_at_largest(frequency: ArrayLike, gain: ArrayLike) -> float:
    """Eq. 100 corrected [rad/s]: with sqrt(A - g^2) and A the largest g^2, only its frequency is left.

    So Theorem 2's idea gives no more than the frequency of the largest gain; no better than the spacing.
    """
    (x1, _), _ = _two_largest(frequency, gain)
    return float(np.sqrt(x1))


def resonance_of_inverse_parabola(frequency: ArrayLike, gain: ArrayLike) -> float:
    """Resonance [rad/s] from the three largest of `gain` (K,) at `frequency` (K,) [rad/s] alone.

    1 / |G|^2 of a second-order system is exactly a parabola in w^2, so three points give its vertex without
    any expansion; this is what Theorem 2 was after.

    Raises:
        IdentificationError: fewer than three frequencies, or the three points show no peak.
    """
    x, g = _columns(frequency, gain, 3)
    top = np.argsort(-g, kind="stable")[:3]
    _distinct(x[top])
    (x1, x2, x3), (f1, f2, f3) = x[top], 1 / g[top] ** 2
    slope21, slope31 = (f2 - f1) / (x2 - x1), (f3 - f1) / (x3 - x1)
    bend = (slope31 - slope21) / (x3 - x2)
    if bend <= 0:
        raise IdentificationError(
            "resonance", "the three largest gains show no peak", "add frequencies around the peak"
        )
    return _root((x1 + x2 - slope21 / bend) / 2)


def _two_largest(frequency: ArrayLike, gain: ArrayLike) -> tuple[tuple[float, float], tuple[float, float]]:
    """Squared frequencies and gains of the largest and the second largest gain."""
    x, g = _columns(frequency, gain, 2)
    first, second = np.argsort(-g, kind="stable")[:2]
    return (float(x[first]), float(x[second])), (float(g[first]), float(g[second]))


def _columns(frequency: ArrayLike, gain: ArrayLike, least: int) -> tuple[FloatArray, FloatArray]:
    x, g = np.asarray(frequency, dtype=float) ** 2, np.asarray(gain, dtype=float)
    if x.shape != g.shape or len(x) < least or not (np.all(np.isfinite(x)) and np.all(np.isfinite(g))):
        raise IdentificationError(
            "resonance", f"needs {least} finite gains and as many frequencies, got {g.shape} and {x.shape}"
        )
    return x, g


def _distinct(x: ArrayLike) -> None:
    if len(np.unique(x)) < len(np.asarray(x)):
        raise IdentificationError(
            "resonance", "two of the largest gains share one frequency", "average repeated experiments"
        )


def _root(squared: float) -> float:
    if squared <= 0:
        raise IdentificationError(
            "resonance", f"the estimate of w_opt^2 is {squared:g}", "add frequencies around the peak"
        )
    return float(np.sqrt(squared))
