"""The pendulum thesis' estimate of a resonance from its two largest gains, as its scripts have it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import IdentificationError
from orchestrator.trace import FloatArray

GRAVITY = 9.81  # [m/s^2], the value of the thesis


def decibel(gain: ArrayLike) -> FloatArray:
    """20 log10 of `gain`, the form in which the thesis' scripts hand amplitudes to Eq. 100."""
    return np.asarray(20 * np.log10(np.asarray(gain, dtype=float)))


def resonance_from_two_largest_as_published(frequency: ArrayLike, amplitude: ArrayLike) -> float:
    """Eq. 100 as published [rad/s], a weighted mean of two squared frequencies.

    Its weights sqrt(g^2 + A), with A the largest amplitude squared, have a sign error (Eq. 95 requires sqrt(A - g^2)),
    so it stays near the mid-point; a fit of log|G| (`log_gain`) is the method to use.

    Args:
        frequency: (K,) [rad/s].
        amplitude: (K,) gains, or, to reproduce Tables 1 and 4, gains in dB (`decibel`): the scripts feed dB.

    Raises:
        IdentificationError: fewer than two finite amplitudes, or not as many frequencies.
    """
    x, g = np.asarray(frequency, dtype=float) ** 2, np.asarray(amplitude, dtype=float)
    if x.shape != g.shape or len(x) < 2 or not (np.all(np.isfinite(x)) and np.all(np.isfinite(g))):
        raise IdentificationError(
            "resonance", f"needs 2 finite gains and as many frequencies, got {g.shape} and {x.shape}"
        )
    first, second = np.argsort(-g, kind="stable")[:2]
    alpha, beta = np.sqrt(g[second] ** 2 + g[first] ** 2), np.sqrt(2 * g[first] ** 2)
    return float(np.sqrt((alpha * x[first] + beta * x[second]) / (alpha + beta)))
