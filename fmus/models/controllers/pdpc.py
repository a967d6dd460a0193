"""A PDP controller with compensation of dry friction, which rests where the arm has arrived.

    effort = kp (reference - position) - kd speed - ks strain   (Eq. 4-7)
    voltage = effort + compensation   (Eq. 4-6), within the limit

The compensation has a constant height and the effort's sign; within its bands of error and speed there is none
(Eq. 4-8). Bands of 0 make it unconditional, which hunts at the set-point. With play in the gear every hit takes the
speed out of its band: `waking_band` keeps the compensation away until the error has grown, and `speed_cutoff` keeps the
hits out of the effort.
"""

from . import Model, State, control, output


def update(t, x, u, p):
    error, speed = u.reference - u.position, control.smooth_speed(x, u, p)
    effort = control.in_volts(p.kp * error - p.kd * speed - p.ks * u.strain, p)
    return control.compensated(effort, error, speed, x, u, p) | {"effort": effort}


MODEL = Model(
    name="pdpc",
    description="Sampled PDP controller with conditional compensation of dry friction (PDPC)",
    variables=(
        *control.MEASURED,
        control.ENABLED,
        control.MANUAL,
        *control.VOLTAGE,
        output("effort", "V", "What the gains ask for"),
        output("compensation", "V", "What is added against dry friction"),
        *control.GAINS_OF_PDP,
        *control.UNIT_OF_GAINS,
        *control.FRICTION,
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(
        *control.STATES,
        State("effort", 0.0, "V", sampled=True),
        *control.OF_FRICTION,
        control.OFFSET,
    ),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 4.3, Eqs. 4-6 to 4-8",),
)
