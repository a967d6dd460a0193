"""What sampled controllers share: a command within limits, taken over without a jump; the integral; dry friction.

While `enabled` is 0 the command is what bypasses the controller, and at the instant at which it is enabled still.
From then on an integral that begins where this needs it, or an offset that fades, makes up for the difference. The file
travels inside every Python FMU.
"""

import math
from typing import Any

from . import ops
from .model import Named, State, input_, output, parameter

GAINS = ("V/V", "A/V")
WINDUP = ("none", "clamping")

ENABLED = input_("enabled", "1", "Whether the controller acts; 0 bypasses it", 1.0)
MANUAL = input_("manual", "V", "Command while the controller is not enabled")
VOLTAGE = (
    output("voltage", "V", "Command to the drive, within its limit, held between samples"),
    output("saturated", "1", "1 while the command is at its limit and more is asked for"),
)
MEASURED = (
    input_("reference", "V", "Wanted position, in volts of its sensor"),
    input_("position", "V", "Measured position"),
    input_("speed", "V", "Measured speed, in volts of its sensor"),
    input_("strain", "V", "Measured strain in the middle of the arm, in volts of its gauge"),
)
GAINS_OF_PDP = (  # the optimum over 0, 200 and 400 g (Table 4-2)
    parameter("kp", "1", 0.5935, "Gain of the position's error"),
    parameter("kd", "1", 4.2664, "Gain of the speed"),
    parameter("ks", "1", 0.2538, "Gain of the strain"),
)
FRICTION = (
    parameter("compensation_voltage", "V", 0.7, "Height of the compensation of dry friction", minimum=0),
    parameter("error_band", "V", 0.05, "Error below which there is no compensation; 0: always", minimum=0),
    parameter("speed_band", "V", 0.05, "Speed below which there is no compensation; 0: always", minimum=0),
    parameter(
        "waking_band", "V", 0.0, "Error below which a compensation that rests stays away; 0: as above", minimum=0
    ),
    parameter("speed_cutoff", "Hz", 0.0, "Of a low-pass of the measured speed; 0: none", minimum=0),
)
UNIT_OF_GAINS = (
    parameter("gains", "1", 1, "What the gains give per volt", minimum=1, maximum=len(GAINS), choices=GAINS),
    parameter("amperes_per_volt", "A/V", 0.5, "The drive's constant, for gains in A/V", minimum=1e-9),
)
ANTI_WINDUP = parameter(
    "anti_windup", "1", 1, "What holds the integral at the limit", minimum=1, maximum=len(WINDUP), choices=WINDUP
)
TRANSFER_TIME = parameter("transfer_time", "s", 0.2, "In which a jump on enabling fades by e", minimum=1e-6)
LIMITS = (
    parameter("sample_time", "s", 1 / 300, "Sample period", minimum=1e-6),
    parameter("voltage_limit", "V", 10.0, "Largest command, either sign", minimum=0),
)
STATES = (
    State("voltage", 0.0, "V", sampled=True),
    State("saturated", 0.0, sampled=True),
    State("was_enabled", 1.0, sampled=True, description="Whether the controller was enabled at the last sample"),
)
INTEGRAL = State("integral", 0.0, "V", sampled=True, description="Part of the command that the integral gives")
OF_FRICTION = (
    State("compensation", 0.0, "V", sampled=True),
    State("resting", 0.0, sampled=True, description="Whether the compensation rests"),
    State("smooth_speed", 0.0, "V", sampled=True, description="Speed behind its low-pass"),
    State("reference_before", 0.0, "V", sampled=True, description="Reference at the last sample"),
)
OFFSET = State("offset", 0.0, "V", sampled=True, description="What fades after the controller was enabled")


def running(x: Any, u: Any) -> Any:
    """Whether it is enabled, and was at the sample before."""
    return ops.both(u.enabled > 0.5, x.was_enabled > 0.5)


def limited(voltage: Any, p: Any) -> Any:
    return ops.clip(voltage, -p.voltage_limit, p.voltage_limit)


