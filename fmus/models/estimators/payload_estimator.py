"""The payload at the tip of a flexible arm, from its command, speed and strain while it speeds up.

With w the hub's speed and d the deflection of the tip, which the strain tells as if the tip alone bent the beam,

    torque - J w' - beam d'' = payload radius (radius w' + d''),
    torque = torque_per_volt voltage - coulomb sign(w) - c w

All of it passes a low-pass of three poles, and the payload is the least-squares ratio of both sides with a memory that
fades. Only motion that speeds up is looked at, where the direction of friction is beyond doubt. The payload is known
once so much acceleration of the tip was seen that `torque_error`, over the root of its square's integral and over the
radius, is an error below `accuracy`; until then it is that at the start. It begins with an arm at rest. Outputs change
one sample after the inputs, so that a controller can go by the payload without a loop.
"""

import math

from . import Model, State, input_, ops, output, parameter

POLES = (1, 2, 3)
FILTERED = {"turning": "rad/s2", "bending": "m/s2", "driving": "N.m"}


def torque(speed, u, p):
    """What turns the arm until the next sample [N m]."""
    friction = p.coulomb_friction * ops.sign(speed) + p.viscous_friction * speed
    return p.torque_per_volt * u.voltage - friction


def passed(name, value, x, p):
    """New values of a low-pass's states; the last is what comes out."""
    rate = 1 - ops.exp(-2 * math.pi * p.cutoff * p.sample_time)
    states = {}
    for pole in POLES:
        before = getattr(x, f"{name}_{pole}")
        value = before + rate * (value - before)
        states[f"{name}_{pole}"] = value
    return states


def update(t, x, u, p):
    speed = u.speed / p.tachometer
    tip = p.deflection_per_volt * u.strain
    bent = (tip - x.tip_before) / p.sample_time
    gained = {
        "turning": (speed - x.speed_before) / p.sample_time,
        "bending": (bent - x.bent_before) / p.sample_time,
        "driving": x.torque_before,
    }
    states = {key: new for name, value in gained.items() for key, new in passed(name, value, x, p).items()}
    turning, bending, driving = (states[f"{name}_{POLES[-1]}"] for name in FILTERED)
    tip_acceleration = p.radius * turning + bending
    rest = driving - p.inertia * turning - p.beam * bending
    moving = ops.both(ops.absolute(u.speed) > p.speed_band, tip_acceleration * speed > 0)
    looked_at = ops.where(moving, p.sample_time, 0.0)
    kept = ops.exp(-looked_at / p.memory)
    seen = kept * x.seen + looked_at * tip_acceleration**2
    product = kept * x.product + looked_at * tip_acceleration * rest
    known = ops.both(seen > 0, seen * (p.accuracy * p.radius) ** 2 >= p.torque_error**2)
    payload = product / (p.radius * ops.maximum(seen, 1e-12))
    return states | {
        "speed_before": speed,
        "tip_before": tip,
        "bent_before": bent,
        "torque_before": torque(speed, u, p),
        "seen": seen,
        "product": product,
        "payload": ops.where(known, ops.clip(payload, 0.0, p.largest_payload), x.payload),
        "known": ops.where(known, 1.0, x.known),
    }


# The rig of the flexible-manipulator thesis: the drive's 0.5 A/V times 0.5876 N m/A; hub, beam and tip fixture; and the
# middle gauge, 10 kV per strain h/2 w'': a force at the tip bends by 2/3 L^3/(h (L - x)) per strain at x, and the beam
# so bent has 11/40 of its mass times L as angular momentum per d'.
MODEL = Model(
    name="payload_estimator",
    description="Least-squares estimate of an arm's payload while it moves",
    variables=(
        input_("voltage", "V", "Command to the drive, within its limit"),
        input_("speed", "V", "Measured speed, in volts of its sensor"),
        input_("strain", "V", "Measured strain, in volts of its gauge"),
        output("payload", "kg", "Payload; that at the start until it is known"),
        output("known", "1", "1 once enough was seen to tell the payload"),
        parameter("torque_per_volt", "N.m/V", 0.2938, "Torque of the drive per volt", minimum=1e-12),
        parameter("tachometer", "V.s/rad", 0.4, "Volts of the measured speed per rad/s", minimum=1e-12),
        parameter("inertia", "kg.m2", 0.1607, "Moment of inertia of what turns without a payload", minimum=0),
        parameter("beam", "kg.m", 0.1336, "Angular momentum without a payload per rate of the tip's deflection"),
        parameter("deflection_per_volt", "m/V", 0.04444, "Deflection of the tip per volt of the measured strain"),
        parameter("radius", "m", 1.0, "Distance of the payload from the axis", minimum=1e-6),
        parameter("coulomb_friction", "N.m", 0.235, "Dry friction", minimum=0),
        parameter("viscous_friction", "N.m.s/rad", 0.03, "Viscous friction", minimum=0),
        parameter("cutoff", "Hz", 2.0, "Of the low-pass; below the first flexible mode", minimum=1e-6),
        parameter("speed_band", "V", 0.05, "Speed above which the arm moves", minimum=0),
        parameter("memory", "s", 30.0, "Of motion, in which what was seen fades by e", minimum=1e-6),
        parameter("accuracy", "kg", 0.02, "Standard deviation at which the payload counts as known", minimum=1e-9),
        parameter("torque_error", "N.m", 0.004, "What the filtered torque is wrong by over a second", minimum=0),
        parameter("payload_start", "kg", 0.2, "Payload at the start", minimum=0),
        parameter("largest_payload", "kg", 0.6, "Largest payload that is believed", minimum=0),
        parameter("sample_time", "s", 1 / 300, "Sample period", minimum=1e-6),
    ),
    states=(
        *(State(f"{name}_{pole}", 0.0, unit, sampled=True) for name, unit in FILTERED.items() for pole in POLES),
        State("speed_before", 0.0, "rad/s", sampled=True),
        State("tip_before", 0.0, "m", sampled=True),
        State("bent_before", 0.0, "m/s", sampled=True),
        State("torque_before", 0.0, "N.m", sampled=True),
        State("seen", 0.0, sampled=True, description="Integral of the square of the acceleration of the tip"),
        State("product", 0.0, sampled=True, description="Integral of that acceleration times the torque"),
        State("payload", "payload_start", "kg", sampled=True),
        State("known", 0.0, sampled=True),
    ),
    update=update,
    sample_time="sample_time",
    plant=True,
)
