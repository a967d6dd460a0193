"""What a notebook calls does what the commands do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.errors import InputError, ScenarioError, WiringError
from orchestrator import Tolerance, Trace, accept, compare, run, write

SWING = """
title: A swing
components:
  hand: {model: pendulum, parameters: {angle_start: 0.5}}
run: {stop: 0.5, step: 0.01}
cases:
  - {name: low}
  - {name: high, set: {hand.angle_start: 0.6}}
expect: [{signal: hand.angle, reference: accepted, within: 0.01}]
"""


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    (tmp_path / "swing.yaml").write_text(SWING)
    return tmp_path / "swing.yaml"


def test_traces_results_and_paths_are_compared_alike(swing: Path, tmp_path: Path) -> None:
    result = run(swing)
    trace = result.cases[0].trace
    write(trace, tmp_path / "low.parquet")
    assert compare(result, str(swing)).agree
    assert compare(trace, tmp_path / "low.parquet").agree
    moved = Trace(trace.time, {"angle": trace["hand.angle"] + np.where(trace.time > 0.2, 1e-3, 0.0)}, {"angle": "rad"})
    found = compare(trace, moved, names={"angle": "hand.angle"})
    assert found.first is not None and found.first[1].first == pytest.approx(0.21)
    assert compare(trace, moved, names={"angle": "hand.angle"}, tolerance=Tolerance(within={"hand.angle": 0.1})).agree
    assert not compare(result, moved, case="high", names={"angle": "hand.angle"}).agree


def test_references_are_accepted_and_hold_from_then_on(swing: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    assert not run(swing).passed
    assert [len(accept(swing, write=False, out=out).written), len(accept(swing, case="low", out=out).written)] == [2, 1]
    assert [new.case for new in accept(swing, out=out).written] == ["high"]
    assert run(swing).passed and accept(swing, out=out).written == []
    assert (out / "report.html").is_file()


def test_a_scenario_that_fails_is_an_error_and_those_beside_it_are_accepted(swing: Path, tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text(SWING.replace("hand.angle_start: 0.6", "hand.angle: 0.6"))
    with pytest.raises(WiringError, match=r"broken\.yaml"):
        accept(tmp_path, out=tmp_path / "out")
    assert run(swing).passed
    with pytest.raises(InputError, match="is for one scenario"):
        accept(tmp_path, case="low", out=tmp_path / "out")
    with pytest.raises(ScenarioError, match="no such file"):
        accept(tmp_path / "nothing.yaml")
