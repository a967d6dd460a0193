"""A rigid body that swings about a horizontal axis: the Butterfly robot's first degree of freedom.

Eq. 5 with the added mass of Eq. 78, about an equilibrium that need not be at zero, and with dry friction:

    (p1 + m_a l_a^2) w' = torque - p2 w - dry friction(w) - (p3 + m_a g l_a) sin(angle - equilibrium_angle)
"""

from . import Model, State, friction, input_, ops, output, parameter, port


def moment_of_inertia(p):
    return p.inertia + p.added_mass * p.added_length**2


def gravity_torque(p):
    return p.gravity_torque + p.added_mass * p.gravity * p.added_length


def acceleration(x, u, p):
    resistance = p.viscous_friction * x.speed + friction.dry(x.speed, p)
    gravity = gravity_torque(p) * ops.sin(x.angle - p.equilibrium_angle)
    return (u.torque - resistance - gravity) / moment_of_inertia(p)


def energy(x, p):
    """Eq. 105: kinetic energy plus the height above the equilibrium."""
    height = gravity_torque(p) * (1 - ops.cos(x.angle - p.equilibrium_angle))
    return 0.5 * moment_of_inertia(p) * x.speed**2 + height


def derivatives(t, x, u, p):
    return {"angle": x.speed, "speed": acceleration(x, u, p)}


def outputs(t, x, u, p):
    return {"acceleration": acceleration(x, u, p), "energy": energy(x, p)}


def solver_step(p):
    """A seventh of the time constant of the steepest friction, a twentieth of a radian of the swing, at most 10 ms."""
    damping = (p.viscous_friction + friction.steepest(p)) / moment_of_inertia(p)
    swing = ops.sqrt(ops.absolute(gravity_torque(p)) / moment_of_inertia(p))
    return ops.minimum(0.01, 0.15 / ops.maximum(damping, ops.maximum(3 * swing, 1e-6)))


MODEL = Model(
    name="pendulum",
    description="Pendulum with added mass, viscous and dry friction (first degree of freedom of the Butterfly robot)",
    variables=(
        input_("torque", "N.m", "Torque on the axis"),
        output("angle", "rad", "Angle of the body, counter-clockwise"),
        output("speed", "rad/s", "Angular velocity"),
        output("acceleration", "rad/s2", "Angular acceleration"),
        output("energy", "J", "Mechanical energy, 0 at rest at the equilibrium (Eq. 105)"),
        parameter("inertia", "kg.m2", 0.00325, "Moment of inertia about the axis without added mass (p1)", minimum=0),
        parameter("viscous_friction", "N.m.s/rad", 0.001, "Viscous friction (k_f, part of p2)", minimum=0),
        parameter("gravity_torque", "N.m", 0.04905, "Weight times distance of the centre of mass (p3)"),
        *friction.DRY,
        parameter("equilibrium_angle", "rad", 0.0, "Angle at which gravity exerts no torque"),
        parameter("added_mass", "kg", 0.0, "Mass fixed to the body (m_a)", minimum=0),
        parameter("added_length", "m", 0.0, "Distance of the added mass from the axis (l_a)"),
        parameter("gravity", "m/s2", 9.81, "Acceleration of free fall"),
        parameter("angle_start", "rad", 0.0, "Angle at the start"),
        parameter("speed_start", "rad/s", 0.0, "Angular velocity at the start"),
    ),
    ports=(port("shaft", "rotational", speed="speed", torque="torque"),),
    states=(State("angle", "angle_start", "rad"), State("speed", "speed_start", "rad/s")),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    references=("Angelchev Shiryaev, Umea University 2024, Eqs. 5, 78, 105",),
)
