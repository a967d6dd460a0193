"""A sampled position controller: PD with feedback of the measured speed, and compensation of dry friction.

    effort = kp (reference - position) - kd speed,   voltage = effort + compensation, within the limits

The compensation has a constant height and the sign of the effort (as published), of the speed or of the error. Within
its bands there is none (Eq. 4-8), so that it does not make the arm hunt where it should rest; bands of 0 hold nothing.
"""

from . import Model, State, input_, ops, output, parameter

SIGNS = ("none", "effort", "speed", "error")
GAINS = ("V/V", "A/V")


def error(u):
    return u.reference - u.position


def effort(u, p):
    """What the gains ask for [V]; where they give amperes, by the drive's constant."""
    asked = p.kp * error(u) - p.kd * u.speed
    return ops.where(p.gains > 1.5, asked / p.amperes_per_volt, asked)


def sign(u, p):
    """Of what the compensation goes by; an effort of 0 counts as positive, as in Eq. 4-8."""
    by_effort = ops.where(effort(u, p) < 0, -1.0, 1.0)
    by_motion = ops.where(p.compensated_by > 3.5, ops.sign(error(u)), ops.sign(u.speed))
    return ops.where(p.compensated_by > 2.5, by_motion, ops.where(p.compensated_by > 1.5, by_effort, 0.0))


def compensation(u, p):
    """Zero while both error and speed lie within their bands."""
    full = p.compensation_voltage * sign(u, p)
    slow = ops.where(ops.absolute(u.speed) < p.speed_band, 0.0, full)
    return ops.where(ops.absolute(error(u)) < p.error_band, slow, full)


def update(t, x, u, p):
    voltage = ops.clip(effort(u, p) + compensation(u, p), -p.voltage_limit, p.voltage_limit)
    return {"voltage": voltage, "effort": effort(u, p), "compensation": compensation(u, p)}


MODEL = Model(
    name="pd",
    description="Sampled PD controller with compensation of dry friction",
    variables=(
        input_("reference", "V", "Wanted position, in volts of its sensor"),
        input_("position", "V", "Measured position"),
        input_("speed", "V", "Measured speed, in volts of its sensor"),
        output("voltage", "V", "Command to the drive: effort and compensation, held between samples"),
        output("effort", "V", "What the gains ask for: the input for identification with compensation removed"),
        output("compensation", "V", "What is added against dry friction"),
        # Gains of the thesis' closed-loop experiments (Table A-3); whether they are V/V or A/V it does not say.
        parameter("kp", "1", 1.0, "Gain of the position's error"),
        parameter("kd", "1", 2.8, "Gain of the speed"),
        parameter("gains", "1", 1, "What the gains give per volt", minimum=1, maximum=len(GAINS), choices=GAINS),
        parameter("amperes_per_volt", "A/V", 0.5, "The drive's constant, for gains in A/V", minimum=1e-9),
        parameter(
            "compensated_by", "1", 1, "Whose sign the compensation has", minimum=1, maximum=len(SIGNS), choices=SIGNS
        ),
        parameter("compensation_voltage", "V", 0.8, "Height of the compensation", minimum=0),
        parameter("error_band", "V", 0.0, "Error below which there is no compensation", minimum=0),
        parameter("speed_band", "V", 0.0, "Speed below which there is no compensation", minimum=0),
        parameter("sample_time", "s", 1 / 300, "Sample period", minimum=1e-6),
        parameter("voltage_limit", "V", 10.0, "Largest command, either sign", minimum=0),
    ),
    states=(
        State("voltage", 0.0, "V", sampled=True),
        State("effort", 0.0, "V", sampled=True),
        State("compensation", 0.0, "V", sampled=True),
    ),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 2.4.3, Eqs. 4-6 to 4-8 without strain, Table A-3",),
)
