"""A measuring channel: sensor filter, bias, noise, sample and hold, quantisation.

The filter has one or two poles at `cutoff`, then `gain * filtered + bias + noise` is clipped to the range, rounded to
the converter's bits, and held until the next sample.
"""

import math

from . import Model, State, input_, ops, output, parameter


def derivatives(t, x, u, p):
    """Second order: unity gain at rest and the given damping; first order: one pole at the cut-off."""
    rate = 2 * math.pi * p.cutoff
    first = rate * (u.signal - x.filtered)
    slope = rate * (rate * (u.signal - x.filtered) - 2 * p.damping * x.slope)
    second = p.filter_order > 1.5
    on = p.filter_order > 0.5
    return {
        "filtered": ops.where(on, ops.where(second, x.slope, first), 0.0),
        "slope": ops.where(second, slope, 0.0),
    }


def quantised(value, p):
    """Rounded to one of the converter's 2^bits codes, the highest one step below the range; with 0 bits as it is."""
    bits_or_one = ops.where(p.bits > 0.5, p.bits, 1)
    step = 2 * p.range / 2.0**bits_or_one
    code = ops.minimum(step * ops.floor(value / step + 0.5), p.range - step)
    return ops.where(p.bits > 0.5, code, value)


def update(t, x, u, p):
    sensed = ops.where(p.filter_order > 0.5, x.filtered, u.signal)
    noise = p.noise * ops.normal(p.seed, x.count)
    value = ops.clip(p.gain * sensed + p.bias + noise, -p.range, p.range)
    return {"measured": quantised(value, p), "count": x.count + 1}


def solver_step(p):
    """A fiftieth of the cut-off's period; less where high damping makes one of two poles faster than the cut-off."""
    return ops.where(p.filter_order > 0.5, 0.02 / (p.cutoff * ops.maximum(1.0, 2 * p.damping)), 1.0)


MODEL = Model(
    name="daq",
    description="Measuring channel: sensor filter, noise, sample and hold, quantisation",
    variables=(
        input_("signal", "1", "What is measured"),
        output("measured", "1", "The sample, held for a sample period"),
        parameter("sample_time", "s", 0.001, "Sample period", minimum=1e-6),
        parameter("gain", "1", 1.0, "Measured units per unit of the signal"),
        parameter("bias", "1", 0.0, "Added to every sample"),
        parameter("noise", "1", 0.0, "Standard deviation of white Gaussian noise", minimum=0),
        parameter("seed", "1", 1, "Of the noise; channels with one seed have one noise"),
        parameter("bits", "1", 0, "Of the converter; 0 leaves the samples as they are", minimum=0, maximum=52),
        parameter("range", "1", 1e12, "Largest value, either sign", minimum=1e-12),
        parameter("filter_order", "1", 0, "Poles of the sensor filter: 0, 1 or 2", minimum=0, maximum=2),
        parameter("cutoff", "Hz", 1000.0, "Frequency of the filter's poles", minimum=1e-9),
        parameter("damping", "1", 0.7071067811865476, "Damping ratio of the second-order filter", minimum=0),
        parameter("signal_start", "1", 0.0, "Filtered signal at the start"),
    ),
    states=(
        State("filtered", "signal_start"),
        State("slope", 0.0),
        State("measured", 0.0, sampled=True),
        State("count", 0.0, sampled=True),
    ),
    derivatives=derivatives,
    update=update,
    solver_step=solver_step,
    sample_time="sample_time",
)
