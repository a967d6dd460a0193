"""The axis in its loop, by the parameters found: positions that follow the reference and know nothing of the noise."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from identification.inverse_dynamics.terms import Term
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class PositionLoop:
    """Position control of the axis: command = speed_gain (position_gain (reference - position) - speed).

    Attributes:
        reference: signal of the traces, in the position's unit.
        position_gain: [1/s], speed_gain: [command per speed].
    """

    reference: str
    position_gain: float
    speed_gain: float


def in_loop(
    loop: PositionLoop,
    reference: FloatArray,
    start: tuple[float, float],
    values: Mapping[Term, float],
    gain: float,
    h: float,
) -> FloatArray:
    """(K,) position of the axis with these values at each sample of the reference (K,), `h` [s] apart.

    Steps are semi-implicit; within one dry friction stops the axis, and never turns it round.

    Args:
        start: position and speed at the first sample.
        gain: force per command.
    """
    q, v = start
    positions = np.empty(len(reference))
    inertia, offset = values["inertia"], values.get("offset", 0.0)
    stiffness = values.get("stiffness", 0.0)
    by_direction = {sign: _friction(values, sign) for sign in ("positive", "negative")}
    for k, wanted in enumerate(reference.tolist()):
        force = gain * loop.speed_gain * (loop.position_gain * (wanted - q) - v) - offset - stiffness * q
        free = v + h * force / inertia
        viscous, dry = by_direction["positive" if free > 0 else "negative"]
        left = max(abs(free) - h * dry / inertia, 0.0) / (1 + h * viscous / inertia)
        after = math.copysign(left, free)
        positions[k] = q
        q, v = q + h * after, after
    return positions


def _friction(values: Mapping[Term, float], side: str) -> tuple[float, float]:
    """Viscous and dry friction in one direction."""
    viscous, dry = (values.get(f"{kind}_{side}", values.get(kind, 0.0)) for kind in ("viscous", "coulomb"))  # type: ignore[call-overload]
    return viscous, dry
