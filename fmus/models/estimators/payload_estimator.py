"""The payload at the tip of a flexible arm, from its speed and strain while it moves.

With w the hub's speed and d the deflection of the tip, which the strain tells as if the tip alone bent the beam, the
beam's force on the payload is

    - stiffness d - turned_mass radius w' - bent_mass d'' = payload (radius w' + d''),

whatever turns the hub and whatever rubs there. All of it passes a low-pass of three poles, and the payload is the
least-squares ratio of both sides with a memory that fades, over the time in which the arm moves. It is given once so
much acceleration of the tip was seen that `force_error`, over the root of its square's integral S, is below
`first_error`; until then it is that at the start. Noise alone says too little at first, where the beam swings as the
strain does not tell: its interval is that of an estimate by what was seen after `start_up` of motion, and as much wider
as both differ. With S now and R, the square of what the payload leaves of the force, integrated over that time T,

    variance = force_error^2 / S + (R / S) / (T / correlation - 1) + mass_error^2:

of noise, of what does not fit, in pieces that hang together over `correlation`, and of what fits and is wrong. The
payload is known once half of the interval, 1.96 standard deviations and the difference, is no more than `accuracy`. It
begins with an arm at rest and straight. Outputs change one sample after the inputs, so that a controller can go by the
payload without a loop.
"""

import math

from . import Model, State, input_, ops, output, parameter

POLES = (1, 2, 3)
SURE = 1.96  # standard deviations in half of a 95 % interval
LATER = {"time": "s", "seen": "1", "product": "1", "square": "1"}
FILTERED = {"turning": "rad/s2", "bending": "m/s2", "bent": "m"}


def passed(name, value, x, p):
    """New values of a low-pass's states; the last is what comes out."""
    rate = 1 - ops.exp(-2 * math.pi * p.cutoff * p.sample_time)
    states = {}
    for pole in POLES:
        before = getattr(x, f"{name}_{pole}")
        value = before + rate * (value - before)
        states[f"{name}_{pole}"] = value
    return states


def half_width(payload, later, p):
    """Of the interval of a payload, by the integrals of what was seen later (time, seen, product, square)."""
    time, seen, product, square = later
    own = product / ops.maximum(seen, 1e-12)
    unexplained = ops.maximum(square - own * product, 0.0) * p.correlation / ops.maximum(time - p.correlation, 1e-9)
    variance = (p.force_error**2 + unexplained) / ops.maximum(seen, 1e-12) + p.mass_error**2
    return SURE * ops.sqrt(variance) + ops.absolute(payload - own)


def update(t, x, u, p):
    speed = u.speed / p.tachometer
    tip = p.deflection_per_volt * u.strain
    rate = (tip - x.tip_before) / p.sample_time
    gained = {
        "turning": (speed - x.speed_earlier) / (2 * p.sample_time),
        "bending": (rate - x.rate_before) / p.sample_time,
        "bent": x.tip_before,
    }  # all as they were one sample ago
    states = {key: new for name, value in gained.items() for key, new in passed(name, value, x, p).items()}
    turning, bending, bent = (states[f"{name}_{POLES[-1]}"] for name in FILTERED)
    acceleration = p.radius * turning + bending
    force = -p.stiffness * bent - p.turned_mass * p.radius * turning - p.bent_mass * bending
    looked_at = ops.where(ops.absolute(u.speed) > p.speed_band, p.sample_time, 0.0)
    kept = ops.exp(-looked_at / p.memory)
    seen = kept * x.seen + looked_at * acceleration**2
    product = kept * x.product + looked_at * acceleration * force
    counted = ops.where(x.moved > p.start_up, looked_at, 0.0)
    later = {
        "later_time": kept * x.later_time + counted,
        "later_seen": kept * x.later_seen + counted * acceleration**2,
        "later_product": kept * x.later_product + counted * acceleration * force,
        "later_square": kept * x.later_square + counted * force**2,
    }
    payload = product / ops.maximum(seen, 1e-12)
    width = half_width(payload, later.values(), p)
    given = ops.both(seen > 0, seen * p.first_error**2 >= p.force_error**2)
    telling = ops.both(later["later_time"] > p.correlation, width <= p.largest_payload)
    known = ops.both(given, ops.both(telling, width <= p.accuracy))
    return (
        states
        | later
        | {
            "speed_before": speed,
            "speed_earlier": x.speed_before,
            "tip_before": tip,
            "rate_before": rate,
            "seen": seen,
            "product": product,
            "moved": x.moved + looked_at,
            "payload": ops.where(given, ops.clip(payload, 0.0, p.largest_payload), x.payload),
            "half_width": ops.where(ops.both(given, telling), width, x.half_width),
            "given": ops.where(given, 1.0, x.given),
            "known": ops.where(known, 1.0, x.known),
        }
    )


