"""Where a damped pendulum resonates, from its parameters: the truth behind tests of the pendulum thesis' methods."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from identification.resonance.added_mass import AddedMassBounds
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


def bounds_around(p1: float, p2: float, p3: float, factor: float) -> AddedMassBounds:
    """Half a guess as the start, 0 to `factor` times the guess as bounds: what both scripts give fmincon."""
    guess = np.array([p1, p2, p3])
    return AddedMassBounds(tuple(0.5 * guess), (0.0, 0.0, 0.0), tuple(factor * guess))


# Table 5: the guess of the script for the recordings, from 0.2 kg at 0.104 m, 0.003 kg m^2, 0.001 N m s/rad.
TABLE_5_BOUNDS = bounds_around(0.2 * 0.104**2 + 0.003, 0.001, 0.2 * 0.104 * 9.81, 20)
