"""What loops do between the frequencies at which they are known: where a figure of L is zero, and where it is least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from identification.tuning.loops.open_loop import OpenLoop
from orchestrator.trace import BoolArray, ComplexArray, FloatArray

PLACES = 4  # at which a minimum is sought
BEFORE = 1 - 1e-6  # times half the sampling frequency: there itself L is real, and its imaginary part rounding
TURNS = 60  # of the search for a zero or a minimum
FINE = 1e-9  # step of a search for a zero, of the frequency, at which it ends; the next would be far smaller
GOLDEN = (np.sqrt(5) - 1) / 2
Measured = Callable[[ComplexArray], FloatArray]


@dataclass(frozen=True, eq=False)
class LoopCrossings:
    """Where loops' responses cross something.

    Attributes:
        number: (Q,) which loop.
        omega: (Q,) [rad/s].
        value: (Q,) L there.
    """

    number: np.ndarray
    omega: FloatArray
    value: ComplexArray

    def least(self, values: FloatArray, count: int) -> FloatArray:
        """(count,) the smallest of these values (Q,) in each loop, inf in one without crossings."""
        found = np.full(count, np.inf)
        np.minimum.at(found, self.number, values)
        return found


@dataclass(frozen=True, eq=False)
class _Brackets:
    """(Q,) pairs of frequencies of loops, between which a figure changes its sign, and what it is there."""

    number: np.ndarray
    one: FloatArray
    other: FloatArray
    at_one: FloatArray
    at_other: FloatArray

    def joined(self, more: _Brackets) -> _Brackets:
        return _Brackets(*(np.concatenate(pair) for pair in zip(vars(self).values(), vars(more).values(), strict=True)))


def crossings(loop: OpenLoop, measured: Measured, counts: Callable[[ComplexArray], BoolArray]) -> LoopCrossings:
    """Where what is measured changes its sign, of those places that count."""
    omega, values = np.minimum(loop.frequencies, BEFORE * loop.frequencies[:, -1:]), measured(loop.values)
    last = np.nonzero(omega < loop.frequencies)
    values[last] = measured(loop.at(last[0], omega[last]))
    number, column = np.nonzero((values[:, :-1] > 0) != (values[:, 1:] > 0))
    ends = (omega[number, column], omega[number, column + 1], values[number, column], values[number, column + 1])
    brackets = _Brackets(number, *ends)
    for sign in (1.0, -1.0):
        dips = _dips(loop, measured, omega, values, sign)
        brackets = brackets if dips is None else brackets.joined(dips)
    found = _zeros(lambda point: measured(loop.at(brackets.number, point)), brackets)
    value = loop.at(brackets.number, found)
    kept = counts(value)
    return LoopCrossings(brackets.number[kept], found[kept], value[kept])


def least(loop: OpenLoop, measured: Measured) -> FloatArray:
    """(N,) the smallest value of what is measured: by golden sections around where it is lowest."""
    omega, values = loop.frequencies, measured(loop.values)
    count, last = len(values), omega.shape[1] - 1
    _, low = _vertices(omega, values)
    padded = np.pad(values, ((0, 0), (1, 1)), constant_values=np.inf)
    low = np.where((values <= padded[:, :-2]) & (values <= padded[:, 2:]), low, np.inf)  # one place a minimum
    column = np.argsort(low, axis=1)[:, :PLACES].ravel()
    number = np.repeat(np.arange(count), PLACES)
    left, right = omega[number, np.maximum(column - 1, 0)], omega[number, np.minimum(column + 1, last)]
    at = [right - GOLDEN * (right - left), left + GOLDEN * (right - left)]
    seen = [measured(loop.at(number, point)) for point in at]
    for _ in range(TURNS):
        lower = seen[0] < seen[1]
        left, right = np.where(lower, left, at[0]), np.where(lower, at[1], right)
        new = np.where(lower, right - GOLDEN * (right - left), left + GOLDEN * (right - left))
        value = measured(loop.at(number, new))
        at = [np.where(lower, new, at[1]), np.where(lower, at[0], new)]
        seen = [np.where(lower, value, seen[1]), np.where(lower, seen[0], value)]
        if np.all(right - left <= 1e-6 * right):
            break
    found = np.minimum(*seen).reshape(count, PLACES).min(axis=1)
    return np.asarray(np.minimum(found, values.min(axis=1)))


def _dips(loop: OpenLoop, measured: Measured, omega: FloatArray, values: FloatArray, sign: float) -> _Brackets | None:
    """Pairs of crossings between two neighbours: where a parabola goes below zero (`sign` 1) and back."""
    at, low = _vertices(omega, sign * values)
    number, column = np.nonzero((sign * values > 0) & (low <= 0))
    if not len(number):
        return None
    value = measured(loop.at(number, at[number, column]))
    real = sign * value <= 0
    number, column, value = np.tile(number[real], 2), np.tile(column[real], 2), np.tile(value[real], 2)
    beside = column + np.repeat([-1, 1], len(number) // 2)
    return _Brackets(number, omega[number, beside], at[number, column], values[number, beside], value)


def _vertices(omega: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(N, F) where parabolas through points that are lower than their neighbours are lowest, and how low.

    At other points the points themselves.
    """
    at, low = omega.copy(), values.copy()
    x, y = omega[:, 1:-1], values[:, 1:-1]
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        before, after = (y - values[:, :-2]) / (x - omega[:, :-2]), (values[:, 2:] - y) / (omega[:, 2:] - x)
        bend = (after - before) / (omega[:, 2:] - omega[:, :-2])
        slope = before + bend * (x - omega[:, :-2])
        there = (values[:, :-2] >= y) & (values[:, 2:] >= y) & (bend > 0)
        at[:, 1:-1] = np.where(there, x - slope / (2 * bend), x)
        low[:, 1:-1] = np.where(there, y - slope**2 / (4 * bend), y)
    return np.where(np.isfinite(at), at, omega), np.where(np.isfinite(low), low, values)


def _zeros(function: Callable[[FloatArray], FloatArray], brackets: _Brackets) -> FloatArray:
    """(Q,) zeros in brackets by the Illinois method, all side by side."""
    a, b, fa, fb = brackets.one, brackets.other, brackets.at_one, brackets.at_other
    for _ in range(TURNS if len(a) else 0):
        with np.errstate(invalid="ignore", divide="ignore"):
            point = b - fb * (b - a) / (fb - fa)
        point = np.where(np.isfinite(point), point, 0.5 * (a + b))
        value = function(point)
        same = (value > 0) == (fb > 0)
        moved = np.abs(point - b)
        a, fa = np.where(same, a, b), np.where(same, 0.5 * fa, fb)
        b, fb = point, value
        if np.all((moved <= FINE * np.abs(b)) | (fb == 0)):
            break
    return b
