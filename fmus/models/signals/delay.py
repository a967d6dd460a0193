"""A signal that comes later: of a command the mean over each step, of a measured signal the curve through it.

Held, as a command is, each value lasts until the next, and over a step from t to t + h the output is the mean of what
the signal was from t - delay to t + h - delay: nothing is lost or added, whatever the step. Smooth, at the end of a
step it is the cubic through the signal's values, with the slopes of parabolas; for a delay shorter than the step this
goes on.
"""

from . import Delay, Model, input_, output, parameter


def outputs(t, x, u, p):
    return {"late": u.signal}


MODEL = Model(
    name="delay",
    description="A command or measured signal that comes later",
    variables=(
        input_("signal", "1", "What comes later"),
        output("late", "1", "The signal as it comes"),
        parameter("delay", "s", 0.0, "How much later", minimum=0),
        parameter("before", "1", 0.0, "What a held signal was before the start, over what it is then"),
        parameter("shape", "1", 1, "How it is between its values", minimum=1, maximum=2, choices=("held", "smooth")),
    ),
    outputs=outputs,
    delays=(Delay("signal", "delay", "before", "shape"),),
)
