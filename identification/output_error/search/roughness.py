"""The noise that simulations have of themselves (of a solver's tolerance, of few digits), and the difference steps that
it asks for.

Along each parameter a short row of runs is differenced again and again: what is smooth is gone from high differences,
and noise is left. The step balances it against the curvature, which two runs farther off show.

Source: Moré and Wild 2011 (noise by a table of differences), 2012 (steps of differences).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Point
from identification.output_error.search.free_run import FreeRun
from identification.output_error.search.steps import inside, moved, size
from orchestrator.trace import FloatArray

_ROW, _APART = 6, 1e-3  # runs beside the first, and how far apart, of a scaled parameter
_LOWEST = 4  # order of differences from which on nothing smooth is left
_AFAR = 0.03  # of a scaled parameter, where curvature is seen
_COARSEST = 0.1
_EVEN = 0.3  # of the largest of second differences: the smallest of what is noise
_FINE, _ROUNDING = 1e-3, 1e-14  # of a slope, and of weighted residuals: noise that does not count


@dataclass(frozen=True)
class Roughness:
    """Of simulations along a parameter.

    Attributes:
        noise: rms of residuals' own noise, weighted.
        step, central: relative steps of forward and of central differences.
    """

    KEYS = ("noise", "step")

    noise: float
    step: float
    central: float


def roughness(run: FreeRun, here: Iterate, columns: Sequence[int]) -> dict[int, Roughness]:
    """Column -> its roughness, by runs that are all simulated at once; none of a column without room, or in steps.

    Columns are the parameters, then the estimated initial states, each moved in all windows at once.
    """
    rows = {c: points for c in columns if (points := _row(run, here.point, c))}
    found = run.several([point for points in rows.values() for point in points])
    count, base, told = _ROW + 2, np.concatenate(here.residuals), dict[int, Roughness]()
    for i, c in enumerate(rows):
        own = found[i * count : (i + 1) * count]
        values = [np.concatenate(one) for one in own if one is not None]
        if len(values) == count and _is_even(np.array([base, *values[:_ROW]])):
            told[c] = _judged(run.step, np.array([base, *values[:_ROW]]), values[_ROW:])
    return told


def _row(run: FreeRun, point: Point, column: int) -> list[Point]:
    """A row of points to the side that has room, and one afar to either; none where bounds leave no room for them."""
    for side in (1.0, -1.0):
        shares = [*(side * _APART * k for k in range(1, _ROW + 1)), _AFAR, -_AFAR]
        points = [moved(point, column, share * size(point, column)) for share in shares]
        if all(inside(run, one) for one in points):
            return points
    return []


def _is_even(row: FloatArray) -> bool:
    """Whether all runs of a row (7, N) are as rough; what acts in steps jumps between some and rests between others."""
    sizes = np.linalg.norm(np.diff(row, n=2, axis=0), axis=1)
    return bool(sizes.min() > _EVEN * sizes.max())


def _judged(least: float, row: FloatArray, afar: Sequence[FloatArray]) -> Roughness:
    """By (7, N) residuals in a row and (N,) of two runs afar; with the least step where noise is nothing beside that.

    Of a curvature that noise hides so much is taken as it can hide, so that no step goes beyond what was looked at.
    """
    noise = min(_noise(row, order) for order in range(_LOWEST, _ROW + 1))
    central = least ** (2 / 3)
    slope = float(np.sqrt(np.mean((row[-1] - row[0]) ** 2))) / (_ROW * _APART)
    if math.sqrt(2) * noise <= _FINE * least * slope or noise <= _ROUNDING:
        return Roughness(noise, least, central)
    bent = float(np.sqrt(np.mean((afar[0] - 2 * row[0] + afar[1]) ** 2)))
    curvature = max(bent, math.sqrt(6) * noise) / _AFAR**2
    balanced = 8**0.25 * math.sqrt(noise / curvature), (3 * noise / curvature) ** (1 / 3)
    return Roughness(noise, max(balanced[0], least), min(max(balanced[1], central), _COARSEST))


def _noise(row: FloatArray, order: int) -> float:
    """rms of the noise in rows (7, N), by their differences of this order."""
    differences = np.diff(row, n=order, axis=0)
    return math.sqrt(float(np.mean(differences**2)) / math.comb(2 * order, order))
