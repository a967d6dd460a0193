"""Questions that make no sense are refused in one line, and what has no unit is weighed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from fmus.errors import IdentificationError
from identification.estimation.parameters import InitialState, ParameterSet
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import SearchOptions
from identification.output_error.search.problem import Problem, Window, spread_weights
from tests.support.identification.closed_form import INSTANTS, Oscillator
from tests.support.identification.decays import PARAMETERS, decays


def test_spread_weights_make_outputs_comparable():
    rng = np.random.default_rng(0)
    weights = spread_weights([rng.normal(size=(500, 2)) * [3.0, 0.1] for _ in range(3)])
    assert weights == pytest.approx([1 / 3.0, 10.0], rel=0.05)
    with pytest.raises(IdentificationError, match="output 1: is constant"):
        spread_weights([np.column_stack([np.arange(5.0), np.ones(5)])])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Window("w", "t", np.array([[1.0], [np.nan]]), np.ones(1)), "w: a measured output is not finite"),
        (lambda: Window("w", "t", np.ones(3), np.ones(1)), r"w: measured has shape \(3,\)"),
        (lambda: Window("w", "t", np.ones((1, 2)), np.ones(2)), r"w: measured has shape \(1, 2\)"),
        (lambda: Window("w", "t", np.ones((3, 1)), np.zeros(1)), "w: a weight is not positive"),
        (lambda: Window("w", "t", np.ones((3, 1)), np.ones(2)), "w: weight has shape"),
        (lambda: replace(decays(), windows=()), "windows: there are none"),
        (lambda: replace(decays(), outputs={"a": "1", "b": "1"}), "decay 0: has 1 measured columns"),
        (lambda: replace(decays(), windows=decays(2).windows), r"rig\.angle_start: has 4 start values for 2"),
        (lambda: replace(decays(), initial_states=(InitialState("rig.damping", (0.0,) * 4),)), "declared twice"),
        (lambda: SearchOptions(starts=0), "options.starts: 0 is too few"),
        (lambda: SearchOptions(difference_step=0.0), "options.difference_step"),
        (lambda: estimate(decays(free=False).fixed_at({}), Oscillator), "parameters: nothing is free"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused_in_one_line(make, message):
    with pytest.raises(IdentificationError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_too_few_samples_are_refused():
    window = Window("short", "t", np.ones((2, 1)), np.ones(1))
    with pytest.raises(IdentificationError, match="hold 2 samples for 2 unknowns"):
        Problem(ParameterSet(PARAMETERS), (window,), ("angle",))


def test_outputs_of_the_wrong_shape_are_refused():
    with pytest.raises(IdentificationError, match=r"decay 0: simulated outputs have shape \(9, 1\)"):
        estimate(decays(), lambda: Oscillator(time=INSTANTS[:9]))
