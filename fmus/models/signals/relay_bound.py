"""The bounded-position experiment: a drive of any height whose direction changes when the arm reaches a bound.

It begins towards the upper bound; beyond the upper bound the direction becomes negative, beyond the lower one positive.
"""

from . import Model, State, input_, ops, output, parameter


def update(t, x, u, p):
    direction = ops.where(u.position >= p.bound, -1.0, ops.where(u.position <= -p.bound, 1.0, x.direction))
    return {"direction": direction, "voltage": direction * u.magnitude}


MODEL = Model(
    name="relay_bound",
    description="Direction logic that keeps a position between two bounds",
    variables=(
        input_("magnitude", "V", "Height of the command, constant or random; not negative"),
        input_("position", "V", "Measured position, in volts of its sensor"),
        output("voltage", "V", "Command to the drive, held between samples"),
        output("direction", "1", "Its direction: 1 or -1"),
        parameter("bound", "V", 3.0, "Position at which the direction changes, either side (35 degrees)", minimum=0),
        parameter("sample_time", "s", 1 / 300, "Sample period", minimum=1e-6),
    ),
    states=(State("direction", 1.0, sampled=True), State("voltage", 0.0, "V", sampled=True)),
    update=update,
    sample_time="sample_time",
    references=("The flexible-manipulator thesis, Section 2.4.2",),
)
