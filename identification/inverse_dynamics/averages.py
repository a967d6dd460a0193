"""What an axis does on the mean about each sample, from samples of its position.

A mean is weighed by a hat, 1 at the sample and 0 at those beside it. Of a force that holds from sample to sample it is
that of the step before and the step after, and of the acceleration the second difference: both exactly, however coarse
the samples are and whatever the axis does between them.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import convolve1d

from identification.inverse_dynamics.terms import AxisMotion
from orchestrator.trace import FloatArray

# Series by even differences, of what is smooth; what they leave is below 0.3 % at a fifth of the sampling rate.
_HAT = (1, 1 / 12, -1 / 240, 31 / 60480)  # from values to their means
_HAT_SLOPE = (1, -1 / 12, 11 / 720, -191 / 60480)  # from central differences to means of the derivative
_SLOPE = (1, -1 / 6, 1 / 30, -1 / 140)  # from central differences to the derivative


def averaged_motion(position: FloatArray, smooth: FloatArray, step: float) -> AxisMotion:
    """The means of a motion.

    Args:
        position: (K,) samples, `step` [s] apart.
        smooth: (K,) the same, of which the speed has the sign that friction goes by.
    """
    rates = np.gradient(position, step)
    return AxisMotion(
        _series(position, _HAT), _series(rates, _HAT_SLOPE), _bent(position) / step**2, _ahead(speed(smooth, step))
    )


def half_width(corner: float) -> float:
    """How far a low-pass of this corner [Hz] sees to either side, exactly [s]."""
    return 0.5 / corner


def smoothed(values: FloatArray, step: float, corner: float) -> FloatArray:
    """`values` (K,) or (K, n), `step` [s] apart, through a Hann window: half of what is at `corner` [Hz] passes.

    No phase is shifted, and nothing comes from farther than `half_width`; the ends last.
    """
    reach = half_width(corner) / step
    beside = np.arange(-math.ceil(reach) + 1, math.ceil(reach))
    window = np.cos(0.5 * np.pi * beside / reach) ** 2
    return np.asarray(convolve1d(values, window / window.sum(), axis=0, mode="nearest"))


def speed(position: FloatArray, step: float) -> FloatArray:
    """(K,) derivative at the samples of a smooth position (K,), `step` [s] apart."""
    return _series(np.gradient(position, step), _SLOPE)


def _series(values: FloatArray, weights: Sequence[float]) -> FloatArray:
    """(K,) the sum of even differences by these weights."""
    total, difference = np.zeros_like(values), values
    for weight in weights:
        total += weight * difference
        difference = _bent(difference)
    return total


def _bent(values: FloatArray) -> FloatArray:
    """(K,) second differences, 0 at the ends."""
    return np.pad(np.diff(values, 2), 1)


def _ahead(speed: FloatArray) -> FloatArray:
    """(K,) the share of each mean in which a speed (K,), along lines between samples, is positive; half of rest."""
    after, before = np.append(speed[1:], speed[-1]), np.append(speed[:1], speed[:-1])
    return _half_ahead(speed, after) + _half_ahead(speed, before)


def _half_ahead(here: FloatArray, there: FloatArray) -> FloatArray:
    """(K,) the share on one side of the samples, half at most."""
    change = here - there
    crossing = np.clip(np.divide(here, change, out=np.ones_like(here), where=here * there < 0), 0.0, 1.0)
    near = crossing - crossing**2 / 2
    turned = np.where(here > 0, near, 0.5 - near)
    sign = np.sign(here) + np.sign(there)
    return np.where(here * there < 0, turned, 0.25 * (1 + np.clip(sign, -1, 1)))
