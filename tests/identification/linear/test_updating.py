"""What least squares restores in a reduced model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linear.modes import modes
from identification.linear.records import InputOutputData
from identification.linear.reduction import reduced, updated_input, updated_output
from tests.support.identification.linear_fits import STEP, eigenvalue, model_of, white

FULL = model_of([eigenvalue(46, 0.03), eigenvalue(23, 0.04), eigenvalue(9, 0.03), 0.97, 0.99], inputs=2)


def records(model: LinearModel, *seeds: int) -> list[InputOutputData]:
    inputs = [white(400, len(model.inputs), seed) for seed in seeds]
    return [InputOutputData(u, model.simulate(u), STEP, model.inputs, model.outputs) for u in inputs]


def error(model: LinearModel, given: list[InputOutputData]) -> float:
    return float(np.sqrt(sum(np.sum((record.y - model.simulate(record.u)) ** 2) for record in given)))


def test_keeping_all_modes_keeps_the_model() -> None:
    u = white(300, 2)
    assert reduced(FULL, range(len(modes(FULL)))).simulate(u) == pytest.approx(FULL.simulate(u), abs=1e-9)


@pytest.mark.parametrize("update", [updated_input, updated_output])
def test_a_wrong_matrix_is_found_again_from_several_records(update: object) -> None:
    wrong = replace(FULL, b=FULL.b * 0.7) if update is updated_input else replace(FULL, c=FULL.c + 0.3)
    found = update(wrong, records(FULL, 1, 2))  # type: ignore[operator]
    assert found.simulate(white(200, 2, 9)) == pytest.approx(FULL.simulate(white(200, 2, 9)), abs=1e-8)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_an_update_never_makes_the_fit_of_a_reduced_model_worse(seed: int) -> None:
    model = model_of([eigenvalue(46, 0.03), eigenvalue(9, 0.03), 0.97], seed)
    short, given = reduced(model, [1, 2]), records(model, seed)
    before = error(short, given)
    assert error(updated_output(short, given), given) <= before * (1 + 1e-9)
    assert error(updated_input(short, given, scale=np.ones(3)), given) <= before * (1 + 1e-9)


def test_input_matrix_is_that_of_plain_least_squares() -> None:
    short, (record,) = reduced(FULL, [1, 2]), records(FULL, 3)
    columns = []
    for j in range(2):
        for i in range(short.order):
            b = np.zeros_like(short.b)
            b[i, j] = 1.0
            columns.append(replace(short, b=b).simulate(record.u).ravel())
    expected = np.linalg.lstsq(np.array(columns).T, record.y.ravel(), rcond=None)[0].reshape(2, short.order).T
    assert updated_input(short, [record], scale=np.ones(3)).b == pytest.approx(expected, rel=1e-8)


def test_states_that_do_not_move_are_refused() -> None:
    still = [InputOutputData(np.zeros((50, 2)), np.ones((50, 3)), STEP, FULL.inputs, FULL.outputs)]
    with pytest.raises(IdentificationError, match="0 of 8 states"):
        updated_output(FULL, still)
    with pytest.raises(IdentificationError, match="no mode is kept"):
        reduced(FULL, [])
