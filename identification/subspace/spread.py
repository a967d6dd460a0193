"""What is uncertain of an estimated linear model, and models drawn from that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from identification.linear.local_coordinates import Directions
from identification.linear.model import LinearModel
from orchestrator.trace import FloatArray

MATRICES = ("a", "b", "c", "d")


def changes(model: LinearModel, directions: Directions, covariance: FloatArray) -> tuple[LinearModel, ...]:
    """What one standard deviation changes in the matrices, along axes that are independent of each other.

    Args:
        covariance: (t, t) of steps along the t directions.

    Returns:
        At most t, each with a change of A, B, C and D in place of these; none where something is not determined.
    """
    if not np.isfinite(covariance).all():
        return ()
    variances, axes = np.linalg.eigh(covariance)
    nothing = replace(model, **{name: np.zeros_like(getattr(model, name)) for name in MATRICES})
    steps = (axes * np.sqrt(np.maximum(variances, 0.0))).T
    return tuple(directions.moved(nothing, step) for step in steps if step.any())


def drawn(model: LinearModel, found: Sequence[LinearModel], count: int, rng: np.random.Generator) -> list[LinearModel]:
    """Models (count,) whose matrices have the spread of `changes`, to first order."""
    steps = rng.standard_normal((count, len(found)))
    own = {
        name: getattr(model, name) + np.tensordot(steps, [getattr(one, name) for one in found], axes=1)
        for name in MATRICES
    }
    return [replace(model, **{name: values[i] for name, values in own.items()}) for i in range(count)]
