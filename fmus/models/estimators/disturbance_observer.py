"""Compensation of friction by an observer of the torque that disturbs a rigid body.

    J w' = torque_per_volt voltage - c w + d,   d' = 0

The observer knows the command within its limits and the measured speed; both its poles lie at `bandwidth`. What it
takes d for is added to the effort, as the voltage that cancels it, up to `compensation_limit`.
"""

import math

from . import Model, State, control, input_, ops, output, parameter


def update(t, x, u, p):
    turn = p.sample_time / p.inertia
    decay = 1 - p.viscous_friction * turn
    pole = ops.exp(-2 * math.pi * p.bandwidth * p.sample_time)
    surprise = u.speed / p.tachometer - x.estimated_speed
    disturbance = x.disturbance + (1 - pole) ** 2 / turn * surprise
    cancelling = ops.clip(-disturbance / p.torque_per_volt, -p.compensation_limit, p.compensation_limit)
    offset = control.offset(u.effort + cancelling, u.effort, x, u, p)
    given = control.command(u.effort + cancelling + offset, u.effort, x, u, p)
    torque = p.torque_per_volt * given["voltage"] + x.disturbance
    predicted = decay * x.estimated_speed + turn * torque + (1 + decay - 2 * pole) * surprise
    return given | {
        "disturbance": disturbance,
        "estimated_speed": predicted,
        "compensation": given["voltage"] - u.effort,
        "offset": offset,
    }


# The rig of the flexible-manipulator thesis: the drive's 0.5 A/V times 0.5876 N m/A, hub, beam and tip fixture.
MODEL = Model(
    name="disturbance_observer",
    description="Compensation of friction by a disturbance observer",
    variables=(
        input_("effort", "V", "What a controller asks for"),
        input_("speed", "V", "Measured speed, in volts of its sensor"),
        control.ENABLED,
        *control.VOLTAGE,
        output("disturbance", "N.m", "Torque that disturbs, as estimated; friction is opposed to the motion"),
        output("compensation", "V", "What the command has beside the effort"),
        parameter("torque_per_volt", "N.m/V", 0.2938, "Torque of the drive per volt", minimum=1e-12),
        parameter("tachometer", "V.s/rad", 0.4, "Volts of the measured speed per rad/s", minimum=1e-12),
        parameter("inertia", "kg.m2", 0.1607, "Moment of inertia of what turns", minimum=1e-12),
        parameter("viscous_friction", "N.m.s/rad", 0.03, "Friction that is no disturbance", minimum=0),
        parameter("bandwidth", "Hz", 3.0, "Of the estimate; below the first flexible mode", minimum=1e-6),
        parameter("compensation_limit", "V", 1.0, "Largest compensation, either sign", minimum=0),
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(
        *control.STATES,
        State("disturbance", 0.0, "N.m", sampled=True),
        State("estimated_speed", 0.0, "rad/s", sampled=True),
        State("compensation", 0.0, "V", sampled=True),
        control.OFFSET,
    ),
    update=update,
    sample_time="sample_time",
    references=("Ohnishi, Shibata, Murakami, IEEE/ASME Transactions on Mechatronics 1(1), 1996, pp. 56-67",),
)
