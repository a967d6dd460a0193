"""A carriage that a drive pushes along an axis: friction told apart by direction, Stribeck's peak, LuGre's bristles.

    mass v' = drive_gain command + force - viscous(v) v - dry friction - offset

Viscous and Coulomb friction have a value for either direction. The bristles are left out where they have no stiffness;
with them dry friction is LuGre's, s0 z + s1 z', with z' = v - s0 |v| z / (Coulomb and Stribeck friction at v).
A constant offset and Coulomb friction that differs by direction are the same force wherever the axis moves.
"""

from . import Model, Requirement, State, friction, input_, ops, output, parameter, port

RESOLVED = 20.0  # times the frequency of the mass on its bristles: the fastest rate at which they follow


def resolved_rate(p):
    """The fastest rate at which the bristles follow [1/s]."""
    return RESOLVED * ops.sqrt(p.bristle_stiffness / p.mass)


def bristle_rate(x, p):
    """LuGre's z'; 0 without bristles."""
    stiffness = ops.maximum(p.bristle_stiffness, 1e-9)
    level = ops.maximum(friction.level(x.speed, p), 1e-9)
    rate = friction.bristle_rate(x.speed, x.bristle, stiffness, level, ops.maximum(resolved_rate(p), 1e-9))
    return ops.where(p.bristle_stiffness > 0, rate, 0.0)


def viscous(x, p):
    """Viscous friction per speed in the direction of the motion."""
    return friction.by_direction(p.viscous_friction_negative, p.viscous_friction_positive, x.speed, p)


def friction_force(x, p):
    """Force of friction against the motion."""
    bristles = p.bristle_stiffness * x.bristle + p.bristle_damping * bristle_rate(x, p)
    dry = ops.where(p.bristle_stiffness > 0, bristles, friction.dry(x.speed, p))
    return dry + viscous(x, p) * x.speed


def acceleration(x, u, p):
    return (p.drive_gain * u.command + u.force - friction_force(x, p) - p.offset) / p.mass


def derivatives(t, x, u, p):
    return {"position": x.speed, "speed": acceleration(x, u, p), "bristle": bristle_rate(x, p)}


def outputs(t, x, u, p):
    return {"acceleration": acceleration(x, u, p), "friction": friction_force(x, p)}


def solver_step(p):
    """A seventh of the time constant of the steepest friction; with bristles what they resolve; at most 10 ms."""
    most = ops.maximum(p.viscous_friction_positive, p.viscous_friction_negative)
    damping = (most + ops.where(p.bristle_stiffness > 0, p.bristle_damping, friction.steepest(p))) / p.mass
    return ops.minimum(0.01, ops.minimum(0.15 / ops.maximum(damping, 1e-6), 1 / ops.maximum(resolved_rate(p), 1e-6)))


FRICTION = (
    parameter("viscous_friction_positive", "N.s/m", 0.0, "Viscous friction at positive speed", minimum=0),
    parameter("viscous_friction_negative", "N.s/m", 0.0, "Viscous friction at negative speed", minimum=0),
    *friction.parameters("N", "m/s", 0.01, 1e-3),
    parameter("bristle_stiffness", "N/m", 0.0, "Stiffness of the bristles (s0); 0 leaves them out", minimum=0),
    parameter("bristle_damping", "N.s/m", 0.0, "Damping of the bristles (s1)", minimum=0),
)

MODEL = Model(
    name="linear_axis",
    description="Carriage on a driven axis: viscous and dry friction by direction, offset, bristles as an option",
    variables=(
        input_("command", "V", "Command to the drive"),
        input_("force", "N", "Further force on the carriage"),
        output("position", "m", "Position of the carriage"),
        output("speed", "m/s", "Speed of the carriage"),
        output("acceleration", "m/s2", "Acceleration of the carriage"),
        output("friction", "N", "Force of friction against the motion"),
        parameter("mass", "kg", 1.0, "Mass that is moved, the drive's inertia included", minimum=1e-9),
        parameter("drive_gain", "N/V", 1.0, "Force of the drive per command"),
        parameter("offset", "N", 0.0, "Constant force against the positive direction"),
        *FRICTION,
        parameter("position_start", "m", 0.0, "Position at the start"),
        parameter("speed_start", "m/s", 0.0, "Speed at the start"),
    ),
    ports=(port("carriage", "translational", speed="speed", force="force"),),
    states=(
        State("position", "position_start", "m"),
        State("speed", "speed_start", "m/s"),
        State("bristle", 0.0, "m", description="Mean deflection of the bristles (z)"),
    ),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    requirements=(
        Requirement(
            lambda t, x, u, p: ops.where(p.bristle_stiffness > 0, friction.level(x.speed, p), 1.0) > 0,
            "bristles need Coulomb friction in either direction",
        ),
    ),
    references=(
        "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995, pp. 419-425",
        "Janot, Gautier, Brunot: Data set and reference models of EMPS, Nonlinear System Identification Workshop 2019",
    ),
)
