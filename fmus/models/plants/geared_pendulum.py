"""A pendulum that its motor drives through a gear with play: what the pendulum of Eq. 5 leaves out.

    rotor:  J_r a' = torque - passed
    hand:   J w' = passed - p2 w - dry friction(w) - p3 sin(angle - equilibrium_angle)

All is referred to the hand's side. The teeth pass a torque on only in contact, k wound + c (difference of speeds), and
push, never pull: where their damping would turn the torque around there is none.
"""

from . import Model, State, friction, input_, ops, output, parameter, port


def passed(x, p):
    """Torque that the teeth pass on from the rotor to the hand."""
    twist = x.rotor_angle - x.angle
    wound = twist - ops.clip(twist, -0.5 * p.backlash, 0.5 * p.backlash)
    torque = p.stiffness * wound + p.damping * (x.rotor_speed - x.speed)
    return ops.where(wound > 0, ops.maximum(torque, 0.0), ops.where(wound < 0, ops.minimum(torque, 0.0), 0.0))


def acceleration(x, p):
    resistance = p.viscous_friction * x.speed + friction.dry(x.speed, p)
    gravity = p.gravity_torque * ops.sin(x.angle - p.equilibrium_angle)
    return (passed(x, p) - resistance - gravity) / p.inertia


def energy(x, p):
    """Eq. 105 of the hand alone."""
    return 0.5 * p.inertia * x.speed**2 + p.gravity_torque * (1 - ops.cos(x.angle - p.equilibrium_angle))


def derivatives(t, x, u, p):
    return {
        "angle": x.speed,
        "speed": acceleration(x, p),
        "rotor_angle": x.rotor_speed,
        "rotor_speed": (u.torque - passed(x, p)) / p.rotor_inertia,
    }


def outputs(t, x, u, p):
    return {"energy": energy(x, p)}


def solver_step(p):
    """A fifteenth of a radian of the rotor's swing on the teeth, a seventh of the steepest damping's time constant."""
    lighter = ops.minimum(p.rotor_inertia, p.inertia)
    damping = (p.damping + p.viscous_friction + friction.steepest(p)) / lighter
    return ops.minimum(0.067 * ops.sqrt(lighter / p.stiffness), 0.15 / ops.maximum(damping, 1e-9))


MODEL = Model(
    name="geared_pendulum",
    description="Pendulum with dry friction behind a gear with play and elastic teeth",
    variables=(
        input_("torque", "N.m", "Torque of the motor on its rotor"),
        output("angle", "rad", "Angle of the hand, counter-clockwise"),
        output("speed", "rad/s", "Angular velocity of the hand"),
        output("rotor_angle", "rad", "Angle of the rotor"),
        output("rotor_speed", "rad/s", "Angular velocity of the rotor"),
        output("energy", "J", "Mechanical energy of the hand, 0 at rest at the equilibrium (Eq. 105)"),
        parameter("inertia", "kg.m2", 0.00325, "Moment of inertia of the hand about the axis", minimum=1e-12),
        parameter("viscous_friction", "N.m.s/rad", 0.001, "Viscous friction of the hand", minimum=0),
        parameter("gravity_torque", "N.m", 0.04905, "Weight times distance of the centre of mass"),
        *friction.DRY,
        parameter("equilibrium_angle", "rad", 0.0, "Angle at which gravity exerts no torque"),
        parameter("rotor_inertia", "kg.m2", 3e-4, "Moment of inertia of the rotor", minimum=1e-12),
        parameter("backlash", "rad", 0.0, "Play between the teeth; 0 leaves the elastic gear", minimum=0),
        parameter("stiffness", "N.m/rad", 20.0, "Stiffness of teeth in contact", minimum=1e-9),
        parameter("damping", "N.m.s/rad", 0.03, "Damping of teeth in contact", minimum=0),
        parameter("angle_start", "rad", 0.0, "Angle of the hand and of the rotor at the start"),
        parameter("speed_start", "rad/s", 0.0, "Angular velocity of both at the start"),
    ),
    ports=(port("shaft", "rotational", speed="rotor_speed", torque="torque"),),
    states=(
        State("angle", "angle_start", "rad"),
        State("speed", "speed_start", "rad/s"),
        State("rotor_angle", "angle_start", "rad"),
        State("rotor_speed", "speed_start", "rad/s"),
    ),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    references=("Angelchev Shiryaev, Umea University 2024, Eqs. 5, 105, and a gear that it leaves out",),
)
