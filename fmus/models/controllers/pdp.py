"""A sampled position controller with feedback of the measured speed and of the strain, which damps the vibration.

voltage = kp (reference - position) - kd speed - ks strain   (Eq. 4-7), within the limit
"""

from . import Model, State, control, output


def update(t, x, u, p):
    effort = control.in_volts(p.kp * (u.reference - u.position) - p.kd * u.speed - p.ks * u.strain, p)
    offset = control.offset(effort, u.manual, x, u, p)
    return control.command(effort + offset, u.manual, x, u, p) | {"effort": effort, "offset": offset}


MODEL = Model(
    name="pdp",
    description="Sampled PD controller with feedback of the strain (PDP)",
    variables=(
        *control.MEASURED,
        control.ENABLED,
        control.MANUAL,
        *control.VOLTAGE,
        output("effort", "V", "What the gains ask for"),
        *control.GAINS_OF_PDP,
        *control.UNIT_OF_GAINS,
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(*control.STATES, State("effort", 0.0, "V", sampled=True), control.OFFSET),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 4.2, Eqs. 4-2, 4-7, Table 4-2",),
)
