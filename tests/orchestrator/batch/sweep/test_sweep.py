"""A study becomes one data set; what is there is not run again, and bytes do not depend on how it came to be."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import InputError
from orchestrator.batch.sweep.runs import folder as folders
from orchestrator.batch.sweep.runs.setup import Chunk
from orchestrator.batch.sweep.sweep import sweep
from orchestrator.scenario.run import run_scenario
from tests.support.sweeping import FALLING, Here, results, study


class Killed(BaseException):
    """The process is gone."""


def killed_after(count: int) -> Here:
    seen = []

    def told(task: Chunk) -> None:
        seen.append(task)
        if len(seen) > count:
            raise Killed

    return Here(told=told)


def test_a_row_is_what_a_run_of_the_scenario_with_its_values_gives(tmp_path: Path) -> None:
    result = sweep(study(tmp_path), tmp_path / "out", Here())
    row = result.table().to_pylist()[7]
    values = {name: row[name] for name in ("hand.added_mass", "hand.angle_start")}
    case = run_scenario(tmp_path / "falling.yaml", values).cases[0]
    (check,) = case.checks
    assert (row["e1"], row["e1_held"], row["e1_margin"]) == (check.figure, check.held, check.margin)
    assert row["passed"] == case.passed and row["state"] == "done" and row["reason"] is None
    assert row["time"] == pytest.approx(np.arange(6) / 10)
    assert row["hand.angle"] == case.trace["hand.angle"][::10].tolist()


def test_values_lie_where_the_study_says_in_the_units_of_the_variables(tmp_path: Path) -> None:
    result = sweep(study(tmp_path), tmp_path / "out", Here())
    mass, angle = result.column("hand.added_mass"), result.column("hand.angle_start")
    assert mass.min() >= 0.05 and mass.max() <= 0.15 and abs(mass.mean() - 0.1) < 4 * 0.01 / math.sqrt(20)
    assert angle.min() >= math.radians(30) and angle.max() <= math.radians(90) and angle.max() - angle.min() > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("size", [1000, 7])
@pytest.mark.parametrize("after", [0, 1, 3, 5])
def test_a_study_that_was_killed_goes_on_to_the_same_bytes(
    tmp_path: Path, after: int, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "LARGEST_PART", size)
    file = study(tmp_path)
    sweep(file, tmp_path / "whole", Here())
    runs: list[int] = []
    with pytest.raises(Killed):
        sweep(file, tmp_path / "out", killed_after(after))
    sweep(file, tmp_path / "out", Here(told=lambda task: runs.extend(task.runs.tolist())))
    assert results(tmp_path / "out") == results(tmp_path / "whole")
    assert len(runs) == len(set(runs)) < 20 or after == 0
    assert list((tmp_path / "out" / "pending").iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("first", [5, 7, 14, 19])
def test_more_samples_extend_a_study_to_the_bytes_of_the_larger_one(
    tmp_path: Path, first: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(folders, "LARGEST_PART", 7)
    small = study(tmp_path, design={"by": "monte-carlo", "samples": first, "seed": 3})
    sweep(small, tmp_path / "out", Here())
    runs: list[int] = []
    sweep(study(tmp_path), tmp_path / "out", Here(told=lambda task: runs.extend(task.runs.tolist())))
    sweep(study(tmp_path), tmp_path / "whole", Here())
    assert runs == list(range(first, 20))
    assert results(tmp_path / "out") == results(tmp_path / "whole")


def test_a_run_that_fails_is_a_row_with_its_reason_and_is_run_again_when_asked(tmp_path: Path) -> None:
    expected = [*FALLING["expect"], {"signal": "hand.energy", "above": -1}]  # type: ignore[misc]
    file = study(
        tmp_path,
        FALLING | {"expect": expected},
        vary={"hand.added_mass": {"normal": 0.0, "std": 0.1}},
        design={"by": "monte-carlo", "samples": 12, "seed": 1},
    )
    result = sweep(file, tmp_path / "out", Here())
    rows = result.table().to_pylist()
    failed = [row for row in rows if row["state"] == "failed"]
    assert 0 < len(failed) < 12 and result.document["failed"] == len(failed)
    assert all(row["hand.added_mass"] < 0 and "outside its bounds" in row["reason"] for row in failed)
    assert all(row["e1_held"] is None and row["time"] is None and row["passed"] is False for row in failed)
    before, runs = results(tmp_path / "out"), list[int]()
    sweep(file, tmp_path / "out", Here(told=lambda task: runs.extend(task.runs.tolist())), retry=True)
    assert runs == [row["run"] for row in failed]
    assert results(tmp_path / "out") == before


def test_a_folder_of_another_study_is_refused_with_what_differs(tmp_path: Path) -> None:
    sweep(study(tmp_path), tmp_path / "out", Here())
    before = results(tmp_path / "out")
    other = study(tmp_path, design={"by": "monte-carlo", "samples": 20, "seed": 4})
    with pytest.raises(InputError, match=r"holds another study: design\.seed was 3 and is 4"):
        sweep(other, tmp_path / "out", Here())
    changed = study(tmp_path, FALLING | {"run": {"stop": 0.4, "step": 0.01}})
    with pytest.raises(InputError, match=r"another study: files\.falling\.yaml was"):
        sweep(changed, tmp_path / "out", Here())
    fewer = study(tmp_path, design={"by": "monte-carlo", "samples": 10, "seed": 3})
    with pytest.raises(InputError, match="holds more than the 10 runs"):
        sweep(fewer, tmp_path / "out", Here())
    assert results(tmp_path / "out") == before


def test_the_summary_says_how_often_all_held_with_its_binomial_interval(tmp_path: Path) -> None:
    result = sweep(study(tmp_path, at_least=0.9), tmp_path / "out", Here())
    asked, held = result.document["asked"][0], int(result.column("e1_held").sum())
    assert (asked["held"], asked["of"], asked["share"]) == (held, 20, held / 20)
    assert asked["interval"] is not None and asked["interval"][0] < held / 20 < asked["interval"][1]
    assert asked["worst"] == int(np.argmin(result.column("e1_margin")))
    assert result.passed == (held >= 18)
    assert json.loads((tmp_path / "out" / "summary.json").read_text()) == json.loads(json.dumps(result.document))
