"""Random linear models with known modes, for tests."""

from __future__ import annotations

import numpy as np

from identification.linear.model import LinearModel
from orchestrator.trace import FloatArray
from tests.support.identification.linear_systems import real_blocks

STEP = 1 / 300  # [s]


def model_of(
    eigenvalues: list[complex], seed: int = 0, inputs: int = 1, outputs: int = 3, mixed: bool = True
) -> LinearModel:
    """A model with these eigenvalues (one of each pair), random B and C, in a random basis."""
    rng = np.random.default_rng(seed)
    a = real_blocks(eigenvalues)
    n = len(a)
    b, c, d = rng.normal(size=(n, inputs)), rng.normal(size=(outputs, n)), np.zeros((outputs, inputs))
    names = tuple(f"u{i}" for i in range(inputs)), tuple(f"y{i}" for i in range(outputs))
    plain = LinearModel(a, b, c, d, STEP, *names)
    return plain.transformed(np.linalg.qr(rng.normal(size=(n, n)))[0]) if mixed else plain


def eigenvalue(frequency: float, damping: float) -> complex:
    """Of a mode with this natural frequency [Hz] and damping ratio."""
    omega = 2 * np.pi * frequency
    return complex(np.exp((-omega * damping + 1j * omega * np.sqrt(1 - damping**2)) * STEP))


def white(samples: int, inputs: int = 1, seed: int = 1) -> FloatArray:
    """(samples, inputs) white noise."""
    return np.random.default_rng(seed).normal(size=(samples, inputs))
