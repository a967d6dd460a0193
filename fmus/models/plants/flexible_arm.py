"""A flexible arm that turns in the horizontal plane: an Euler-Bernoulli beam on a hub, with a payload at its tip.

The deflection is w(x, t) = sum phi_i(x/L) q_i(t), with phi_i the modes of the clamped-free beam, of mean square 1. With
the hub's angle a and the coordinates q the kinetic and elastic energy give M (a'', q'') = forces, where

    M = arrow + tip_mass g g^T,   g = (L, phi_1(1), ...),   arrow = [J_h + rho_A L^3/3, rho_A L^2 s^T; ., rho_A L I],
    s_i = int x phi_i = 2 / beta_i^2,   phi_i(1) = +2, -2, +2, ...,   K_ii = EI beta_i^4 / L^3.

Each beam mode is damped as it would be with its hub clamped. Friction is LuGre's, on the motor's side of the gear:
z' = v - s0 |v| z / g, torque = s0 z + s1 exp(-(v/vs)^2) z' + c v. With play in the gear, motor and load are two bodies
joined by a spring with a dead zone. The end stops are springs with dampers; how long they were touched is an output.
"""

import math

from . import Model, State, friction, input_, ops, output, parameter, port


def _root(number):
    """The solution of cos b = -1/cosh b near (number - 1/2) pi, by Newton's method."""
    b = (number - 0.5) * math.pi
    for _ in range(12):
        b += (math.cos(b) + 1 / math.cosh(b)) / (math.sin(b) + math.tanh(b) / math.cosh(b))
    return b


MODES = (1, 2, 3, 4, 5)
BETA = tuple(_root(i) for i in MODES)
SIGMA = tuple((math.sinh(b) - math.sin(b)) / (math.cosh(b) + math.cos(b)) for b in BETA)
AT_TIP = tuple(-2.0 * (-1) ** i for i in MODES)  # phi_i(1)
MOMENT = tuple(2 / b**2 for b in BETA)  # s_i
REMAINDER = 1 / 3 - sum(s**2 for s in MOMENT)  # int x^2 without what the modes have of it
BENDING = tuple(b**4 for b in BETA)  # int phi_i''^2

RESOLVED = 3.0  # times the frequency of the hub on its bristles: the fastest rate at which they follow


def dot(a, b):
    first, *others = [x * y for x, y in zip(a, b, strict=True)]
    return sum(others, first)


def beam_mass(p):
    return p.mass_per_length * p.length


def tip_mass(p):
    return p.payload + p.tip_fixture


def geared(p):
    """Whether motor and load are two bodies."""
    return p.backlash > 0


def free_inertia(p):
    """What resists the hub when it turns faster than the beam follows: what is left of arrow once q is eliminated."""
    of_hub = ops.where(geared(p), (1 - p.motor_share) * p.hub_inertia, p.hub_inertia)
    return of_hub + REMAINDER * beam_mass(p) * p.length**2


def motor_inertia(p):
    """What the bristles hold: the motor, and without play in the gear the hub."""
    return ops.where(geared(p), p.motor_share * p.hub_inertia, free_inertia(p))


def arrow_solve(hub, modal, p):
    """(a, [q]) of arrow (a, q) = (hub, modal)."""
    a = (hub - p.length * dot(MOMENT, modal)) / free_inertia(p)
    return a, [f / beam_mass(p) - s * p.length * a for f, s in zip(modal, MOMENT, strict=True)]


def accelerations(hub, modal, p):
    """(a'', [q'']) of M (a'', q'') = (hub, modal): arrow's solution, with Sherman and Morrison's for the tip mass."""
    a, q = arrow_solve(hub, modal, p)
    turn, bend = arrow_solve(p.length, AT_TIP, p)
    inertial = tip_mass(p) * at_tip(a, q, p) / (1 + tip_mass(p) * at_tip(turn, bend, p))
    return a - inertial * turn, [free - inertial * bent for free, bent in zip(q, bend, strict=True)]


