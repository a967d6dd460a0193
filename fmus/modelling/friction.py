"""Dry friction of a body that turns or slides: Coulomb's by direction, with a Stribeck peak near rest.

Its sign and the change between its two sides are smooth through zero; LuGre's bristles make it lag behind the motion.
The file travels inside every Python FMU.
"""

from typing import Any

from . import ops
from .model import parameter


def parameters(force: str, speed: str, stribeck_speed: float, friction_speed: float) -> tuple[Any, ...]:
    """Its parameters, in units of force (or torque) and speed, with the default speeds [unit of the speed]."""
    return (
        parameter("coulomb_friction_positive", force, 0.0, "Dry friction at positive speed", minimum=0),
        parameter("coulomb_friction_negative", force, 0.0, "Dry friction at negative speed", minimum=0),
        parameter("stribeck_friction", force, 0.0, "Dry friction added near zero speed", minimum=0),
        parameter("stribeck_speed", speed, stribeck_speed, "Speed over which the Stribeck term fades", minimum=1e-6),
        parameter("friction_speed", speed, friction_speed, "Speed over which dry friction changes sign", minimum=1e-6),
    )


DRY = parameters("N.m", "rad/s", 0.1, 0.05)


def direction(speed: Any, p: Any) -> Any:
    """-1 to 1: the sign of the speed, smooth through zero."""
    return ops.tanh(speed / p.friction_speed)


def by_direction(negative: Any, positive: Any, speed: Any, p: Any) -> Any:
    """What holds at this speed of a value for either direction."""
    return 0.5 * (positive + negative) + 0.5 * (positive - negative) * direction(speed, p)


def level(speed: Any, p: Any) -> Any:
    """Size of the dry friction at this speed."""
    coulomb = by_direction(p.coulomb_friction_negative, p.coulomb_friction_positive, speed, p)
    return coulomb + p.stribeck_friction * ops.exp(-((speed / p.stribeck_speed) ** 2))


def dry(speed: Any, p: Any) -> Any:
    """Dry friction against this speed."""
    return level(speed, p) * direction(speed, p)


def bristle_rate(speed: Any, bristle: Any, stiffness: Any, level: Any, resolved: Any) -> Any:
    """LuGre's z' = v - s0 |v| z / level. Where |v| asks for more than the solver resolves [1/s], z goes to the same
    limit, but as fast as it can."""
    relaxation = stiffness * ops.absolute(speed) / level
    return (speed - relaxation * bristle) * resolved / ops.maximum(resolved, relaxation)


def steepest(p: Any) -> Any:
    """How fast dry friction grows with the speed, at most [its unit over that of the speed]."""
    coulomb = ops.maximum(p.coulomb_friction_positive, p.coulomb_friction_negative) + p.stribeck_friction
    return coulomb / p.friction_speed
