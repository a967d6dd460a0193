"""A sampled position controller: PD with feedback of the measured speed, and compensation of dry friction.

    effort = kp (reference - position) - kd speed,   voltage = effort + compensation, within the limits

The compensation has a constant height and the sign of the effort (as published), of the speed or of the error. Within
its bands there is none (Eq. 4-8), so that it does not make the arm hunt where it should rest; bands of 0 hold nothing.
"""

from . import Model, State, control, input_, ops, output, parameter

SIGNS = ("none", "effort", "speed", "error")


def error(u):
    return u.reference - u.position


def effort(u, p):
    return control.in_volts(p.kp * error(u) - p.kd * u.speed, p)


def sign(u, p):
    """Of what the compensation goes by."""
    by_motion = ops.where(p.compensated_by > 3.5, ops.sign(error(u)), ops.sign(u.speed))
    by_effort = ops.where(p.compensated_by > 1.5, control.side(effort(u, p)), 0.0)
    return ops.where(p.compensated_by > 2.5, by_motion, by_effort)


def compensation(u, p):
    return control.compensation(sign(u, p), error(u), u.speed, p)


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
        parameter("kp", "1", 1.0, "Gain of the position's error", tunable=True),
        parameter("kd", "1", 2.8, "Gain of the speed", tunable=True),
        *control.UNIT_OF_GAINS,
        parameter(
            "compensated_by", "1", 1, "Whose sign the compensation has", minimum=1, maximum=len(SIGNS), choices=SIGNS
        ),
        parameter("compensation_voltage", "V", 0.8, "Height of the compensation", minimum=0, tunable=True),
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