def command(asked: Any, bypass: Any, x: Any, u: Any, p: Any) -> Named:
    """New values of STATES, where a law asks for a voltage [V] and `bypass` is the command without it."""
    wanted = ops.where(running(x, u), asked, bypass)
    return {
        "voltage": limited(wanted, p),
        "saturated": ops.where(ops.absolute(wanted) > p.voltage_limit, 1.0, 0.0),
        "was_enabled": ops.where(u.enabled > 0.5, 1.0, 0.0),
    }


def fading(p: Any) -> Any:
    """Of what fades with the transfer time, the part that is left after a sample."""
    return ops.exp(-p.sample_time / p.transfer_time)


def offset(asked: Any, bypass: Any, x: Any, u: Any, p: Any) -> Any:
    """New value of OFFSET, to be added to what a law without an integral asks for."""
    return ops.where(running(x, u), x.offset * fading(p), limited(bypass, p) - asked)


def integral(rest: Any, growth: Any, x: Any, u: Any, p: Any) -> Any:
    """New value of INTEGRAL, which grows at every sample, in a law that asks for it and the `rest`.

    With clamping it stands still while the command is at its limit and would go further. Without a gain (ki) it
    fades, as an offset does.
    """
    grown = x.integral + growth
    beyond = ops.both(ops.absolute(rest + grown) > p.voltage_limit, (rest + grown) * growth > 0)
    kept = ops.where(ops.both(p.anti_windup > 1.5, beyond), x.integral, grown)
    going_on = ops.where(ops.absolute(p.ki) > 0, kept, x.integral * fading(p))
    return ops.where(running(x, u), going_on, limited(u.manual, p) - rest)


def in_volts(asked: Any, p: Any) -> Any:
    """What the gains ask for [V]; where they give amperes, by the drive's constant."""
    return ops.where(p.gains > 1.5, asked / p.amperes_per_volt, asked)


def side(effort: Any) -> Any:
    """The sign of an effort; 0 counts as positive, as in Eq. 4-8."""
    return ops.where(effort < 0, -1.0, 1.0)


def arrived(error: Any, speed: Any, p: Any) -> Any:
    """Whether both lie within the bands in which there is no compensation (Eq. 4-8)."""
    return ops.both(ops.absolute(error) < p.error_band, ops.absolute(speed) < p.speed_band)


def compensation(sign: Any, error: Any, speed: Any, p: Any) -> Any:
    """Against dry friction [V], with this sign: zero where the arm has arrived (Eq. 4-8)."""
    return ops.where(arrived(error, speed, p), 0.0, p.compensation_voltage * sign)


def smooth_speed(x: Any, u: Any, p: Any) -> Any:
    """The measured speed [V] behind a low-pass of one pole, or as it is."""
    kept = ops.where(p.speed_cutoff > 0, ops.exp(-2 * math.pi * p.speed_cutoff * p.sample_time), 0.0)
    return u.speed + kept * (x.smooth_speed - u.speed)


def compensated(effort: Any, error: Any, speed: Any, x: Any, u: Any, p: Any) -> Named:
    """New values of STATES, OF_FRICTION and OFFSET, where to an effort [V] comes a compensation of its sign (Eq. 4-6).

    The compensation rests while both error and speed lie within their bands (Eq. 4-8), and then for as long as the
    error stays below `waking_band` and the reference where it is.
    """
    close = ops.both(x.resting > 0.5, ops.absolute(error) < p.waking_band)
    asleep = ops.both(close, ops.absolute(u.reference - x.reference_before) <= 0)
    resting = ops.where(arrived(error, speed, p), 1.0, ops.where(asleep, 1.0, 0.0))
    added = ops.where(resting > 0.5, 0.0, p.compensation_voltage * side(effort))
    fading_offset = offset(effort + added, u.manual, x, u, p)
    return command(effort + added + fading_offset, u.manual, x, u, p) | {
        "compensation": added,
        "resting": resting,
        "smooth_speed": speed,
        "reference_before": u.reference,
        "offset": fading_offset,
    }
