"""A noisy axis in its position loop, many draws of the noise at once, by steps of a fifth of a sample."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from orchestrator.trace import FloatArray

STEP, FINER = 1e-3, 5  # [s], and steps a sample
GAIN, POSITION_GAIN, SPEED_GAIN = 35.0, 40.0, 200.0  # [N/V], [1/s], [V s/m]


@dataclass(frozen=True)
class Axis:
    """What is true: mass, viscous friction and dry friction by direction, offset."""

    mass: float = 95.0
    viscous: tuple[float, float] = (160.0, 240.0)
    coulomb: tuple[float, float] = (20.0, 22.0)
    offset: float = 0.0

    def friction(self, speed: FloatArray) -> FloatArray:
        """Force against this speed; the sign of dry friction is smooth within a millimetre a second."""
        ahead = speed > 0
        viscous, coulomb = (np.where(ahead, *pair) for pair in (self.viscous, self.coulomb))
        return viscous * speed + coulomb * np.tanh(speed / 2e-4)


def reference(duration: float) -> FloatArray:
    """(K,) [m] two sines that never repeat."""
    time = np.arange(round(duration / STEP)) * STEP
    return 0.03 * np.sin(2.1 * time) + 0.02 * np.sin(5.3 * time)


def driven(axis: Axis, wanted: FloatArray, noise: float, draws: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """(K, draws) measured positions [m] and commands [V]; the noise of the encoder [m] goes through the controller."""
    rng = np.random.default_rng(seed)
    q = np.full(draws, wanted[0])
    v = np.full(draws, (wanted[1] - wanted[0]) / STEP)
    before, rows = q + 0.0 - v * STEP, []
    for target in wanted:
        measured = q + noise * rng.standard_normal(draws)
        command = SPEED_GAIN * (POSITION_GAIN * (target - measured) - (measured - before) / STEP)
        rows.append((measured, command))
        before = measured
        for _ in range(FINER):
            v = v + STEP / FINER * (GAIN * command - axis.friction(v) - axis.offset) / axis.mass
            q = q + STEP / FINER * v
    return np.array([row[0] for row in rows]), np.array([row[1] for row in rows])
