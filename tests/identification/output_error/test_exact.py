"""Exact Jacobians of free runs: the same as by differences, where FMUs carry tangents; said where they do not."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import TangentsMissing
from fmus.packaging import targets
from fmus.packaging.native import compiler
from identification.calibrate import calibrate_study
from identification.estimation.arrow_least_squares import Point
from identification.estimation.parameters import InitialState, Parameter, ParameterSet, Tie
from identification.output_error import calibration
from identification.output_error.search.exact import chain, require_agreement
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.small_study import TRUTH, record, write_study

needs_compiler = pytest.mark.skipif(not compiler.available(), reason="no C compiler here")


def problem() -> Problem:
    parameters = ParameterSet(
        (Parameter("a.p", 2.0, scale="log", lower=0.1), Parameter("a.q", -3.0), Parameter("late", 0.1)),
        (Tie("b.p", "a.p", -0.5), Tie("later", "late", 2.0)),
    )
    window = Window("w", "t", np.zeros((9, 1)), np.ones(1))
    return Problem(parameters, (window,), ("a.y",), (InitialState("a.x", (4.0,), estimated=True),))


def test_values_move_with_parameters_ties_and_start_values_but_delays_are_left_out() -> None:
    point = Point(np.array([0.3, 0.1, 0.0]), np.zeros((1, 1)))
    found = chain(problem(), point, 0)
    assert found.columns == (0, 1, 3)
    assert found.names == ("a.p", "b.p", "a.q", "a.x")
    size = 2.0 * np.exp(0.3)
    assert found.slopes == pytest.approx(
        np.array([[size, 0, 0, 0], [-0.5 * size, 0, 0, 0], [0, 3, 0, 0], [0, 0, 0, 4]])
    )


def test_what_acts_in_steps_is_found_by_differences_that_show_another_slope() -> None:
    slope, nothing = np.ones(9), np.zeros(9)
    require_agreement(problem(), {0: [slope]}, {0: [1.01 * slope]})
    require_agreement(problem(), {0: [slope]}, {0: [None]})
    with pytest.raises(TangentsMissing, match=r"a\.q: acts in steps"):
        require_agreement(problem(), {0: [slope], 1: [nothing]}, {0: [slope], 1: [slope]})


def search(folder: Path, data: Path, monkeypatch: pytest.MonkeyPatch, **changes: Any) -> dict[str, Any]:
    """The summary of a calibration of the small study."""
    monkeypatch.setattr(calibration, "processors", lambda: 1)
    calibrate_study(write_study(folder / "small.yaml", **changes), data, folder / "out", lambda fraction, remark: None)
    document: dict[str, Any] = json.loads((folder / "out" / "summary.json").read_text())
    return document


@pytest.mark.slow
@needs_compiler
def test_a_calibration_takes_tangents_where_its_fmus_carry_them_and_says_where_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    data = record(tmp_path / "data")
    exact = search(tmp_path / "exact", data, monkeypatch)
    hand = targets.build("pendulum", tmp_path / "hand.fmu", target="python")
    components = {"motor": {"model": "dc_motor"}, "hand": {"fmu": str(hand), "parameters": {"added_length": 0.1}}}
    other = search(tmp_path / "other", data, monkeypatch, components=components)
    assert exact["search"]["differences"] == ""
    assert "hand: its FMU carries no tangents" in other["search"]["differences"]
    assert exact["search"]["simulations"] < other["search"]["simulations"]
    for name in TRUTH:
        one, two = exact["parameters"][name], other["parameters"][name]
        assert one["value"] == pytest.approx(two["value"], abs=0.02 * two["std"])
        assert one["std"] == pytest.approx(two["std"], rel=1e-3)
