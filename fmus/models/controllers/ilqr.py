"""Integral and linear-quadratic control of the position by an observer that is given the position alone (Fig. 4-13).

    voltage = kp reference + ki T (e[0] + ... + e[k]) - K x[k],   e = reference - position
    x[k+1] = A x[k] + B voltage[k] + L (position[k] - C x[k])

A, B, C are a model of the plant from the command to the position. kp is such that without the integral the position
comes to the reference. `ki` is one over seconds: the thesis' sum over samples, 0.0015, is 0.45/s at 300 Hz.
"""

from functools import lru_cache

from . import Model, control, feedback, input_, output, parameter


def update(t, x, u, p):
    return feedback.update([u.position], x, u, p)


@lru_cache(maxsize=32)
def ilqr(order):
    """The controller for a plant of this order, its matrices zero."""
    return Model(
        name="ilqr",
        description=f"Integral and linear-quadratic control by an observer of order {order} on the position",
        variables=(
            input_("reference", "V", "Wanted position, in volts of its sensor"),
            input_("position", "V", "Measured position"),
            control.ENABLED,
            control.MANUAL,
            *control.VOLTAGE,
            output("estimate", "V", "Position that the observer expected"),
            parameter("kp", "1", 0.7746, "Gain of the reference", tunable=True),
            parameter("ki", "1/s", 0.45, "Gain of the error's integral", tunable=True),
            control.ANTI_WINDUP,
            control.TRANSFER_TIME,
            *control.LIMITS,
            *feedback.parameters(order, sensors=1),
        ),
        states=feedback.states(order),
        update=update,
        sample_time="sample_time",
        call=f"ilqr({order})",
        sized=lambda shapes: ilqr(shapes["A"][0]),
        references=("The flexible-manipulator thesis, Section 4.4, Fig. 4-13",),
    )


MODEL = ilqr(2)
