"""A flexible link on a DC motor, in modal coordinates: few enough constants to find them all in recordings of the rig.

With the hub's angle a and the clamped link's modes q_i [rad], scaled so that the link's kinetic energy is that of
inertia (a'^2 + 2 sum c_i a' q_i' + sum q_i'^2) / 2,

    inertia (a'' + sum c_i q_i'') = torque - friction,
    q_i'' + c_i a'' + 2 zeta_i w_i q_i' + w_i^2 q_i = large_i,         large_i is 0 while the link bends little,
    tip_acceleration = length (a'' + sum tip_i q_i'').

A uniform beam with the share s of the inertia has c_i = sqrt(3 s) 2 / beta_i^2 and tip_i = +-2 / sqrt(3 s), with
cos beta_i cosh beta_i = -1; the defaults are those of s = 0.7. Where the second mode bends far, it loses stiffness,
takes a part of the third with it, and is damped more: y = q_2 + mix q_3 has the potential energy of a softening spring.
The torque follows the command with a lag, and saturates; the motor's cogging pulls the hub to evenly spaced angles.
Friction is LuGre's, z' = v - s0 |v| z / F_c, torque = s0 z + s1 z' + c v, with bristles soft enough to be seen.
"""

import math

from . import Model, Requirement, State, friction, input_, ops, output, parameter

MODES = (1, 2, 3)
DEFAULTS = ((2.5, 0.8243, 1.380), (15.7, 0.1315, -1.380), (43.9, 0.0470, 1.380))  # frequency [Hz], c_i and tip_i
RESOLVED = 20.0  # times the frequency of the hub on its bristles: the fastest rate at which they follow


def all_modes(name, values):
    """The values of one name for all modes."""
    return [getattr(values, f"{name}_{i}") for i in MODES]


def total(factors, others):
    first, *rest = [a * b for a, b in zip(factors, others, strict=True)]
    return sum(rest, first)


def remainder(p):
    """The part of the inertia that the modes leave to the hub; a link that is one has some."""
    return 1 - sum(c**2 for c in all_modes("participation", p))


def free_share(p):
    """The part of the inertia that resists the hub when it turns faster than the link follows."""
    return ops.maximum(remainder(p), 1e-6)


def saturated(command, p):
    """The part of the command that the drive follows: all of a small one, never more than the limit."""
    return p.command_limit * ops.tanh(command / p.command_limit)


def cogging(x, p):
    """Torque of the motor's magnets on the hub; it pulls to the nearest detent."""
    return -p.cogging_torque * ops.sin(2 * math.pi * (x.angle - p.cogging_angle) / p.cogging_period)


def resolved_rate(p):
    """The fastest rate at which the bristles follow [1/s]."""
    return RESOLVED * ops.sqrt(p.bristle_stiffness / (p.inertia * free_share(p)))


def bristle_rate(x, p):
    """LuGre's z'."""
    return friction.bristle_rate(x.speed, x.bristle, p.bristle_stiffness, p.coulomb_friction, resolved_rate(p))


def friction_torque(x, p):
    return p.bristle_stiffness * x.bristle + p.bristle_damping * bristle_rate(x, p) + p.viscous_friction * x.speed


def large(x, p):
    """What large deflections change in each mode's acceleration."""
    y = x.deflection_2 + p.softening_mix * x.deflection_3
    lost = p.softening * (2 * math.pi * p.frequency_2) ** 2
    softer = lost * (y - p.softening_deflection * ops.tanh(y / p.softening_deflection))
    drag = p.drag * ops.absolute(x.deflection_rate_2) * x.deflection_rate_2
    return [0.0, softer - drag, p.softening_mix * softer]


def modal_forces(x, p):
    """Acceleration of each mode with the hub held."""
    rates = [2 * math.pi * frequency for frequency in all_modes("frequency", p)]
    q, q_rate = all_modes("deflection", x), all_modes("deflection_rate", x)
    moving = zip(rates, all_modes("damping", p), q, q_rate, large(x, p), strict=True)
    return [more - 2 * zeta * w * rate - w**2 * q for w, zeta, q, rate, more in moving]


def accelerations(x, p):
    """(a'', [q_i''])."""
    forces, participation = modal_forces(x, p), all_modes("participation", p)
    driving = (x.torque + p.torque_bias + cogging(x, p) - friction_torque(x, p)) / p.inertia
    hub = (driving - total(participation, forces)) / free_share(p)
    return hub, [force - c * hub for force, c in zip(forces, participation, strict=True)]


def derivatives(t, x, u, p):
    hub, modal = accelerations(x, p)
    rates = {f"deflection_{i}": rate for i, rate in zip(MODES, all_modes("deflection_rate", x), strict=True)}
    rates |= {f"deflection_rate_{i}": rate for i, rate in zip(MODES, modal, strict=True)}
    torque = (p.torque_gain * saturated(u.command, p) - x.torque) / p.drive_time
    return rates | {"angle": x.speed, "speed": hub, "bristle": bristle_rate(x, p), "torque": torque}


def outputs(t, x, u, p):
    hub, modal = accelerations(x, p)
    at_tip = p.length * (hub + total(all_modes("tip", p), modal))
    reading = p.accelerometer_gain * at_tip + p.accelerometer_offset
    return {
        "tip_acceleration": at_tip,
        "encoder": p.encoder_gain * x.angle,
        "accelerometer": ops.clip(reading, p.accelerometer_lowest, p.accelerometer_highest),
    }


