"""Figures of merit against their definitions, residual tests against their distribution."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.signal import correlate, lfilter
from scipy.stats import kstest

from fmus.errors import IdentificationError
from identification.estimation.validation import (
    autocorrelation,
    delta,
    fit,
    rms,
    whiteness,
)

signals = arrays(float, (30, 2), elements=st.floats(-10, 10)).filter(lambda y: np.all(np.ptp(y, axis=0) > 1e-3))


@given(signals, signals, st.floats(-5, 5), st.floats(0.1, 10))
def test_fit_does_not_depend_on_offset_and_unit(y, yhat, offset, unit):
    assert fit(unit * y + offset, unit * yhat + offset) == pytest.approx(fit(y, yhat), rel=1e-6, abs=1e-6)


@given(signals)
def test_fit_is_one_for_the_truth_and_zero_for_the_mean(y):
    assert fit(y, y) == pytest.approx(1)
    assert fit(y, np.broadcast_to(y.mean(axis=0), y.shape)) == pytest.approx(0, abs=1e-9)


def test_delta_is_the_ratio_of_rms_values():
    t = np.arange(1000) * 0.01
    y = np.column_stack([3 * np.sin(2 * np.pi * t), np.full(1000, 2.0)])
    yhat = y + np.column_stack([np.cos(2 * np.pi * t), np.full(1000, -0.5)])
    assert rms(y, yhat) == pytest.approx([np.sqrt(0.5), 0.5])
    assert delta(y, yhat) == pytest.approx([1 / 3, 0.25])
    assert fit(y, yhat)[0] == pytest.approx(2 / 3)


def test_an_output_without_a_scale_has_no_figure():
    y = np.column_stack([np.zeros(5), np.arange(5.0)])
    assert np.isnan(fit(y, y + 1)).tolist() == [True, False]
    assert np.isnan(delta(y, y + 1)).tolist() == [True, False]


def test_one_output_may_come_without_a_column_of_its_own():
    y, yhat = np.array([1.0, 2.0, 4.0]), np.array([1.0, 2.5, 3.0])
    for figure in (fit, rms, delta):
        np.testing.assert_array_equal(figure(y, yhat), figure(y[:, None], yhat[:, None]))


def test_autocorrelation_equals_scipy_correlate():
    e = np.random.default_rng(0).normal(size=50)
    full = correlate(e, e)[49:]
    assert autocorrelation(e, 12) == pytest.approx(full[:13] / full[0])
    assert autocorrelation(np.zeros(9), 3).tolist() == [1, 0, 0, 0]


def test_p_values_of_white_noise_are_uniform():
    rng = np.random.default_rng(3)
    p = [whiteness([rng.normal(size=400), rng.normal(size=300)], 10).p_value for _ in range(300)]
    assert kstest(p, "uniform").pvalue > 0.01


def test_correlated_residuals_are_not_white():
    rng = np.random.default_rng(1)
    result = whiteness([lfilter([1], [1, -0.3], rng.normal(size=400)) for _ in range(3)])
    assert not result.white
    assert result.freedom == 60
    assert result.autocorrelation[1] == pytest.approx(0.3, abs=0.06)
    assert result.autocorrelation[1] > result.band == pytest.approx(2.5758 / np.sqrt(1200), rel=1e-4)


def test_a_constant_error_is_not_white():
    assert not whiteness([0.5 + np.random.default_rng(1).normal(size=400)]).white


def test_short_windows_use_fewer_lags():
    assert whiteness([np.random.default_rng(1).normal(size=12)]).freedom == 3


def test_outputs_that_do_not_match_are_refused():
    with pytest.raises(IdentificationError, match="outputs: measured have shape"):
        fit(np.zeros((5, 1)), np.zeros((4, 1)))
    with pytest.raises(IdentificationError, match="lags: 9 for 9 samples"):
        autocorrelation(np.zeros(9), 9)
