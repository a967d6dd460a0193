"""The measuring channel: timing of its samples, quantisation, noise and filter, against closed forms."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal, stats

from fmus import library
from fmus.modelling.instance import Instance
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import Signal, grid, stepped

DAQ = library.find("daq")


def measured(source: Signal, time: FloatArray, **values: Any) -> FloatArray:
    """(K,) what the channel shows after each step that begins at one of the instants (K,)."""
    padded = np.append(time, 2 * time[-1] - time[-2])
    return stepped(DAQ, values, ("measured",), padded, {"signal": source})[1:, 0]


def one_sample(value: float, **values: Any) -> float:
    """What the channel makes of one value."""
    instance = Instance(DAQ, values)
    instance.set("signal", value)
    instance.step(0.0, 0.001)
    return instance.get("measured")


def test_a_sample_is_what_was_there_at_its_instant_and_is_held() -> None:
    time = grid(0.999, 0.001)
    found = measured(lambda t: t, time, sample_time=0.01)
    assert found == pytest.approx(np.floor(time / 0.01 + 1e-6) * 0.01, abs=1e-12)


def test_without_options_the_channel_shows_the_signal_itself() -> None:
    time = grid(1.0, 0.001)
    assert np.array_equal(measured(math.sin, time), np.sin(time))


@given(st.integers(2, 9), st.integers(1, 9))
def test_sample_period_and_step_may_be_any_multiples(period: int, step: int) -> None:
    """Of each step the sample taken last stays; it was taken with the input of the step it fell in."""
    time = grid(39 * step * 0.001, step * 0.001)
    found = measured(lambda t: t, time, sample_time=period * 0.001)
    last = np.floor((np.arange(1, 41) * step - 1) / period) * period
    assert found == pytest.approx(np.floor(last / step) * step * 0.001, abs=1e-12)


@given(value=st.floats(-9.9, 9.9), bits=st.integers(2, 24))
def test_quantisation_errs_by_half_a_step_at_most_and_lands_on_a_code(value: float, bits: int) -> None:
    step = 20.0 / 2**bits
    found = one_sample(value, bits=bits, range=10.0)
    if value < 10.0 - step:
        assert abs(found - value) <= step / 2 * (1 + 1e-9)
    assert found / step == pytest.approx(round(found / step), abs=1e-9)


def test_a_converter_has_two_to_its_bits_codes() -> None:
    values = np.linspace(-3, 3, 1201)
    codes = sorted({one_sample(value, bits=3, range=2.0) for value in values.tolist()})
    assert codes == [-2.0, -1.5, -1.0, -0.5, 0.0, 0.5, 1.0, 1.5]


def test_values_outside_the_range_are_clipped() -> None:
    assert (one_sample(7.0, range=5.0), one_sample(-7.0, range=5.0)) == (5.0, -5.0)


def test_gain_and_bias_are_applied_before_the_range() -> None:
    assert one_sample(1.5, gain=2.0, bias=0.25) == 3.25
    assert one_sample(1.5, gain=2.0, bias=0.25, range=3.0) == 3.0


def test_noise_is_white_and_gaussian_with_the_given_deviation() -> None:
    noise = measured(lambda t: 1.0, grid(9.999, 0.001), noise=0.02, seed=7) - 1.0
    assert abs(noise.mean()) < 4 * 0.02 / math.sqrt(len(noise))
    assert noise.std() == pytest.approx(0.02, rel=0.03)
    assert stats.kstest(noise / 0.02, "norm").pvalue > 1e-4
    correlation = [np.dot(noise[:-lag], noise[lag:]) / np.dot(noise, noise) for lag in range(1, 20)]
    assert np.max(np.abs(correlation)) < 4.5 / math.sqrt(len(noise))


def test_noise_repeats_with_its_seed_and_differs_with_another() -> None:
    time = grid(0.1, 0.001)
    first, again, other = (measured(lambda t: 0.0, time, noise=1.0, seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.any(first == other)


def _sine(omega: float, t: float) -> float:
    """A sine in the middle of the step of 2 ms that begins at t."""
    return math.sin(omega * (t + 0.001))


@pytest.mark.slow
@pytest.mark.parametrize(("order", "damping"), [(1, 0.7), (2, 1 / math.sqrt(2)), (2, 0.1), (2, 3.0), (2, 30.0)])
def test_filter_has_the_frequency_response_of_its_poles(order: int, damping: float) -> None:
    """Steady response to a sine at half, once and twice the cut-off, against 1/(1 + s/w) or its second-order kin."""
    cutoff = 5.0
    rate = 2 * math.pi * cutoff
    poles = [1 / rate, 1] if order == 1 else [1 / rate**2, 2 * damping / rate, 1]
    for ratio in (0.5, 1.0, 2.0):
        omega = ratio * rate
        time = grid(4.0 if damping < 5 else 8.0, 0.002)
        found = measured(
            partial(_sine, omega), time, sample_time=0.002, filter_order=order, cutoff=cutoff, damping=damping
        )
        late = time > time[-1] - 2.0
        basis = np.column_stack([np.sin(omega * time[late]), np.cos(omega * time[late])])
        real, imaginary = np.linalg.lstsq(basis, found[late], rcond=None)[0]
        _, response = signal.freqs([1], poles, [omega])
        assert complex(real, imaginary) == pytest.approx(complex(response[0]), abs=0.005 * abs(response[0]) + 1e-4)


@pytest.mark.parametrize("order", [1, 2])
def test_filter_follows_a_step_as_scipy_has_it(order: int) -> None:
    rate = 2 * math.pi * 10.0
    time = grid(0.3, 0.001)
    poles = [1, rate] if order == 1 else [1, 2 * 0.5 * rate, rate**2]
    _, expected = signal.step(([rate**order], poles), T=time)
    found = measured(lambda t: 1.0, time, filter_order=order, cutoff=10.0, damping=0.5)
    assert found == pytest.approx(expected, abs=1e-5)


def test_filter_starts_at_rest_at_the_given_value() -> None:
    found = measured(lambda t: 2.0, grid(0.1, 0.001), filter_order=2, cutoff=10.0, signal_start=2.0)
    assert found == pytest.approx(2.0, abs=1e-12)