def at_tip(angle, modal, p):
    """What a turn of the hub and deflections move the tip by, across the beam; likewise of rates."""
    return p.length * angle + dot(AT_TIP, modal)


def deflections(x):
    return [getattr(x, f"deflection_{i}") for i in MODES]


def deflection_rates(x):
    return [getattr(x, f"deflection_rate_{i}") for i in MODES]


def modal_stiffness(p):
    return [p.bending_stiffness / p.length**3 * factor for factor in BENDING]


def modal_forces(x, p):
    """Elastic and damping force on each mode."""
    ratios = [getattr(p, f"damping_{i}") for i in MODES]
    moving = zip(modal_stiffness(p), deflections(x), ratios, deflection_rates(x), strict=True)
    return [-k * q - 2 * ratio * ops.sqrt(k * beam_mass(p)) * rate for k, q, ratio, rate in moving]


def fading(x, p):
    """1 at rest, 0 well above the Stribeck speed."""
    return ops.exp(-((x.motor_speed / p.stribeck_speed) ** 2))


def bristle_rate(x, p):
    """LuGre's z'."""
    level = p.coulomb_friction + p.stribeck_friction * fading(x, p)
    resolved = RESOLVED * ops.sqrt(p.bristle_stiffness / motor_inertia(p))
    return friction.bristle_rate(x.motor_speed, x.bristle, p.bristle_stiffness, level, resolved)


def friction_torque(x, bristle_rate, p):
    """Torque of friction against the motor's motion."""
    damping = p.bristle_damping * fading(x, p)
    return p.bristle_stiffness * x.bristle + damping * bristle_rate + p.viscous_friction * x.motor_speed


def gear_torque(x, p):
    """Torque that a gear with play passes on."""
    twist = x.motor_angle - x.angle
    return p.gear_stiffness * (twist - ops.clip(twist, -0.5 * p.backlash, 0.5 * p.backlash))


def stop_torque(x, p):
    """Torque of an end stop on the hub; it pushes back and never pulls."""
    beyond = x.angle - ops.clip(x.angle, -p.stop_angle, p.stop_angle)
    damper = 2 * p.stop_damping * ops.sqrt(p.stop_stiffness * free_inertia(p))
    torque = -p.stop_stiffness * beyond - damper * x.speed
    return ops.where(beyond > 0, ops.minimum(torque, 0.0), ops.where(beyond < 0, ops.maximum(torque, 0.0), 0.0))


def hub_torque(x, driving, p):
    """Torque on what turns with the beam, from what drives the motor."""
    return ops.where(geared(p), gear_torque(x, p), driving) + stop_torque(x, p)


def derivatives(t, x, u, p):
    bristle = bristle_rate(x, p)
    driving = u.torque - friction_torque(x, bristle, p)
    hub, modal = accelerations(hub_torque(x, driving, p), modal_forces(x, p), p)
    motor = (driving - gear_torque(x, p)) / motor_inertia(p)
    rates = {f"deflection_{i}": rate for i, rate in zip(MODES, deflection_rates(x), strict=True)}
    rates |= {f"deflection_rate_{i}": rate for i, rate in zip(MODES, modal, strict=True)}
    return rates | {
        "angle": x.speed,
        "speed": hub,
        "motor_angle": x.motor_speed,
        "motor_speed": ops.where(geared(p), motor, hub),
        "bristle": bristle,
        "stop_time": ops.where(ops.absolute(x.angle) > p.stop_angle, 1.0, 0.0),
    }


def strain(position, x, p):
    """(h/2) w'': phi'' = (beta/L)^2 (cosh + cos - sigma (sinh + sin)) of beta x/L; no further out than at the tip."""
    shapes = []
    for b, sigma in zip(BETA, SIGMA, strict=True):
        along = b * ops.minimum(position / p.length, 1.0)
        hyperbolic = 0.5 * (1 - sigma) * ops.exp(along) + 0.5 * (1 + sigma) * ops.exp(-along)
        shapes.append((b / p.length) ** 2 * (hyperbolic + ops.cos(along) - sigma * ops.sin(along)))
    return 0.5 * p.thickness * dot(shapes, deflections(x))