def solver_step(p):
    """A quarter radian of a frequency above all modes, the root of the trace of M^-1 K; half of the drive's lag; a
    fifth of the damped hub's; all of the bristles'."""
    couplings = [1 + c**2 / free_share(p) for c in all_modes("participation", p)]
    of_modes = 4 * math.pi**2 * total(couplings, [f**2 for f in all_modes("frequency", p)])
    detent = 2 * math.pi * ops.absolute(p.cogging_torque) / p.cogging_period
    of_hub = (p.bristle_stiffness + detent) / (p.inertia * free_share(p))
    highest = ops.sqrt(of_modes + of_hub)
    damped = 0.2 * p.inertia * free_share(p) / ops.maximum(p.viscous_friction + p.bristle_damping, 1e-12)
    return ops.minimum(ops.minimum(0.25 / highest, 0.5 * p.drive_time), ops.minimum(damped, 1 / resolved_rate(p)))


def of_mode(i, frequency, participation, tip):
    """The parameters of one mode."""
    return (
        parameter(f"frequency_{i}", "Hz", frequency, f"Frequency of mode {i} with the hub held (w_{i})", minimum=1e-6),
        parameter(f"damping_{i}", "1", 0.01, f"Damping ratio of mode {i} with the hub held (zeta_{i})", minimum=0),
        parameter(f"participation_{i}", "1", participation, f"How a turn of the hub drives mode {i} (c_{i})"),
        parameter(f"tip_{i}", "1", tip, f"Deflection of the tip over length and coordinate of mode {i}"),
    )


DRIVE = (
    parameter("torque_gain", "N.m", 1e-3, "Torque per command while this is small"),
    parameter("command_limit", "1", 1e6, "Command at which the torque saturates", minimum=1e-6),
    parameter("drive_time", "s", 0.004, "Time constant of the torque", minimum=1e-6),
    parameter("torque_bias", "N.m", 0.0, "Torque that is there without a command"),
)
HUB = (
    parameter("inertia", "kg.m2", 0.01, "Moment of inertia of motor, hub and straight link", minimum=1e-12),
    parameter("viscous_friction", "N.m.s/rad", 0.1, "Viscous friction and back electromotive force", minimum=0),
    parameter("coulomb_friction", "N.m", 0.01, "Dry friction (F_c)", minimum=1e-9),
    parameter("bristle_stiffness", "N.m/rad", 1.0, "Stiffness of the bristles (s0)", minimum=1e-9),
    parameter("bristle_damping", "N.m.s/rad", 0.0, "Damping of the bristles (s1)", minimum=0),
    parameter("cogging_torque", "N.m", 0.0, "Torque of the motor's cogging between two detents"),
    parameter("cogging_period", "rad", 0.1, "Angle from one detent of the cogging to the next", minimum=1e-6),
    parameter("cogging_angle", "rad", 0.0, "Angle of a detent"),
)
LARGE = (
    parameter("softening", "1", 0.0, "Share of the second mode's stiffness that is lost far out", minimum=0, maximum=1),
    parameter("softening_deflection", "rad", 0.01, "Coordinate of mode 2 over which it is lost", minimum=1e-9),
    parameter("softening_mix", "1", 0.0, "How far mode 3 shares in it (mix)"),
    parameter("drag", "1/rad", 0.0, "Quadratic damping of the second mode", minimum=0),
)
SENSORS = (
    parameter("length", "m", 1.0, "Distance of the accelerometer from the hub"),
    parameter("encoder_gain", "1/rad", 1.0, "Reading of the encoder per angle"),
    parameter("accelerometer_gain", "s2/m", 1.0, "Reading of the accelerometer per acceleration"),
    parameter("accelerometer_offset", "1", 0.0, "Reading of the accelerometer at rest"),
    parameter("accelerometer_lowest", "1", -1e9, "Lowest reading of the accelerometer"),
    parameter("accelerometer_highest", "1", 1e9, "Highest reading of the accelerometer"),
)

MODEL = Model(
    name="flexible_link",
    description="Flexible link on a DC motor: three modes, friction, cogging, saturations, encoder and accelerometer",
    variables=(
        input_("command", "1", "Command to the drive, in its own units"),
        output("angle", "rad", "Angle of the hub, counter-clockwise"),
        output("speed", "rad/s", "Angular velocity of the hub"),
        output("tip_acceleration", "m/s2", "Acceleration of the tip across the link"),
        output("encoder", "1", "Reading of the motor's encoder"),
        output("accelerometer", "1", "Reading of the accelerometer at the tip"),
        *DRIVE,
        *HUB,
        *(of for i, values in zip(MODES, DEFAULTS, strict=True) for of in of_mode(i, *values)),
        *LARGE,
        *SENSORS,
        parameter("angle_start", "rad", 0.0, "Angle of the hub at the start"),
        parameter("speed_start", "rad/s", 0.0, "Angular velocity of the hub at the start"),
    ),
    states=(
        State("angle", "angle_start", "rad"),
        State("speed", "speed_start", "rad/s"),
        *(State(f"deflection_{i}", 0.0, "rad", description=f"Coordinate of mode {i} (q_{i})") for i in MODES),
        *(State(f"deflection_rate_{i}", 0.0, "rad/s", description=f"Rate of q_{i}") for i in MODES),
        State("bristle", 0.0, "rad", description="Mean deflection of the bristles (z)"),
        State("torque", 0.0, "N.m", description="Torque of the motor without bias"),
    ),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    requirements=(
        Requirement(
            lambda t, x, u, p: remainder(p) > 0,
            "the squares of the participations do not add up to less than 1; lower one",
        ),
    ),
    references=(
        "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995, pp. 419-425",
    ),
)
