"""Where a damped pendulum resonates, from its parameters: the truth behind tests of the pendulum thesis' methods."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from orchestrator.trace import FloatArray


def resonance_frequency(
    p1: ArrayLike, p2: ArrayLike, p3: ArrayLike, added_mass: ArrayLike = 0.0, added_length: ArrayLike = 0.0
) -> FloatArray:
    """Frequency of the largest gain of p1 a + p2 w + p3 q = p4 v with an added mass [rad/s] (Eqs. 77 and 79).

    0 where the damping leaves no resonance (Lemma 6). Arguments broadcast.
    """
    mass, length = np.asarray(added_mass, dtype=float), np.asarray(added_length, dtype=float)
    inertia = p1 + mass * length**2
    squared = (p3 + mass * 9.81 * length) / inertia - (np.asarray(p2) / inertia) ** 2 / 2
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))