def outputs(t, x, u, p):
    rubbing = friction_torque(x, bristle_rate(x, p), p)
    hub, modal = accelerations(hub_torque(x, u.torque - rubbing, p), modal_forces(x, p), p)
    return {
        "base_strain": strain(p.base_gauge, x, p),
        "middle_strain": strain(p.middle_gauge, x, p),
        "tip_position": at_tip(x.angle, deflections(x), p),
        "tip_acceleration": at_tip(hub, modal, p),
        "friction_torque": rubbing,
        "stop_torque": stop_torque(x, p),
        "gear_twist": x.motor_angle - x.angle,
    }


def solver_step(p):
    """0.4 over a frequency above all modes: the root of the trace of M^-1 K, with the springs at the hub.

    The trace is taken without the tip mass, which makes it smaller.
    """
    at_hub = (p.stop_stiffness + ops.where(geared(p), p.gear_stiffness, p.bristle_stiffness)) / free_inertia(p)
    at_motor = ops.where(geared(p), (p.gear_stiffness + p.bristle_stiffness) / motor_inertia(p), 0.0)
    inverse = [1 / beam_mass(p) + (s * p.length) ** 2 / free_inertia(p) for s in MOMENT]
    return 0.4 / ops.sqrt(at_hub + at_motor + dot(modal_stiffness(p), inverse))


# The rig of the flexible-manipulator thesis. Its hardware is gone: values marked "fitted" reproduce figures that it
# reports, so agreement with those figures proves nothing.
BEAM = (  # 1 m of 51 mm x 3 mm aluminium 6061-T6 (thesis, Section 2.3): E = 68.9 GPa, 2700 kg/m3
    parameter("bending_stiffness", "N.m2", 7.906, "Bending stiffness of the beam (EI)", minimum=1e-6),
    parameter("mass_per_length", "kg/m", 0.4131, "Mass of the beam per length (rho A)", minimum=1e-6),
    parameter("length", "m", 1.0, "Length of the beam (L)", minimum=1e-3),
    parameter("thickness", "m", 0.003, "Thickness of the beam (h)", minimum=0),
)
BODIES = (  # fitted to the modes at 0 g and 300 g, 9.02 Hz to 46.05 Hz and 7.64 Hz to 41.3 Hz
    parameter("hub_inertia", "kg.m2", 0.003, "Inertia of the hub with motor and gear (J_h)", minimum=1e-9),
    parameter("tip_fixture", "kg", 0.02, "Mass of the fixture that holds the payload", minimum=0),
    parameter("payload", "kg", 0.0, "Mass of the payload at the tip (m_p)", minimum=0),
)
DAMPING = tuple(  # these give ratios of .012, .028, .025, .02, .02 to the modes of the arm at 0 g (fitted)
    parameter(f"damping_{i}", "1", ratio, f"Damping ratio of the beam's mode {i}, were its hub clamped", minimum=0)
    for i, ratio in zip(MODES, (0.00335, 0.01934, 0.02202, 0.02011, 0.02044), strict=True)
)
GAUGES = (
    parameter("base_gauge", "m", 0.03, "Distance of the base gauge from the hub", minimum=0),
    parameter("middle_gauge", "m", 0.5, "Distance of the middle gauge from the hub", minimum=0),
)
FRICTION = (
    # The arm breaks away at 0.4 A (thesis, Section 2.4.3), times 0.5876 N m/A.
    parameter("coulomb_friction", "N.m", 0.235, "Dry friction (T_c)", minimum=1e-9),
    parameter("stribeck_friction", "N.m", 0.0, "Dry friction added near zero speed", minimum=0),
    parameter("stribeck_speed", "rad/s", 0.05, "Speed over which it and the bristles' damping fade (vs)", minimum=1e-6),
    # Fitted; it adds 0.62 times its value to the first mode's damping, so that 0.05 is more than the thesis found.
    parameter("viscous_friction", "N.m.s/rad", 0.03, "Viscous friction (c)", minimum=0),
    # Chosen: softer bristles (250) let a relay that compensates friction drive a chatter of 80 Hz.
    parameter("bristle_stiffness", "N.m/rad", 2000.0, "Stiffness of the bristles (s0)", minimum=1e-6),
    parameter("bristle_damping", "N.m.s/rad", 2.5, "Damping of the bristles (s1)", minimum=0),
)
GEAR = (
    parameter("backlash", "rad", 0.0, "Play of the gear; 0 is a rigid gear", minimum=0),
    parameter("gear_stiffness", "N.m/rad", 400.0, "Stiffness of a gear with play", minimum=1e-6),
    parameter(
        "motor_share", "1", 0.5, "Part of J_h on the motor's side of a gear with play", minimum=1e-3, maximum=0.999
    ),
)
STOPS = (  # at 80 degrees (thesis); as stiff as the bristles, so that the solver resolves them anyway
    parameter("stop_angle", "rad", math.radians(80), "Angle of the end stops, either side", minimum=1e-3),
    parameter("stop_stiffness", "N.m/rad", 2000.0, "Stiffness of the end stops", minimum=1e-6),
    # The bare hub leaves a stop with 0.40 of its speed (chosen).
    parameter("stop_damping", "1", 0.35, "Damping ratio of the bare hub on a stop", minimum=0, maximum=0.9),
)

