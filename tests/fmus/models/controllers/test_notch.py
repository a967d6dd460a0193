"""The notch against its transfer function, by the discrete filter that SciPy makes of it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from fmus import library
from fmus.modelling.instance import Instance, StepError
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import sampled

NOTCH = library.find("notch")
RATE = 300.0


def impulse_response(count: int, **values: float) -> FloatArray:
    impulse = np.zeros(count)
    impulse[0] = 1.0
    return sampled(NOTCH, values, ["voltage"], {"effort": impulse})[:, 0]


@given(st.floats(1, 140), st.floats(0.05, 2), st.floats(0, 1))
def test_it_is_the_bilinear_transform_of_its_transfer_function(frequency: float, width: float, depth: float) -> None:
    """Prewarped, so that SciPy's transform of the analogue filter at the warped frequency is the same filter."""
    w = 2 * RATE * math.tan(math.pi * frequency / RATE)
    b, a = signal.bilinear([1, depth * width * w, w**2], [1, width * w, w**2], RATE)
    found = impulse_response(30, frequency=frequency, width=width, depth=depth)
    assert found == pytest.approx(signal.lfilter(b, a, np.eye(30)[0]), abs=1e-9)


def test_at_its_frequency_the_depth_is_left_and_far_from_it_all() -> None:
    found = impulse_response(3000, frequency=9.0, width=0.5, depth=0.1)
    _, gains = signal.freqz(found, worN=[0.0, 9.0, 149.9], fs=RATE)
    assert abs(gains) == pytest.approx([1.0, 0.1, 1.0], abs=1e-3)


def test_without_depth_it_is_scipys_notch() -> None:
    b, a = signal.iirnotch(9.0, 2.0, RATE)
    assert impulse_response(100, width=0.5, depth=0.0) == pytest.approx(signal.lfilter(b, a, np.eye(100)[0]), abs=0.02)


def test_a_frequency_beyond_half_the_sampling_rate_is_refused() -> None:
    with pytest.raises(StepError, match="half of the sampling rate"):
        Instance(NOTCH, {"frequency": 150.0}).step(0.0, 1 / RATE)
