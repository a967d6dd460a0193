"""Records before identification: what each step does, and what it must not do."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear.preparation import Preparation, prepared, without_compensation
from identification.linear.records import InputOutputData
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white


def biased() -> InputOutputData:
    model = model_of([eigenvalue(9, 0.03), eigenvalue(0.8, 0.4)], outputs=3)
    u = white(1500)
    return InputOutputData(u, model.simulate(u) + np.array([5.0, -3.0, 2.0]), STEP)


def test_outputs_start_at_zero_and_strains_have_no_mean() -> None:
    (record,) = prepared([biased()], Preparation(zero_mean=("y2",), scaled=False)).records
    assert record.y[0, [0, 2]] == pytest.approx(0.0)
    assert record.y[:, 1].mean() == pytest.approx(0.0, abs=1e-12)


def test_scaled_outputs_are_as_large_as_the_input_and_a_model_of_them_is_scaled_back() -> None:
    raw = biased()
    found = prepared([raw], Preparation())
    (record,) = found.records
    assert np.abs(record.y).max(axis=0) == pytest.approx(np.full(3, np.abs(record.u).max()))
    model = model_of([0.9])
    assert found.unscaled(model).simulate(raw.u) * found.scale == pytest.approx(model.simulate(raw.u))


def test_records_are_scaled_alike() -> None:
    whole = biased()
    halves = [whole.rows(0, 700), whole.rows(700, 1500)]
    first, second = prepared(halves, Preparation()).records
    sizes = [np.abs(half.y - half.y[0]).max(axis=0) for half in halves]
    assert np.abs(first.y).max(axis=0) / np.abs(second.y).max(axis=0) == pytest.approx(sizes[0] / sizes[1])


@pytest.mark.parametrize("causal", [False, True])
def test_filtering_both_sides_leaves_the_model_between_them_unchanged(causal: bool) -> None:
    model = model_of([eigenvalue(9, 0.03)], outputs=1)
    u = white(3000)
    (record,) = prepared(
        [InputOutputData(u, model.simulate(u), STEP)], Preparation(cutoff=50.0, causal=causal, scaled=False)
    ).records
    error = record.y - record.y[0] - (model.simulate(record.u) - model.simulate(record.u)[0])
    inner = error[300:-300] - error[300:-300].mean()
    assert np.sqrt(np.mean(inner**2)) < 0.01 * record.y.std()


def test_filtering_only_the_outputs_as_published_adds_the_filters_lag() -> None:
    u = np.sin(2 * np.pi * 10 * np.arange(3000) * STEP)[:, None]
    (both,) = prepared([InputOutputData(u, u, STEP)], Preparation(cutoff=50.0, causal=True, scaled=False)).records
    (outputs,) = prepared(
        [InputOutputData(u, u, STEP)], Preparation(cutoff=50.0, causal=True, filter_input=False, scaled=False)
    ).records
    assert both.y == pytest.approx(both.u)
    assert np.abs(outputs.y - outputs.u)[300:].max() > 0.2


def test_an_output_that_stays_zero_cannot_be_scaled() -> None:
    flat = InputOutputData(white(100), np.ones((100, 1)), STEP)
    with pytest.raises(IdentificationError, match="output 0: is 0 throughout"):
        prepared([flat], Preparation())


@given(st.lists(st.floats(-9, 9), min_size=1, max_size=20), st.floats(0.0, 1.0))
@settings(deadline=None)
def test_taking_the_compensation_out_undoes_adding_it(command: list[float], magnitude: float) -> None:
    wanted = np.array(command)
    compensated = wanted + magnitude * np.sign(wanted)
    assert without_compensation(compensated, magnitude) == pytest.approx(wanted, abs=1e-12)
