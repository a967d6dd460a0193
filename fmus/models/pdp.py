"""A sampled position controller with feedback of the measured speed and of the strain, which damps the vibration.

voltage = kp (reference - position) - kd speed - ks strain   (Eq. 4-7), within the limit
"""

from . import Model, State, control, input_, output, parameter


def update(t, x, u, p):
    effort = control.in_volts(p.kp * (u.reference - u.position) - p.kd * u.speed - p.ks * u.strain, p)
    offset = control.offset(effort, u.manual, x, u, p)
    return control.command(effort + offset, u.manual, x, u, p) | {"effort": effort, "offset": offset}


MODEL = Model(
    name="pdp",
    description="Sampled PD controller with feedback of the strain (PDP)",
    variables=(
        input_("reference", "V", "Wanted position, in volts of its sensor"),
        input_("position", "V", "Measured position"),
        input_("speed", "V", "Measured speed, in volts of its sensor"),
        input_("strain", "V", "Measured strain in the middle of the arm, in volts of its gauge"),
        control.ENABLED,
        control.MANUAL,
        *control.VOLTAGE,
        output("effort", "V", "What the gains ask for"),
        # The optimum over 0, 200 and 400 g (Table 4-2).
        parameter("kp", "1", 0.5935, "Gain of the position's error"),
        parameter("kd", "1", 4.2664, "Gain of the speed"),
        parameter("ks", "1", 0.2538, "Gain of the strain"),
        *control.UNIT_OF_GAINS,
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(*control.STATES, State("effort", 0.0, "V", sampled=True), control.OFFSET),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 4.2, Eqs. 4-2, 4-7, Table 4-2",),
)
