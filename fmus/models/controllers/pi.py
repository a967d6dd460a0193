"""A sampled position controller with proportional and integral gain, as in Fig. 4-1 of the thesis.

    voltage = kp e[k] + ki T (e[0] + ... + e[k]),   e = reference - position

that is kp + ki T z / (z - 1). In the thesis' figures the integral is one over seconds, not a sum over samples.
"""

from . import Model, control, input_, parameter


def update(t, x, u, p):
    error = u.reference - u.position
    proportional = control.in_volts(p.kp * error, p)
    integral = control.integral(proportional, control.in_volts(p.ki * p.sample_time * error, p), x, u, p)
    return control.command(proportional + integral, u.manual, x, u, p) | {"integral": integral}


MODEL = Model(
    name="pi",
    description="Sampled PI controller",
    variables=(
        input_("reference", "V", "Wanted position, in volts of its sensor"),
        input_("position", "V", "Measured position"),
        control.ENABLED,
        control.MANUAL,
        *control.VOLTAGE,
        # The optimum on the model of order 8 from closed-loop experiments (Table 4-1).
        parameter("kp", "1", 0.3998, "Gain of the position's error", tunable=True),
        parameter("ki", "1/s", 0.0178, "Gain of the error's integral", tunable=True),
        *control.UNIT_OF_GAINS,
        control.ANTI_WINDUP,
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(*control.STATES, control.INTEGRAL),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 4.1, Fig. 4-1, Table 4-1",),
)
