"""The resonance statistics: the corrected ones hold what they claim, the published ones do not."""

from __future__ import annotations

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy import optimize

from fmus.errors import IdentificationError
from identification.resonance.resonance import (
    decibel,
    peak_shape,
    peak_shape_as_published,
    resonance_at_largest,
    resonance_frequency,
    resonance_from_curvature,
    resonance_from_height,
    resonance_from_height_as_published,
    resonance_from_two_largest_as_published,
    resonance_of_inverse_parabola,
)

A0, A1, B0 = 15.0923, 0.30769, 3076.92
OMEGA_OPT = np.sqrt(A0 - A1**2 / 2)


def gain(omega: ArrayLike) -> np.ndarray:
    return np.abs(control.tf([B0], [1.0, A1, A0])(1j * np.asarray(omega)))


def parabola(omega: ArrayLike) -> np.ndarray:
    shape = peak_shape(A0, A1, B0)
    return np.sqrt(shape.height - shape.curvature * (np.asarray(omega) ** 2 - OMEGA_OPT**2) ** 2)


def test_the_resonance_is_where_the_gain_is_largest() -> None:
    found = optimize.minimize_scalar(lambda w: -gain([w])[0], bounds=(3, 5), method="bounded", options={"xatol": 1e-9})
    assert resonance_frequency(1.0, A1, A0) == pytest.approx(found.x, rel=1e-6)


def test_the_added_mass_changes_inertia_and_torque() -> None:
    mass, length = np.array([0.0, 0.1]), 0.2
    inertia, torque = 0.003 + mass * length**2, 0.05 + mass * 9.81 * length
    expected = [float(resonance_frequency(i, 0.001, q)) for i, q in zip(inertia, torque, strict=True)]
    assert resonance_frequency(0.003, 0.001, 0.05, mass, length) == pytest.approx(expected)


def test_strong_damping_leaves_no_resonance() -> None:
    assert resonance_frequency(1.0, 10.0, 1.0) == 0


def test_the_corrected_peak_shape_is_height_and_curvature_of_the_squared_gain() -> None:
    x, h = OMEGA_OPT**2, 1e-3
    f = gain(np.sqrt([x - h, x, x + h])) ** 2
    shape = peak_shape(A0, A1, B0)
    assert shape.height == pytest.approx(f[1])
    assert shape.curvature == pytest.approx(-(f[0] - 2 * f[1] + f[2]) / h**2 / 2, rel=1e-4)


def test_the_published_peak_shape_is_too_small_by_the_numerator() -> None:
    right, printed = peak_shape(A0, A1, B0), peak_shape_as_published(A0, A1, B0)
    assert right.height / printed.height == pytest.approx(B0)
    assert right.curvature / printed.curvature == pytest.approx(B0)


@given(st.floats(-0.03, -1e-4), st.floats(1e-4, 0.03))
def test_corrected_statistics_are_exact_for_a_parabola(below: float, above: float) -> None:
    omega = OMEGA_OPT + np.array([below, above])
    shape = peak_shape(A0, A1, B0)
    assert resonance_from_height(omega, parabola(omega), shape) == pytest.approx(OMEGA_OPT, rel=1e-6)
    assert resonance_from_curvature(omega, parabola(omega), shape) == pytest.approx(OMEGA_OPT, rel=1e-6)


def test_the_published_weights_stay_at_the_mid_point_even_for_a_parabola() -> None:
    omega = OMEGA_OPT + np.array([-0.001, 0.03])
    published = resonance_from_height_as_published(omega, parabola(omega), peak_shape(A0, A1, B0))
    assert abs(published - OMEGA_OPT) > 0.01


def test_eq_100_is_eq_90_as_published_with_the_largest_gain_for_the_peak() -> None:
    (w1, w2), (g1, g2) = (3.5, 4.0), gain([3.5, 4.0])
    r = (g1 / g2) ** 2
    by_hand = np.sqrt((w2**2 * np.sqrt(r + 1) + w1**2 * np.sqrt(2)) / (np.sqrt(r + 1) + np.sqrt(2)))
    assert g2 > g1
    assert resonance_from_two_largest_as_published([w1, w2, 6.0], [g1, g2, 1.0]) == pytest.approx(by_hand)


def test_eq_100_corrected_keeps_only_the_largest_gain() -> None:
    omega = np.array([3.5, 4.0, 4.5])
    corrected = resonance_at_largest(omega, gain(omega))
    assert corrected == pytest.approx(4.0)
    just_above = peak_shape(A0, A1, B0).__class__(gain(omega).max() ** 2 * (1 + 1e-14), 1.0)
    assert resonance_from_height(omega, gain(omega), just_above) == pytest.approx(corrected, rel=1e-6)


@given(st.floats(3.0, 3.7), st.floats(3.72, 4.0), st.floats(4.02, 5.0))
def test_the_inverse_parabola_is_exact_for_a_second_order_system(low: float, middle: float, high: float) -> None:
    omega = np.array([low, middle, high])
    assert resonance_of_inverse_parabola(omega, gain(omega)) == pytest.approx(OMEGA_OPT, rel=1e-6)


def test_statistics_use_the_largest_gains_in_any_order() -> None:
    omega = np.array([7.0, 4.0, 1.0, 3.5, 4.5])
    shuffled = resonance_of_inverse_parabola(omega, gain(omega))
    assert shuffled == pytest.approx(resonance_of_inverse_parabola([3.5, 4.0, 4.5], gain([3.5, 4.0, 4.5])))


def test_decibels_of_ten_are_twenty() -> None:
    assert decibel([10.0, 1.0]) == pytest.approx([20.0, 0.0])


@pytest.mark.parametrize(
    ("omega", "gains", "problem"),
    [
        ([4.0], [1.0], "needs 2"),
        ([4.0, 4.5], [1.0, np.nan], "needs 2 finite"),
        ([4.0, 4.5, 5.0], [1.0, 2.0], "as many frequencies"),
    ],
)
def test_columns_that_do_not_fit_are_refused(omega: list[float], gains: list[float], problem: str) -> None:
    with pytest.raises(IdentificationError, match=problem):
        resonance_from_two_largest_as_published(omega, gains)


def test_repeated_frequencies_among_the_largest_gains_are_refused_where_they_divide() -> None:
    with pytest.raises(IdentificationError, match="share one frequency"):
        resonance_of_inverse_parabola([4.0, 4.0, 4.5, 1.0], [2.0, 2.1, 1.0, 0.5])
    with pytest.raises(IdentificationError, match="share one frequency"):
        resonance_from_curvature([4.0, 4.0], [2.0, 2.1], peak_shape(A0, A1, B0))
    assert resonance_from_two_largest_as_published([4.0, 4.0, 1.0], [2.0, 2.1, 1.0]) == pytest.approx(4.0)


def test_gains_above_the_peak_or_without_one_are_refused() -> None:
    with pytest.raises(IdentificationError, match="not below the peak"):
        resonance_from_height([3.5, 4.0], gain([3.5, 4.0]), peak_shape_as_published(A0, A1, 1.0))
    with pytest.raises(IdentificationError, match="no peak"):
        resonance_of_inverse_parabola([1.0, 2.0, 3.0], [3.0, 1.5, 1.4])
