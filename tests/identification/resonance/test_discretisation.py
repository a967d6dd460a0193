"""Eqs. 47-50 against SciPy's zero-order hold, and back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import cont2discrete

from fmus.errors import IdentificationError
from identification.resonance.discretisation import (
    ContinuousModel,
    DiscreteModel,
    continuous_from_discrete,
    continuous_from_parameters,
    discretised,
)

ratios = st.floats(1e-3, 0.99)
frequencies = st.floats(0.1, 50)
fractions = st.floats(0.01, 0.95)  # of the period at which the damped frequency reaches Nyquist's


def system(psi: float, omega: float, fraction: float, gain: float = 1.7) -> tuple[ContinuousModel, float]:
    return ContinuousModel(psi, omega, gain), fraction * np.pi / (omega * np.sqrt(1 - psi**2))


@given(ratios, frequencies, fractions)
def test_the_closed_form_is_the_zero_order_hold(psi: float, omega: float, fraction: float) -> None:
    model, period = system(psi, omega, fraction)
    discrete = discretised(model, period)
    numerator, denominator, _ = cont2discrete(
        ([model.gain * omega**2], [1, 2 * psi * omega, omega**2]), period, method="zoh"
    )
    assert [1, discrete.a1, discrete.a0] == pytest.approx(list(denominator), abs=1e-9)
    assert [0, discrete.b1, discrete.b0] == pytest.approx(list(numerator[0]), abs=1e-9)


@given(ratios, frequencies, fractions, st.floats(-10, 10))
def test_the_inverse_recovers_the_continuous_system(psi: float, omega: float, fraction: float, gain: float) -> None:
    model, period = system(psi, omega, fraction, gain)
    back = continuous_from_discrete(discretised(model, period))
    assert (back.damping_ratio, back.natural_frequency) == pytest.approx((psi, omega), rel=1e-6)
    assert back.gain == pytest.approx(gain, rel=1e-6, abs=1e-9)


def test_ratios_of_the_parameters_come_back() -> None:
    model = continuous_from_parameters(0.00325, 0.001, 0.04905, 10.0)
    assert model.friction_per_inertia == pytest.approx(0.001 / 0.00325)
    assert model.stiffness_per_inertia == pytest.approx(0.04905 / 0.00325)
    assert model.input_per_inertia == pytest.approx(10 / 0.00325)


@pytest.mark.parametrize(("a0", "a1"), [(0.9, -1.95), (1.0, -1.9), (1.2, -1.0), (-0.5, 0.1), (0.0, 0.0), (np.nan, 0)])
def test_eigenvalues_without_a_continuous_form_are_refused(a0: float, a1: float) -> None:
    with pytest.raises(IdentificationError, match="no decaying complex pair"):
        continuous_from_discrete(DiscreteModel(a0, a1, 0.1, 0.1, 0.01))


@pytest.mark.parametrize(("psi", "period"), [(0.0, 0.1), (1.0, 0.1), (0.5, 0.0)])
def test_systems_outside_the_lemma_are_refused(psi: float, period: float) -> None:
    with pytest.raises(IdentificationError, match=r"Eqs\. 47-50"):
        discretised(ContinuousModel(psi, 3.0, 1.0), period)
    with pytest.raises(IdentificationError, match="not an underdamped"):
        continuous_from_parameters(1.0, 3.0, 1.0, 1.0)
