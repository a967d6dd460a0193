"""Linear-quadratic Gaussian control of the position by an observer that is given all four sensors.

    voltage = kp reference + ki T (e[0] + ... + e[k]) - K x[k],   e = reference - position
    x[k+1] = A x[k] + B voltage[k] + L (y[k] - C x[k]),   y = (position, base strain, middle strain, speed)

A, B, C are a model of the plant from the command to the sensors, in the order of `y`, L a Kalman filter's gain in its
predicting form. kp is such that without the integral the position comes to the reference.
"""

from functools import lru_cache

from . import Model, control, feedback, input_, output, parameter


def update(t, x, u, p):
    return feedback.update([u.position, u.base_strain, u.middle_strain, u.speed], x, u, p)


@lru_cache(maxsize=32)
def lqg(order):
    """The controller for a plant of this order, its matrices zero."""
    return Model(
        name="lqg",
        description=f"Linear-quadratic Gaussian control by an observer of order {order} on four sensors",
        variables=(
            input_("reference", "V", "Wanted position, in volts of its sensor"),
            input_("position", "V", "Measured position"),
            input_("base_strain", "V", "Measured strain at the base of the arm"),
            input_("middle_strain", "V", "Measured strain in the middle of the arm"),
            input_("speed", "V", "Measured speed"),
            control.ENABLED,
            control.MANUAL,
            *control.VOLTAGE,
            output("estimate", "V", "Position that the observer expected"),
            parameter("kp", "1", 1.0, "Gain of the reference", tunable=True),
            parameter("ki", "1/s", 0.0, "Gain of the error's integral", tunable=True),
            control.ANTI_WINDUP,
            control.TRANSFER_TIME,
            *control.LIMITS,
            *feedback.parameters(order, sensors=4),
        ),
        states=feedback.states(order),
        update=update,
        sample_time="sample_time",
        call=f"lqg({order})",
        sized=lambda shapes: lqg(shapes["A"][0]),
        references=("Franklin, Powell, Workman, Digital Control of Dynamic Systems, 3rd ed., Chapter 9",),
    )


MODEL = lqg(2)
