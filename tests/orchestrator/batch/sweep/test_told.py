"""What a sweep tells: a page, sensitivities that are right, and runs that can be looked at by themselves."""

from __future__ import annotations

import itertools
import json
import re
from pathlib import Path

import numpy as np
import pytest

import orchestrator
from fmus.errors import InputError
from orchestrator.batch.sweep.points.designs import Morris, SobolIndices
from orchestrator.batch.sweep.points.factors import Factor, Space, UniformBetween
from orchestrator.batch.sweep.runs.preparation import prepared
from orchestrator.batch.sweep.sweep import sweep
from orchestrator.batch.sweep.told.again import alone
from orchestrator.batch.sweep.told.report import report
from orchestrator.batch.sweep.told.result import load_result
from orchestrator.batch.sweep.told.sensitivity import indices, rank_correlations
from orchestrator.info import about
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import FloatArray
from tests.support.commands import servotwin
from tests.support.sweeping import FALLING, Here, study

ANGLES = Space(tuple(Factor(f"a.x{number}", UniformBetween(-np.pi, np.pi)) for number in range(1, 4)))
FIRST, TOTAL = (0.3139, 0.4424, 0.0), (0.5576, 0.4424, 0.2437)  # of Ishigami's function, a = 7, b = 0.1


def ishigami(x: FloatArray) -> FloatArray:
    return np.asarray(np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]))


@pytest.mark.needs("sensitivity")
def test_sobol_indices_of_ishigamis_function_are_the_known_ones() -> None:
    design = SobolIndices(space=ANGLES, count=1024 * 5, seed=1)
    points = design.points(0, design.count)
    found = indices(design, points, ishigami(points), ANGLES.names)
    assert found is not None and (found.groups, found.left_out) == (1024, 0)
    for entry in found.entries:
        known = dict(zip(ANGLES.names, FIRST if entry.kind == "S1" else TOTAL, strict=True))[entry.factor]
        assert entry.confidence is not None and abs(entry.value - known) < 2 * entry.confidence + 0.005


@pytest.mark.needs("sensitivity")
def test_groups_with_a_failed_run_are_left_out_and_counted() -> None:
    design = SobolIndices(space=ANGLES, count=1024 * 5, seed=1)
    points = design.points(0, design.count)
    figures = ishigami(points)
    figures[[7, 8, 3000]] = np.nan
    found = indices(design, points, figures, ANGLES.names)
    assert found is not None and (found.groups, found.left_out) == (1022, 2)


@pytest.mark.needs("sensitivity")
def test_elementary_effects_of_a_plane_are_its_slopes() -> None:
    space = Space(tuple(Factor(f"a.x{number}", UniformBetween(0.0, 1.0)) for number in range(3)))
    design = Morris(space=space, count=40, seed=1)
    points = design.points(0, design.count)
    found = indices(design, points, points @ [3.0, -1.0, 0.5], space.names)
    assert found is not None
    assert [one.value for one in found.entries if one.kind == "mu*"] == pytest.approx([3.0, 1.0, 0.5])
    assert [one.value for one in found.entries if one.kind == "sigma"] == pytest.approx([0.0] * 3, abs=1e-12)


def test_rank_correlations_are_one_where_a_figure_rises_and_none_where_nothing_varies() -> None:
    x = np.linspace(0.1, 1, 30)
    found = rank_correlations(np.stack([x, -x, np.ones(30)], axis=1), np.exp(5 * x))
    assert found[:2] == pytest.approx([1, -1]) and np.isnan(found[2])


def test_a_run_by_itself_gives_its_row_to_the_bit(tmp_path: Path) -> None:
    file = study(tmp_path)
    row = sweep(file, tmp_path / "out", Here()).table().to_pylist()[13]
    with prepared(file) as ready:
        (case,) = run_scenario(alone(ready, 13)).cases
        with pytest.raises(InputError, match="give one from 0 to 19"):
            alone(ready, 20)
    assert (case.checks[0].figure, case.checks[0].margin) == (row["e1"], row["e1_margin"])
    assert case.trace["hand.angle"][::10].tolist() == row["hand.angle"]


def test_the_page_has_what_to_look_at_and_how_to_run_it_again(tmp_path: Path) -> None:
    vary = {"hand.added_mass": {"normal": 0.01, "std": 0.02}, "hand.angle_start": {"between": [0.5, 2]}}
    file = study(tmp_path, vary=vary)
    result = sweep(file, tmp_path / "out", Here())
    page = (tmp_path / "out" / "report.html").read_text()
    assert f"servotwin sweep {file} --run {result.document['asked'][0]['worst']}" in page
    assert 0 < result.document["failed"] < 20 and "outside its bounds" in page
    for words in (
        "Rank correlations",
        "Runs over each two",
        "median, 5 to 95 %",
        "Histograms",
        "Clopper",
    ):
        assert words in page


