"""A change acts where it moves a signal by more than twice what half the step does: the error of a first-order step."""

from __future__ import annotations

import numpy as np
import pytest

from orchestrator.batch.mutation.effect import acts
from orchestrator.trace import FloatArray, Trace

TIME = np.linspace(0.0, 1.0, 101)
FINER = np.linspace(0.0, 1.0, 201)


def trace(values: FloatArray, time: FloatArray = TIME) -> Trace:
    return Trace(time, {"still": np.zeros_like(time), "y": values})


def halved(error: float) -> Trace:
    """The plain run with half the step, which moves it by so much."""
    return trace(np.sin(FINER) + error, FINER)


PLAIN = trace(np.sin(TIME))


@pytest.mark.parametrize(("effect", "error", "found"), [(0.021, 0.01, True), (0.019, 0.01, False), (1e-12, 0.0, True)])
def test_twice_what_half_the_step_moves_is_the_limit(effect: float, error: float, found: bool) -> None:
    assert acts(trace(np.sin(TIME) + effect), PLAIN, halved(error)) is found


def test_what_is_equal_does_not_act_whatever_the_error() -> None:
    assert not acts(PLAIN, PLAIN, halved(0.0)) and not acts(PLAIN, PLAIN, None)


def test_many_small_changes_act_beside_few_errors_of_the_same_size() -> None:
    """As bits of a converter that flip: half the step has one do so, a change of the noise has every second."""
    flipped = trace(np.sin(FINER) + 0.005 * (np.arange(201) == 100), FINER)
    assert acts(trace(np.sin(TIME) + 0.005 * (np.arange(101) % 2)), PLAIN, flipped)
    assert not acts(trace(np.sin(TIME) + 0.005 * (np.arange(101) == 7)), PLAIN, flipped)


def test_a_run_of_another_length_or_without_numbers_acts() -> None:
    assert acts(PLAIN.rows(slice(50)), PLAIN, halved(1.0))
    broken = np.sin(TIME)
    broken[3] = np.nan
    assert acts(trace(broken), PLAIN, halved(1.0)) and not acts(trace(broken), trace(broken), halved(1.0))