# The rig of the flexible-manipulator thesis: hub, beam and tip fixture; and the middle gauge, 10 kV per strain h/2 w'':
# a force at the tip bends by 2/3 L^3/(h (L - x)) per strain at x, and by L^3/(3 EI) of its own. The beam beyond a gauge
# in the middle takes as much moment there as 5/24 of its mass at the tip where the arm turns, and as 0.18906 of it
# where it bends as a force at the tip would have it.
MODEL = Model(
    name="payload_estimator",
    description="Least-squares estimate of an arm's payload while it moves",
    variables=(
        input_("speed", "V", "Measured speed, in volts of its sensor"),
        input_("strain", "V", "Measured strain, in volts of its gauge"),
        output("payload", "kg", "Payload; that at the start until there is an estimate"),
        output("half_width", "kg", "Half of its 95 % interval; the largest payload until that tells more"),
        output("given", "1", "1 once there is an estimate, be it rough"),
        output("known", "1", "1 once the interval was as narrow as asked for"),
        parameter("tachometer", "V.s/rad", 0.4, "Volts of the measured speed per rad/s", minimum=1e-12),
        parameter("deflection_per_volt", "m/V", 0.04444, "Deflection of the tip per volt of the measured strain"),
        parameter("stiffness", "N/m", 23.718, "Force at the tip per deflection", minimum=1e-12),
        parameter("turned_mass", "kg", 0.1061, "What beam and fixture weigh at the tip where the arm turns", minimum=0),
        parameter("bent_mass", "kg", 0.0981, "What they weigh there where the beam bends", minimum=0),
        parameter("radius", "m", 1.0, "Distance of the payload from the axis", minimum=1e-6),
        parameter("cutoff", "Hz", 1.0, "Of the low-pass; below the first flexible mode", minimum=1e-6),
        parameter("speed_band", "V", 0.05, "Speed above which the arm moves", minimum=0),
        parameter("memory", "s", 30.0, "Of motion, in which what was seen fades by e", minimum=1e-6),
        parameter("first_error", "kg", 0.01, "Standard deviation, of noise, at which it is given", minimum=1e-9),
        parameter("accuracy", "kg", 0.02, "Half of the 95 % interval at which it is known", minimum=1e-9),
        parameter("force_error", "N", 0.001, "What noise makes of the filtered force over a second", minimum=0),
        parameter("start_up", "s", 0.15, "Of motion, that tells nothing of the interval", minimum=0),
        parameter("correlation", "s", 0.02, "Over which what does not fit hangs together", minimum=0),
        parameter("mass_error", "kg", 0.005, "Standard deviation that masses and stiffness leave", minimum=0),
        parameter("payload_start", "kg", 0.2, "Payload at the start", minimum=0),
        parameter("largest_payload", "kg", 0.6, "Largest payload that is believed", minimum=0),
        parameter("sample_time", "s", 1 / 300, "Sample period", minimum=1e-6),
    ),
    states=(
        *(State(f"{name}_{pole}", 0.0, unit, sampled=True) for name, unit in FILTERED.items() for pole in POLES),
        State("speed_before", 0.0, "rad/s", sampled=True),
        State("speed_earlier", 0.0, "rad/s", sampled=True),
        State("tip_before", 0.0, "m", sampled=True),
        State("rate_before", 0.0, "m/s", sampled=True),
        State("seen", 0.0, sampled=True, description="Integral of the square of the acceleration of the tip"),
        State("product", 0.0, sampled=True, description="Integral of that acceleration times the force"),
        State("moved", 0.0, "s", sampled=True, description="For how long the arm has moved"),
        *(State(f"later_{name}", 0.0, unit, sampled=True) for name, unit in LATER.items()),
        State("payload", "payload_start", "kg", sampled=True),
        State("half_width", "largest_payload", "kg", sampled=True),
        State("given", 0.0, sampled=True),
        State("known", 0.0, sampled=True),
    ),
    update=update,
    sample_time="sample_time",
    plant=True,
)