def test_the_page_has_the_factors_over_each_other_those_that_decide_first(tmp_path: Path) -> None:
    start, mass, length = "hand.angle_start", "hand.added_mass", "hand.added_length"
    vary = {mass: {"between": [0.05, 0.06]}, length: {"between": [0.1, 0.11]}, start: {"between": [0.5, 2]}}
    file = study(tmp_path, vary=vary, design={"by": "sobol", "samples": 32, "seed": 1}, traces=None)
    result = sweep(file, tmp_path / "out", Here())
    assert 0 < result.document["passing"]["held"] < 32
    page = (tmp_path / "out" / "report.html").read_text()
    pairs = re.findall(r"(hand\.\w+) over (hand\.\w+)", page)
    assert {frozenset(pair) for pair in pairs} == {frozenset(two) for two in itertools.combinations(vary, 2)}
    assert pairs[0][1] == start


def test_a_page_of_many_runs_shows_some_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("orchestrator.batch.sweep.told.numbers.SHOWN", 7)
    file = study(tmp_path)
    result = sweep(file, tmp_path / "out", Here())
    with prepared(file) as ready:
        assert "of 7 runs, spread evenly" in report(ready, result).render()


def test_each_case_has_its_own_share_of_runs_that_pass(tmp_path: Path) -> None:
    still = {"name": "still", "expect": [{"signal": "hand.speed", "peak": {"at_most": 0.0}}]}
    file = study(tmp_path, {**FALLING, "cases": [{"name": "free"}, still]})
    document = sweep(file, tmp_path / "out", Here()).document
    found = {one["text"]: (one["held"], one["of"]) for one in document["by_case"]}
    assert found == {"passes in case free": (document["passing"]["held"], 20), "passes in case still": (0, 20)}
    assert sweep(study(tmp_path / "one"), tmp_path / "other", Here()).document["by_case"] == []


def test_a_result_is_read_from_its_folder(tmp_path: Path) -> None:
    made = sweep(study(tmp_path), tmp_path / "out", Here())
    found = load_result(tmp_path / "out")
    assert found.document == made.document and found.table().equals(made.table())
    with pytest.raises(InputError, match=r"has no manifest\.jsonl"):
        load_result(tmp_path)


@pytest.mark.slow
def test_the_command_says_what_its_python_function_gives(tmp_path: Path) -> None:
    file = study(tmp_path)
    told = servotwin("sweep", file, "-j", "1", "--out", tmp_path / "out", "--json")
    assert told.exit_code == 0, told.output
    made = orchestrator.sweep(file, tmp_path / "out", Here())
    assert json.loads(told.stdout) == {**made.document, "out": str(tmp_path / "out")}
    assert made.rows()[1][0] in made._repr_html_()
    again = servotwin("sweep", file, "--run", "13", "--out", tmp_path / "run", "--json")
    (case,) = json.loads(again.stdout)["cases"]
    assert case["checks"][0]["figure"] == made.column("e1")[13]
    assert (tmp_path / "run" / "report.html").exists()


def test_info_tells_of_a_sweep_and_of_one_that_has_not_come_to_its_end(tmp_path: Path) -> None:
    sweep(study(tmp_path), tmp_path / "out", Here())
    assert {"runs": 20, "points": 20, "failed": 0}.items() <= about(tmp_path / "out").items()
    (tmp_path / "out" / "summary.json").unlink()
    assert about(tmp_path / "out") == {"name": "sweep of falling.yaml", "unfinished": "20 of 20 runs", "failed": 0}


def test_values_of_cases_that_do_not_count_since_they_vary_are_told(tmp_path: Path) -> None:
    cases = [{"name": "low", "set": {"hand.angle_start": 0.3}}, {"name": "high"}]
    result = sweep(study(tmp_path, {**FALLING, "cases": cases}), tmp_path / "out", Here())
    told = "hand.angle_start varies, so its values in the cases do not count: 0.3 in low; 0.5 in high"
    assert result.document["notes"] == [told]
    assert result.column("e1")[0] == result.column("e1")[1]


def test_a_sweep_of_which_every_run_failed_ends_with_3_and_says_why_the_first_did(tmp_path: Path) -> None:
    design = {"by": "monte-carlo", "samples": 3, "seed": 1}
    file = study(tmp_path, vary={"hand.added_mass": {"normal": -5, "std": 0.1}}, design=design)
    told = servotwin("sweep", file, "-j", "1", "--out", tmp_path / "out")
    assert told.exit_code == 3
    assert "all 3 runs failed, the first one so: " in " ".join(told.stderr.split())
    assert "outside its bounds" in told.stderr
