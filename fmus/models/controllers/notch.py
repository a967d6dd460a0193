"""A notch that takes one frequency out of a command, by the bilinear transform that keeps this frequency exact.

    G(s) = (s^2 + depth width w s + w^2) / (s^2 + width w s + w^2),   w = 2 pi frequency

At the frequency the gain is `depth`, far from it 1; `width` is the bandwidth at -3 dB over the frequency where `depth`
is 0. While it is not enabled, the command passes as it is.
"""

import math

from . import Model, Requirement, State, control, input_, ops, parameter


def filtered(x, u, p):
    """The output, and the new values of the two memories (transposed direct form II)."""
    k = ops.tan(math.pi * p.frequency * p.sample_time)
    a0 = 1 + p.width * k + k**2
    a1, a2 = 2 * (k**2 - 1) / a0, (1 - p.width * k + k**2) / a0
    b0 = (1 + p.depth * p.width * k + k**2) / a0
    b2 = (1 - p.depth * p.width * k + k**2) / a0
    y = b0 * u.effort + x.memory_1
    return y, a1 * (u.effort - y) + x.memory_2, b2 * u.effort - a2 * y


def update(t, x, u, p):
    y, memory_1, memory_2 = filtered(x, u, p)
    offset = control.offset(y, u.effort, x, u, p)
    given = {"memory_1": memory_1, "memory_2": memory_2, "offset": offset}
    return control.command(y + offset, u.effort, x, u, p) | given


MODEL = Model(
    name="notch",
    description="Sampled notch filter of a command",
    variables=(
        input_("effort", "V", "What a controller asks for"),
        control.ENABLED,
        *control.VOLTAGE,
        parameter("frequency", "Hz", 9.0, "What is taken out; below half of the sampling rate", minimum=1e-6),
        parameter("width", "1", 0.5, "Bandwidth over the frequency", minimum=1e-6),
        parameter("depth", "1", 0.1, "Gain that is left at the frequency", minimum=0),
        control.TRANSFER_TIME,
        *control.LIMITS,
    ),
    states=(
        *control.STATES,
        State("memory_1", 0.0, "V", sampled=True),
        State("memory_2", 0.0, "V", sampled=True),
        control.OFFSET,
    ),
    update=update,
    sample_time="sample_time",
    requirements=(
        Requirement(
            lambda t, x, u, p: 2 * p.frequency * p.sample_time < 1,
            "frequency is not below half of the sampling rate, 1 / (2 sample_time); lower one of them",
        ),
    ),
)
