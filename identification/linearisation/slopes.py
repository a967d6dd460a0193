"""What a component comes to where it is linearised; `equations`, `fmu_slopes` and `sampling` find it.

x' = A x + B u,   y = C x + D u
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from orchestrator.trace import BoolArray, FloatArray

WIDTHS = (1e-4, 1e-6)  # of the central differences, in the variables' units
ALIKE = 1e-4  # relative, how far slopes of both widths may be apart
SLOW = 1e-9  # of the states' rates, below which a model rests
DIRECTIONAL, DIFFERENCES = "its directional derivatives", "differences of its derivatives and outputs"
TANGENTS = "the tangents that it carries over a step"
MATRICES = "its own matrices"


@dataclass(frozen=True, eq=False)
class Slopes:
    """N linear models of one component, in continuous time.

    Attributes:
        a, b, c, d: (N, n, n), (N, n, m), (N, p, n), (N, p, m).
        states, inputs, outputs: names.
        by: what they were found by, where that is to be told.
        moving: how fast a state changes there at most [its unit/s].
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    by: str = ""
    moving: float = 0.0


@dataclass(frozen=True, eq=False)
class Sampling:
    """A linear model of what happens at the instants of one component.

    x[k+1] = A x[k] + B u[k],   y[k] = C x[k] + D u[k], which is held until the next instant

    Attributes:
        a, b, c, d: (n, n), (n, m), (p, n), (p, m).
        inputs, outputs: names.
        period: from one instant to the next [s].
        by: what they were found by.
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float
    by: str = ""


@dataclass(frozen=True)
class Standing:
    """Where a component is that is linearised elsewhere than where it starts: time [s], and values by name."""

    time: float
    states: Mapping[str, float]
    inputs: Mapping[str, float]


def central(answer: Callable[[FloatArray], FloatArray], point: FloatArray, width: float) -> FloatArray:
    """(r, m) central differences of what answers (r,) to a point (m,)."""
    steps = width * np.eye(len(point))
    columns = [(answer(point + step) - answer(point - step)) / (2 * width) for step in steps]
    return np.stack(columns, axis=1) if columns else np.zeros((len(answer(point)), 0))


def quarters(whole: FloatArray, n: int) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C, D out of slopes (..., n + p, n + m) of rates, or new states, and outputs by states and inputs."""
    return whole[..., :n, :n], whole[..., :n, n:], whole[..., n:, :n], whole[..., n:, n:]


def differ(one: FloatArray, other: FloatArray) -> BoolArray:
    """Which of two estimates of slopes differ by more than rounding and curvature explain."""
    return np.asarray(np.abs(one - other) > ALIKE * np.maximum(np.abs(one), np.abs(other)) + 1e-6)


def apart(one: FloatArray, other: FloatArray) -> bool:
    """Whether any of them do."""
    return bool(np.any(differ(one, other)))
