"""A current-controlled drive: the command voltage sets the motor's current, and the current its torque.

Its electrical dynamics are far above those of the mechanisms that it drives, and are left out:

    current = amperes_per_volt * (command within its limits),   torque = torque_constant * gear_ratio * current
"""

from . import Model, input_, ops, output, parameter

DIRECTIONS = ("counter-clockwise", "clockwise")


def current(u, p):
    """The hardware takes sign and height of the command over two channels; a clockwise drive swaps the signs."""
    command = ops.clip(u.voltage, -p.voltage_limit, p.voltage_limit)
    return p.amperes_per_volt * ops.where(p.direction > 1.5, -command, command)


def outputs(t, x, u, p):
    amperes = current(u, p)
    return {"torque": p.torque_constant * p.gear_ratio * amperes, "current": amperes}


# The rig of the flexible-manipulator thesis, Section 2.3: Figure 2-2 has 0.5 A/V up to 10 V. The stall torque is
# 2.938 N m; that it is reached at 5 A is assumed, and refers the torque constant to the hub: the gear's ratio is 1.
MODEL = Model(
    name="servo_drive",
    description="Drive whose current, and with it the torque, follows a command voltage",
    variables=(
        input_("voltage", "V", "Command; its sign is the direction"),
        output("torque", "N.m", "Torque behind the gear"),
        output("current", "A", "Current of the motor"),
        parameter("amperes_per_volt", "A/V", 0.5, "Current per volt of the command"),
        parameter("voltage_limit", "V", 10.0, "Largest command that is followed, either sign", minimum=0),
        parameter(
            "direction",
            "1",
            1,
            "Where a positive command turns",
            minimum=1,
            maximum=len(DIRECTIONS),
            choices=DIRECTIONS,
        ),
        parameter("torque_constant", "N.m/A", 0.5876, "Torque of the motor per current (K_t)"),
        parameter("gear_ratio", "1", 1.0, "Turns of the motor per turn of the gear's output"),
    ),
    outputs=outputs,
    references=("The flexible-manipulator thesis, Section 2.3, Figure 2-2",),
)
