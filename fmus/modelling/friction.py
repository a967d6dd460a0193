"""Dry friction of a body that turns: Coulomb's by direction, with a Stribeck peak near rest.

Its sign and the change between its two sides are smooth through zero. The file travels inside every Python FMU.
"""

from typing import Any

from . import ops
from .model import parameter

DRY = (
    parameter("coulomb_friction_positive", "N.m", 0.0, "Dry friction at positive speed", minimum=0),
    parameter("coulomb_friction_negative", "N.m", 0.0, "Dry friction at negative speed", minimum=0),
    parameter("stribeck_friction", "N.m", 0.0, "Dry friction added near zero speed", minimum=0),
    parameter("stribeck_speed", "rad/s", 0.1, "Speed over which the Stribeck term fades", minimum=1e-6),
    parameter("friction_speed", "rad/s", 0.05, "Speed over which dry friction changes sign", minimum=1e-6),
)


def dry(speed: Any, p: Any) -> Any:
    """Torque of dry friction against this speed."""
    sign = ops.tanh(speed / p.friction_speed)
    mean = 0.5 * (p.coulomb_friction_positive + p.coulomb_friction_negative)
    difference = 0.5 * (p.coulomb_friction_positive - p.coulomb_friction_negative)
    stribeck = p.stribeck_friction * ops.exp(-((speed / p.stribeck_speed) ** 2))
    return (mean + difference * sign + stribeck) * sign


def steepest(p: Any) -> Any:
    """How fast dry friction grows with the speed, at most [N m s/rad]."""
    coulomb = ops.maximum(p.coulomb_friction_positive, p.coulomb_friction_negative) + p.stribeck_friction
    return coulomb / p.friction_speed