MODEL = Model(
    name="flexible_arm",
    description="Flexible arm in the horizontal plane: beam on a hub with friction, end stops, play and a payload",
    variables=(
        input_("torque", "N.m", "Torque of the drive on the hub"),
        output("angle", "rad", "Angle of the hub, counter-clockwise"),
        output("speed", "rad/s", "Angular velocity of the hub"),
        output("base_strain", "1", "Strain of the beam's surface at the base gauge, (h/2) w''"),
        output("middle_strain", "1", "Strain of the beam's surface at the middle gauge, (h/2) w''"),
        output("tip_position", "m", "Where the tip is across the beam's rest position: L angle + w(L)"),
        output("tip_acceleration", "m/s2", "Acceleration of the tip across the beam"),
        output("motor_angle", "rad", "Angle of the motor's side of the gear; the hub's with a rigid gear"),
        output("motor_speed", "rad/s", "Angular velocity of the motor's side of the gear"),
        output(
            "gear_twist", "rad", "Lead of the motor's side of the gear; beyond half of the play its teeth are in touch"
        ),
        output("friction_torque", "N.m", "Torque of friction against the motion"),
        output("stop_torque", "N.m", "Torque of an end stop on the hub"),
        output("stop_time", "s", "How long an end stop was touched so far; 0 as long as none ever was"),
        *BEAM,
        *BODIES,
        *DAMPING,
        *GAUGES,
        *FRICTION,
        *GEAR,
        *STOPS,
        parameter("angle_start", "rad", 0.0, "Angle of hub and motor at the start"),
        parameter("speed_start", "rad/s", 0.0, "Angular velocity of hub and motor at the start"),
    ),
    ports=(port("shaft", "rotational", speed="motor_speed", torque="torque"),),
    states=(
        State("angle", "angle_start", "rad"),
        State("speed", "speed_start", "rad/s"),
        *(State(f"deflection_{i}", 0.0, "m", description=f"Deflection in the beam's mode {i} (q_{i})") for i in MODES),
        *(State(f"deflection_rate_{i}", 0.0, "m/s", description=f"Rate of q_{i}") for i in MODES),
        State("bristle", 0.0, "rad", description="Mean deflection of the bristles (z)"),
        State("motor_angle", "angle_start", "rad"),
        State("motor_speed", "speed_start", "rad/s"),
        State("stop_time", 0.0, "s"),
    ),
    derivatives=derivatives,
    outputs=outputs,
    solver_step=solver_step,
    references=(
        "Canudas de Wit, Olsson, Astrom, Lischinsky, IEEE Transactions on Automatic Control 40(3), 1995, pp. 419-425",
        "The flexible-manipulator thesis, Section 2.3",
    ),
)
