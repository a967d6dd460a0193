"""Integrals of a signal over time: exact ones of the line through its samples, or with `hold` of the steps.

So no figure changes when samples are added on the line (or the step), and stamps may be as uneven as they like.
Source: the criteria of Graham and Lathrop (1953), "The synthesis of 'optimum' transient response".
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.measures.samples import checked
from orchestrator.trace import FloatArray


def mean(time: ArrayLike, values: ArrayLike, hold: bool = False) -> float:
    """Mean over time [unit]; of a single sample its value.

    Raises:
        TraceError: as `checked`.
    """
    t, y = checked(time, values)
    return float(y[0]) if len(t) == 1 else _integral(t, y, np.ones_like(t), hold) / float(t[-1] - t[0])


def rms(time: ArrayLike, values: ArrayLike, hold: bool = False) -> float:
    """Root of the mean square over time [unit]; of a single sample its amount.

    Raises:
        TraceError: as `checked`.
    """
    t, y = checked(time, values)
    return abs(float(y[0])) if len(t) == 1 else float(np.sqrt(_integral(t, y, y, hold) / (t[-1] - t[0])))


def iae(time: ArrayLike, error: ArrayLike, hold: bool = False) -> float:
    """Integral of the absolute error [unit s].

    Raises:
        TraceError: as `checked`, or there are fewer than two samples; so with the others.
    """
    t, e = _absolute(time, error, hold)
    return _integral(t, e, np.ones_like(t), hold)


def ise(time: ArrayLike, error: ArrayLike, hold: bool = False) -> float:
    """Integral of the squared error [unit^2 s]."""
    t, e = checked(time, error, fewest=2)
    return _integral(t, e, e, hold)


def itae(time: ArrayLike, error: ArrayLike, hold: bool = False) -> float:
    """Integral of the absolute error weighted with the time since the first stamp [unit s^2]."""
    t, e = _absolute(time, error, hold)
    since = t - t[0]
    if hold:
        return float(np.sum(e[:-1] * np.diff(since**2)) / 2)
    return _integral(t, e, since, hold)


def effort(time: ArrayLike, values: ArrayLike, hold: bool = True) -> float:
    """Integral of the squared control signal [unit^2 s], which a sampled controller holds between its samples."""
    return ise(time, values, hold)


def _absolute(time: ArrayLike, error: ArrayLike, hold: bool) -> tuple[FloatArray, FloatArray]:
    """Stamps and amounts of the error; where its line changes sign, a sample of 0 between."""
    t, e = checked(time, error, fewest=2)
    if hold:
        return t, np.abs(e)
    rows = np.flatnonzero(e[:-1] * np.sign(e[1:]) < 0)
    zeros = t[rows] + np.diff(t)[rows] * (e[rows] / (e[rows] - e[rows + 1]))
    return np.insert(t, rows + 1, zeros), np.abs(np.insert(e, rows + 1, 0.0))


def _integral(t: FloatArray, a: FloatArray, b: FloatArray, hold: bool) -> float:
    """Integral of a b over t: of the product of two lines, or of two steps."""
    h = np.diff(t)
    if hold:
        return float(np.sum(h * a[:-1] * b[:-1]))
    return float(np.sum(h * (2 * a[:-1] * b[:-1] + 2 * a[1:] * b[1:] + a[:-1] * b[1:] + a[1:] * b[:-1])) / 6)
