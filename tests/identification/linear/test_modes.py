"""Modes of linear models: their figures, their sum, and what is lost with those left out."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear import modes as m
from identification.linear.model import LinearModel
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white

ARM = [eigenvalue(46.02, 0.027), eigenvalue(22.79, 0.043), eigenvalue(9.03, 0.033), eigenvalue(0.77, 0.342), 0.993, 1.0]


def test_frequencies_and_dampings_are_those_the_eigenvalues_were_made_of() -> None:
    found = m.modes(model_of(ARM))
    assert [mode.frequency for mode in found[:4]] == pytest.approx([46.02, 22.79, 9.03, 0.77], rel=1e-6)
    assert [mode.damping for mode in found[:4]] == pytest.approx([0.027, 0.043, 0.033, 0.342], rel=1e-6)
    assert m.labels(found) == ["1/2", "3/4", "5/6", "7/8", "9", "10"]
    assert found[4].frequency == pytest.approx(0.0, abs=1e-9)
    assert found[5].frequency == pytest.approx(-math.log(0.993) / STEP / 2 / math.pi)


def test_frequency_and_damping_are_those_of_python_control() -> None:
    model = model_of(ARM[:4])
    omega, zeta, _ = model.control().damp()
    expected = sorted({(round(w / 2 / math.pi, 6), round(z, 6)) for w, z in zip(omega, zeta, strict=True)})
    assert sorted((round(x.frequency, 6), round(x.damping, 6)) for x in m.modes(model)) == expected


@given(st.integers(0, 2**32 - 1), st.integers(1, 3), st.integers(1, 4))
@settings(max_examples=30, deadline=None)
def test_a_response_is_the_sum_of_its_modes_and_of_their_real_realisation(seed: int, inputs: int, outputs: int) -> None:
    model = model_of([0.9 + 0.3j, 0.5 + 0.1j, 0.8, -0.4], seed, inputs, outputs)
    u = white(200, inputs, seed)
    found = m.modes(model)
    expected = model.simulate(u)
    scale = np.abs(expected).max()
    assert np.abs(sum(mode.response(u) for mode in found) - expected).max() < 1e-9 * scale
    assert np.abs(m.from_modes(found, model).simulate(u) - expected).max() < 1e-9 * scale


def test_an_eigenvalue_on_the_negative_real_axis_has_no_frequency() -> None:
    (mode,) = m.modes(model_of([-0.5]))
    assert math.isnan(mode.frequency)
    assert math.isnan(mode.damping)


def test_an_unstable_mode_has_negative_damping() -> None:
    assert m.modes(model_of([1.01 * np.exp(0.2j)]))[0].damping < 0


def test_coinciding_eigenvalues_with_one_eigenvector_are_refused() -> None:
    defective = LinearModel(
        np.array([[0.5, 1.0], [0.0, 0.5]]), np.ones((2, 1)), np.ones((1, 2)), np.zeros((1, 1)), STEP, ("u",), ("y",)
    )
    with pytest.raises(IdentificationError, match="one eigenvector"):
        m.modes(defective)


def test_mode_singular_value_of_a_real_mode_is_its_pulse_response_summed() -> None:
    (mode,) = m.modes(model_of([0.9], outputs=1))
    pulse = np.zeros((50, 1))
    pulse[0] = 1.0
    assert mode.mode_singular_value(50) ** 2 == pytest.approx(float(np.abs(mode.response(pulse)).sum()))


def test_mrm_keeps_a_heavily_damped_mode_that_msv_ranks_last() -> None:
    slow_input = np.repeat(white(20, seed=3), 100, axis=0)  # excites what is slow
    damped, ringing = eigenvalue(0.8, 0.9), eigenvalue(40.0, 0.001)
    model = model_of([damped, ringing], outputs=1, mixed=False)
    model = LinearModel(
        model.a,
        np.array([[0.02], [0.02], [0.05], [0.05]]),
        np.array([[1.0, 1.0, 1.0, 1.0]]),
        model.d,
        STEP,
        model.inputs,
        model.outputs,
    )
    fast, slow = m.modes(model)
    assert slow.mode_singular_value(2000) < fast.mode_singular_value(2000)
    assert slow.response_magnitude(slow_input) > fast.response_magnitude(slow_input)


def test_the_strongest_that_fit_are_kept_and_never_half_a_pair() -> None:
    found = m.modes(model_of(ARM))
    assert m.strongest(found, [6, 5, 4, 3, 2, 1], 5) == [0, 1, 4]
    assert m.ranked([0.1, 5.0, 2.0]) == [3, 1, 2]


def test_known_frequencies_are_kept_by_their_strongest_mode_and_the_rest_by_rank() -> None:
    found = m.modes(model_of([eigenvalue(f, 0.02) for f in (55, 47, 45, 23, 9, 0.8)] + [0.99, 0.999]))
    values = [9.0, 1.0, 2.0, 1.0, 1.0, 5.0, 4.0, 3.0]
    kept = m.combined(found, values, 10, flexible=[9.0, 23.0, 46.0])
    assert [round(found[i].frequency, 3) for i in kept[:4]] == [45.0, 23.0, 9.0, 0.8]
    assert len(kept) == 6


@given(st.integers(0, 2**32 - 1), st.sets(st.integers(0, 3)))
@settings(max_examples=50, deadline=None)
def test_sum_of_dropped_mrms_bounds_the_mean_absolute_error_also_with_an_unstable_mode(
    seed: int, kept: set[int]
) -> None:
    model = model_of([0.9 + 0.3j, 0.95 + 0.1j, 0.8, 1.002], seed, 2, 3)
    u = white(150, 2, seed)
    found = m.modes(model)
    error = model.simulate(u) - sum((found[i].response(u) for i in kept), start=np.zeros((150, 3)))
    bound = m.dropping_bound(found, sorted(kept), u)
    assert np.abs(error).mean(axis=0).max() <= bound + 1e-9 * np.abs(model.simulate(u)).max()


def test_dropping_one_mode_attains_the_bound() -> None:
    model, u = model_of(ARM[:4]), white(300)
    found = m.modes(model)
    error = model.simulate(u) - sum(mode.response(u) for mode in found[1:])
    assert np.abs(error).mean(axis=0).max() == pytest.approx(m.dropping_bound(found, [1, 2, 3], u))


def test_the_bound_says_nothing_about_the_rms_error_or_other_inputs() -> None:
    model = model_of(ARM[2:3], outputs=1)
    found, pulse = m.modes(model), np.zeros((1000, 1))
    pulse[0] = 1.0
    bound = m.dropping_bound(found, [], pulse)
    assert np.sqrt(np.mean(model.simulate(pulse) ** 2)) > bound
    assert np.abs(model.simulate(white(1000))).mean() > bound
