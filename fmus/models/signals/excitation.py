"""Test signals: sine, sine sweep, squares of one height or of random ones, random, steps, multisine, and playback.

Every signal is a pure function of time, so it can be entered anywhere and repeats exactly for one seed:
`offset + amplitude * shape(t)`, zero before `begin`.
"""

import math

from . import Model, ops, output, parameter

SHAPES = (
    "sine",
    "sine sweep",
    "square",
    "varying square",
    "periodic random",
    "random",
    "steps",
    "playback",
    "alternating random",
    "multisine",
)
MOST_LINES = 12


def turning(t, p):
    """Angle [rad] at one frequency; it begins at `phase`."""
    return 2 * math.pi * (p.frequency * t + p.phase)


def sweeping(t, p):
    """Angle [rad] of the sweep: the frequency runs linearly from `frequency` to `frequency_end`, then stays."""
    ratio = ops.clip(t / p.duration, 0.0, 1.0)
    swept = p.frequency * ratio + 0.5 * (p.frequency_end - p.frequency) * ratio**2
    after = p.frequency_end * ops.maximum(t - p.duration, 0.0)
    return 2 * math.pi * (swept * p.duration + after + p.phase)


def square(angle):
    """+1 over the first half of each turn, -1 over the second."""
    turn = angle / (2 * math.pi) + 1e-9
    return ops.where(turn - ops.floor(turn) < 0.5, 1.0, -1.0)


def multisine(t, p):
    """Sum of the first `lines` harmonics, with the phases after which it hardly peaks and the power of one sine."""
    total = 0.0
    for line in range(1, MOST_LINES + 1):
        angle = line * turning(t, p) - math.pi * line * (line - 1) / p.lines
        total = total + ops.where(p.lines > line - 0.5, ops.sin(angle), 0.0)
    return total / ops.sqrt(p.lines)


def interval(t, p):
    """Number of the sample interval that t lies in."""
    return ops.floor(t / p.sample_time + 1e-6)


def staircase(t, p):
    """Up by one each `sample_time` to `levels` steps, and from there down again."""
    turn = interval(t, p) - 2 * p.levels * ops.floor(interval(t, p) / (2 * p.levels))
    return (p.levels - ops.absolute(turn - p.levels)) / p.levels


def shape(t, p):
    count = interval(t, p)
    repeated = count - p.period_samples * ops.floor(count / p.period_samples)
    signal = ops.playback(p.playback, t)
    for number, candidate in (
        (1, ops.sin(turning(t, p))),
        (2, ops.sin(sweeping(t, p))),
        (3, square(turning(t, p))),
        (4, square(sweeping(t, p))),
        (5, 2 * ops.uniform(p.seed, repeated) - 1),
        (6, 2 * ops.uniform(p.seed, count) - 1),
        (7, staircase(t, p)),
        (9, ops.uniform(p.seed, count) * square(turning(t, p))),
        (10, multisine(t, p)),
    ):
        signal = ops.where(p.shape < number + 0.5, ops.where(p.shape > number - 0.5, candidate, signal), signal)
    return signal


def outputs(t, x, u, p):
    since = ops.maximum(t - p.begin, 0.0)
    return {"signal": ops.where(t - p.begin > -1e-9, p.offset + p.amplitude * shape(since, p), 0.0)}


MODEL = Model(
    name="excitation",
    description="Source of test signals",
    variables=(
        output("signal", "1", "The signal; its unit is that of the input it drives"),
        parameter("shape", "1", 1, "Which signal", minimum=1, maximum=len(SHAPES), choices=SHAPES),
        parameter("amplitude", "1", 1.0, "Factor of the signal (peak value; playback: gain)"),
        parameter("offset", "1", 0.0, "Added to the signal"),
        parameter("begin", "s", 0.0, "Zero before this time; the signal's own time counts from here"),
        parameter("frequency", "Hz", 1.0, "Of sines, square and alternating random; where sweeps begin", minimum=0),
        parameter("frequency_end", "Hz", 10.0, "Where sine sweep and varying square end", minimum=0),
        parameter("duration", "s", 10.0, "Of sine sweep and varying square", minimum=1e-9),
        parameter("phase", "1", 0.0, "Turns of sine, sweep and square before the beginning; 0.25 centres a motion"),
        parameter("sample_time", "s", 0.01, "How long a random value or a step lasts", minimum=1e-9),
        parameter("period_samples", "1", 100, "Values until periodic random repeats", minimum=1),
        parameter("levels", "1", 4, "Steps up to the amplitude, and down again", minimum=1),
        parameter("lines", "1", 4, "Harmonics of a multisine, from its frequency on", minimum=1, maximum=MOST_LINES),
        parameter("seed", "1", 1, "Of the random signals"),
    ),
    outputs=outputs,
    tables=("playback",),
    references=(
        "Random values: SplitMix64 of (seed, sample number), uniform in (-1, 1)",
        "Phases of the multisine: Schroeder, IEEE Transactions on Information Theory 16(1), 1970, pp. 85-89",
    ),
)
