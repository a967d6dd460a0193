"""Margins of loops: how much gain, phase or delay makes them unstable, and how near they come to -1.

They hold for loops that are stable when closed; whoever reads them looks at the poles, too.
"""

from __future__ import annotations

import numpy as np

from identification.tuning.loops.between import LoopCrossings, crossings, least
from identification.tuning.loops.open_loop import OpenLoop
from orchestrator.trace import FloatArray

REAL = 1e-3  # imaginary part, of the real one, of an L that is real but for the distance of the lowest frequency from 0


def gain_margins(loop: OpenLoop) -> FloatArray:
    """(N,) by how many decibels the gain can rise or fall, whichever is less; inf where no gain does it."""
    crossed = phase_crossings(loop)
    return crossed.least(np.abs(20 * np.log10(np.abs(crossed.value))), len(loop.plants))


def phase_margins(loop: OpenLoop) -> FloatArray:
    """(N,) [rad] by how much the phase can turn, either way; inf where no phase does it."""
    crossed = gain_crossings(loop)
    return crossed.least(np.abs(np.angle(-crossed.value)), len(loop.plants))


def delay_margins(loop: OpenLoop) -> FloatArray:
    """(N,) [s] the shortest further delay that makes the loop unstable.

    Where |L| is 1 or more at half the sampling frequency a delay of one sample turns its sign there: the margin is at
    most that sample, and told as 0 where L is negative, for between samples this response does not tell.
    """
    crossed = gain_crossings(loop)
    inner = crossed.least(np.mod(np.angle(-crossed.value), 2 * np.pi) / crossed.omega, len(loop.plants))
    last = loop.values[:, -1].real
    outer = np.where(np.abs(last) >= 1, np.where(last > 0, np.pi, 0.0) / loop.frequencies[:, -1], np.inf)
    return np.minimum(inner, outer)


def modulus_margins(loop: OpenLoop) -> FloatArray:
    """(N,) the least distance of L from -1, which is 1 / max |S|."""
    return least(loop, lambda value: np.abs(1 + value))


def disk_margins(loop: OpenLoop) -> FloatArray:
    """(N,) the balanced disk margin alpha: 1 / max |S - 1/2| (Seiler, Packard, Gahinet 2020, without skew)."""
    return least(loop, lambda value: 2 * np.abs(1 + value) / np.maximum(np.abs(1 - value), 1e-300))


def phase_crossings(loop: OpenLoop) -> LoopCrossings:
    """Where L is real and negative, at zero and half the sampling frequency, too."""
    between = crossings(loop, lambda value: value.imag, lambda value: value.real < 0)
    parts = [between, _end(loop, 0), _end(loop, -1)]
    number, omega, value = (np.concatenate([getattr(p, name) for p in parts]) for name in ("number", "omega", "value"))
    return LoopCrossings(number, omega, value)


def gain_crossings(loop: OpenLoop) -> LoopCrossings:
    """Where |L| is 1."""
    return crossings(loop, lambda value: np.log(np.maximum(np.abs(value), 1e-300)), np.isfinite)


def _end(loop: OpenLoop, column: int) -> LoopCrossings:
    """An end of the frequencies, where L is real, of those loops in which it is negative there."""
    value = loop.values[:, column]
    real = (value.real < 0) & (np.abs(value.imag) < REAL * np.abs(value.real)) & np.isfinite(value)
    number = np.flatnonzero(real)
    return LoopCrossings(number, loop.frequencies[number, column], value[number])
