"""Linear systems, and records of them, that the tests of their identification start from."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData
from orchestrator.trace import ComplexArray, FloatArray

STEP = 0.01


def system(poles: ComplexArray | list[complex], inputs: int = 1, outputs: int = 1, seed: int = 0) -> LinearModel:
    """A system with these poles, of pairs the one above the real axis, in random states."""
    rng, a = np.random.default_rng(seed), real_blocks(poles)
    n = len(a)
    model = LinearModel(
        a,
        _away_from_zero(rng, (n, inputs)),
        _away_from_zero(rng, (outputs, n)),
        rng.standard_normal((outputs, inputs)),
        STEP,
        tuple(f"u{i + 1}" for i in range(inputs)),
        tuple(f"y{i + 1}" for i in range(outputs)),
    )
    return model.transformed(np.linalg.qr(rng.standard_normal((n, n)))[0])


def real_blocks(poles: ComplexArray | list[complex]) -> FloatArray:
    """A real matrix with these poles, of pairs the one above the real axis, block by block."""
    pairs = [np.array([[z.real, z.imag], [-z.imag, z.real]]) for z in map(complex, poles)]
    return np.asarray(block_diag(*(pair if pair[0, 1] else pair[:1, :1] for pair in pairs)))


def _away_from_zero(rng: np.random.Generator, shape: tuple[int, int]) -> FloatArray:
    """No mode is hidden from any input or output."""
    return np.asarray(rng.uniform(0.5, 1.5, shape) * rng.choice([-1.0, 1.0], shape))


def random_system(seed: int, pairs: int = 2, real: int = 1, inputs: int = 1, outputs: int = 2) -> LinearModel:
    """Stable, with well separated poles."""
    rng = np.random.default_rng(seed)
    angles = (np.arange(pairs) + rng.uniform(0.3, 0.7, pairs)) * np.pi / max(pairs, 1)
    paired = rng.uniform(0.7, 0.97, pairs) * np.exp(1j * angles)
    reals = (np.arange(real) + rng.uniform(0.3, 0.7, real)) / max(real, 1) * 0.9
    return system([*paired, *reals], inputs, outputs, seed)


def record_of(
    model: LinearModel, samples: int, seed: int = 0, noise: float = 0.0, settled: bool = False
) -> InputOutputData:
    """White excitation and white noise, relative to each output; from a random state unless `settled`."""
    rng = np.random.default_rng(1000 + seed)
    u = rng.standard_normal((samples, len(model.inputs)))
    y = model.simulate(u, None if settled else rng.standard_normal(model.order))
    return InputOutputData(
        u,
        y + noise * y.std(axis=0) * rng.standard_normal(y.shape),
        model.step,
        model.inputs,
        model.outputs,
        f"record {seed}",
    )


def distance(one: LinearModel, other: LinearModel) -> float:
    """Largest difference of the frequency responses over the largest response."""
    omega = np.linspace(0.5, 0.99 * np.pi / one.step, 60)
    reference = other.frequency_response(omega)
    return float(np.abs(one.frequency_response(omega) - reference).max() / np.abs(reference).max())


def sorted_poles(model: LinearModel) -> ComplexArray:
    """(n,) by real part, the one above the axis last of a pair."""
    rounded = np.round(model.eigenvalues, 9)
    return model.eigenvalues[np.lexsort((rounded.imag, rounded.real))]
