"""A noisy axis in its position loop, many draws of the noise at once: exactly, whatever lies between samples."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.trace import FloatArray

STEP = 1e-3  # [s]
GAIN, POSITION_GAIN, SPEED_GAIN = 35.0, 40.0, 200.0  # [N/V], [1/s], [V s/m]
_PARTS = 4  # of a step: to rest, at rest or turned round, and again


@dataclass(frozen=True)
class Axis:
    """What is true: mass, viscous friction and dry friction by direction, offset."""

    mass: float = 95.0
    viscous: tuple[float, float] = (160.0, 240.0)
    coulomb: tuple[float, float] = (20.0, 22.0)
    offset: float = 0.0

    def moved(self, q: FloatArray, v: FloatArray, force: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
        """Position and speed after a step of constant force: closed form between instants of rest."""
        left = np.full_like(q, step)
        net = force - self.offset
        for _ in range(_PARTS):
            ahead = np.where(v != 0, v, net) > 0
            viscous, coulomb = (np.where(ahead, *pair) for pair in (self.viscous, self.coulomb))
            rests = (v == 0) & (np.abs(net) <= coulomb)
            final = (net - np.where(ahead, coulomb, -coulomb)) / viscous  # the speed that it tends to
            rate = viscous / self.mass
            share = np.divide(-final, v - final, out=np.zeros_like(v), where=v != final)
            until = -np.log(np.where(share > 0, share, 1.0)) / rate
            until = np.where((v != 0) & (until > 0), until, np.inf)
            span = np.minimum(until, left)
            decayed = np.exp(-rate * span)
            q = np.where(rests, q, q + final * span + (v - final) * (1 - decayed) / rate)
            v = np.where(rests | (until <= left), 0.0, final + (v - final) * decayed)
            left = np.where(rests, 0.0, left - span)
            if not left.any():
                break
        return q, v


def reference(duration: float, step: float = STEP) -> FloatArray:
    """(K,) [m] two sines that never repeat."""
    time = np.arange(round(duration / step)) * step
    return 0.03 * np.sin(2.1 * time) + 0.02 * np.sin(5.3 * time)


def driven(
    axis: Axis,
    wanted: FloatArray,
    noise: float,
    draws: int,
    seed: int,
    step: float = STEP,
    gains: tuple[float, float] = (POSITION_GAIN, SPEED_GAIN),
) -> tuple[FloatArray, FloatArray]:
    """(K, draws) measured positions [m] and commands [V]; the noise of the encoder [m] goes through the controller."""
    rng = np.random.default_rng(seed)
    q = np.full(draws, wanted[0])
    v = np.full(draws, (wanted[1] - wanted[0]) / step)
    before, rows = q + 0.0 - v * step, []
    for target in wanted:
        measured = q + noise * rng.standard_normal(draws)
        command = gains[1] * (gains[0] * (target - measured) - (measured - before) / step)
        rows.append((measured, command))
        before = measured
        q, v = axis.moved(q, v, GAIN * command, step)
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
