"""The suite judges each file by its keys, in another process, and says so in JUnit's words."""

from __future__ import annotations

import json
import os
import time
from pathlib import Path
from xml.etree import ElementTree as ET

import pytest

from fmus.errors import InputError, ScenarioError
from fmus.packaging.native import compiler
from orchestrator.batch.discovery import SuiteFile, find_scenarios
from orchestrator.batch.junit import write_junit
from orchestrator.batch.limits import CaseLimits
from orchestrator.batch.procedure import run_procedure
from orchestrator.batch.suite import run_suite
from orchestrator.batch.verdict import Verdict
from orchestrator.results import FileDocument
from tests.support.commands import servotwin

RUN = """
title: falling
components: {hand: {model: pendulum}}
run: {stop: 0.1, step: 0.01}
"""


def judge(file: Path, out: Path) -> FileDocument:
    """Takes 50 ms; refuses, crashes, breaks, or passes where the file says so."""
    time.sleep(0.05)
    text = file.read_text()
    if "refuse" in text:
        raise InputError(file, "is refused")
    if "break" in text:
        raise KeyError("no such thing")
    if "crash" in text:
        os._exit(3)
    check = {"text": "it passes", "held": "pass" in text, "found": f"in process {os.getpid()}"}
    case = {"name": "only", "passed": check["held"], "error": None, "checks": [check]}
    return {"title": "judged", "passed": check["held"], "out": str(out), "cases": [case]}  # type: ignore[typeddict-item]


def written(folder: Path, **texts: str) -> dict[str, Path]:
    files = {name: folder / f"{name}.yaml" for name in texts}
    for name, text in texts.items():
        files[name].write_text(text)
    return files


def test_a_file_is_judged_by_its_keys_and_one_side_of_a_bus_only_where_it_is_named(tmp_path: Path) -> None:
    bus = RUN + "can: {database: rig.dbc, receive: {hand.torque: {signal: t, safe: 0}}}"
    files = written(
        tmp_path,
        run=RUN,
        steps="title: a\nprocedure: [{run: [info x]}]",
        claims="claims: []",
        bus=bus,
        other="title: nothing",
    )
    found = {task.file: task.judge for task in find_scenarios([tmp_path], {"claims": judge})}
    assert list(found) == [files[name] for name in ("claims", "run", "steps")]
    assert (found[files["claims"]], found[files["steps"]]) == (judge, run_procedure)
    assert [task.file for task in find_scenarios([files["bus"], files["bus"]], {})] == [files["bus"]]
    assert files["claims"] not in [task.file for task in find_scenarios([tmp_path], {})]


def test_what_is_nothing_for_the_suite_is_refused_where_it_is_named(tmp_path: Path) -> None:
    files = written(tmp_path, other="title: nothing")
    with pytest.raises(ScenarioError, match=r"other\.yaml:1: .*is missing"):
        find_scenarios([files["other"]], {})
    with pytest.raises(ScenarioError, match="there is no scenario"):
        find_scenarios([tmp_path], {})
    with pytest.raises(ScenarioError, match="no such file or folder"):
        find_scenarios([tmp_path / "missing"], {})


@pytest.mark.slow
def test_every_file_has_a_verdict_of_its_own_and_the_time_it_took(tmp_path: Path) -> None:
    texts = ("break", "pass", "miss", "refuse", "crash")
    files = written(tmp_path, **{text: f"claims: {text}" for text in texts})
    told: list[Path] = []
    judged = [SuiteFile(files[text], judge, Path("all", text)) for text in texts]
    verdicts = run_suite(judged, tmp_path / "out", 2, lambda verdict: told.append(verdict.file))
    assert [verdict.file for verdict in verdicts] == [task.file for task in judged] == [files[text] for text in texts]
    assert sorted(told) == sorted(files.values())
    assert [verdict.passed for verdict in verdicts] == [False, True, False, False, False]
    assert [verdict.error.partition(": ")[2].partition(";")[0] for verdict in verdicts] == [
        "KeyError: 'no such thing'",
        "",
        "",
        "is refused",
        "an FMU crashed the process that ran it, which died (exit code 3)",
    ]
    assert ["KeyError" in verdict.fault for verdict in verdicts] == [True, *[False] * 4]
    assert all(verdict.seconds >= 0.05 for verdict in verdicts)
    processes = {verdict.document["cases"][0]["checks"][0]["found"] for verdict in verdicts if verdict.document}
    assert len(processes) == 2 and f"in process {os.getpid()}" not in processes


def judge_that_tells_of_fmus(file: Path, out: Path) -> FileDocument:
    """As `judge`; says that it has run what the file names: a model, a file, or nothing."""
    document = judge(file, out)
    kind = file.read_text().split()[-1]
    return {**document, "fmus": {} if kind == "nothing" else {"hand": kind}}  # type: ignore[typeddict-unknown-key]


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
@pytest.mark.parametrize("limits", [None, CaseLimits(seconds=60), CaseLimits(megabytes=4000)])
def test_a_process_takes_files_until_one_has_run_what_may_leave_something_behind(
    tmp_path: Path, limits: CaseLimits | None
) -> None:
    kinds = ["pass model", "miss model", "pass file", "pass nothing", "pass model", "crash", "pass model", "refuse"]
    files = [tmp_path / f"{number}.yaml" for number in range(len(kinds))]
    for file, text in zip(files, kinds, strict=True):
        file.write_text(f"claims: {text}")
    tasks = [SuiteFile(file, judge_that_tells_of_fmus, Path("all", file.stem)) for file in files]
    verdicts = run_suite(tasks, tmp_path / "out", 1, limits=limits)
    assert [verdict.passed for verdict in verdicts] == [text.startswith("pass") for text in kinds]
    assert "died (exit code 3)" in verdicts[5].error and "is refused" in verdicts[7].error
    told = [verdict.cases[0]["checks"][0]["found"] for verdict in verdicts if verdict.document]
    alike = [told.index(one) for one in told]
    assert alike == ([0, 0, 0, 3, 4, 5] if limits is None or limits.megabytes is None else [0, 1, 2, 3, 4, 5])


@pytest.mark.slow
def test_a_scenario_gives_the_same_bytes_beside_others_in_a_process_as_alone(tmp_path: Path) -> None:
    written(tmp_path, a=RUN, b=RUN.replace("pendulum", "dc_motor"), c=RUN)
    for jobs in (1, 3):
        verdicts = run_suite(find_scenarios([tmp_path], {}), tmp_path / str(jobs), jobs)
        assert all(verdict.passed for verdict in verdicts)
    traces = [{file.parent.name: file.read_bytes() for file in (tmp_path / jobs).rglob("*.parquet")} for jobs in "13"]
    assert set(traces[0]) == {"a", "b", "c"} and traces[0] == traces[1] and traces[0]["a"] == traces[0]["c"]


@pytest.mark.slow
def test_a_fault_of_ours_fails_its_file_and_is_the_exit_code_when_all_are_done(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("orchestrator.cli.suite.JUDGES", {"claims": judge})
    files = written(tmp_path, a="claims: break", b="claims: pass")
    arguments = [str(tmp_path), "--out", str(tmp_path / "out"), "--json", "-vv"]
    answer = servotwin("test", *arguments)
    document = json.loads(answer.stdout)
    assert answer.exit_code == 4 and [one["passed"] for one in document["scenarios"]] == [False, True]
    assert document["scenarios"][0]["error"].startswith("a fault of servotwin: KeyError: 'no such thing'; ")
    assert "in judge" in answer.stderr and f"{files['a']}: met a fault of servotwin" in answer.stderr


def test_a_file_that_cannot_be_read_is_one_that_fails(tmp_path: Path) -> None:
    files = written(tmp_path, broken="title: [", run=RUN)
    assert [task.file for task in find_scenarios([tmp_path], {})] == [files["broken"], files["run"]]
    with pytest.raises(ScenarioError, match="is not YAML"):
        find_scenarios([files["broken"]], {})


def test_results_of_a_folder_lie_two_levels_deep_so_that_none_lies_in_another(tmp_path: Path) -> None:
    for inside in ("arm", "arm/control", "arm/control/fine"):
        (tmp_path / inside).mkdir()
        written(tmp_path / inside, control=RUN)
    written(tmp_path, top=RUN)
    places = [str(task.place) for task in find_scenarios([tmp_path], {})]
    assert places == ["arm.control/control", "arm.control.fine/control", "arm/control", f"{tmp_path.name}/top"]


def test_two_files_that_would_write_one_folder_are_refused_with_both(tmp_path: Path) -> None:
    for inside in ("a/x", "b/x"):
        (tmp_path / inside).mkdir(parents=True)
        written(tmp_path / inside, step=RUN)
    with pytest.raises(ScenarioError, match=r"b/x/step\.yaml: would write .* x/step, and so would .*a/x/step\.yaml"):
        find_scenarios([tmp_path / "a" / "x", tmp_path / "b" / "x"], {})
    assert len(find_scenarios([tmp_path], {})) == 2


def test_junit_tells_failures_from_errors_with_times_and_the_figure_of_each_check(tmp_path: Path) -> None:
    checks = [{"text": "y < 1", "held": False, "found": "largest 2"}, {"text": "y > 0", "held": True, "found": "1"}]
    cases = [
        {"name": "a", "passed": True, "error": None, "checks": [], "seconds": 0.25},
        {"name": "<b>", "passed": False, "error": None, "checks": checks, "seconds": 0.5},
        {"name": "c\0", "passed": False, "error": "the FMU broke", "checks": checks, "seconds": 0.125},
    ]
    document: FileDocument = {"title": "t", "passed": False, "out": "out", "cases": cases}  # type: ignore[typeddict-item]
    verdicts = [
        Verdict(Path("x/one.yaml"), 1.25, document),
        Verdict(Path("x/two.yaml"), 0.5, None, "two.yaml: is refused"),
    ]
    write_junit(verdicts, tmp_path / "junit.xml")
    root = ET.parse(tmp_path / "junit.xml").getroot()
    one, two = root
    counts = {"tests": "3", "failures": "1", "errors": "1", "time": "1.250"}
    assert one.attrib == {"name": "x/one.yaml", **counts}
    assert (root.get("tests"), root.get("failures"), root.get("errors"), root.get("time")) == ("4", "1", "2", "1.750")
    assert {each.get("name"): each.get("value") for each in one[0]} == {"title": "t", "results": "out"}
    a, b, c = one.findall("testcase")
    assert [each.get("name") for each in (a, b, c)] == ["a", "<b>", "c\\x00"]
    assert [each.get("time") for each in (a, b, c)] == ["0.250", "0.500", "0.125"]
    assert {each.get("name"): each.get("value") for each in b.iter("property")} == {"y < 1": "largest 2", "y > 0": "1"}
    (failure,) = b.findall("failure")
    (error,) = c.findall("error")
    assert (failure.get("message"), error.get("message")) == ("y < 1, found largest 2", "the FMU broke")
    assert two.get("errors") == "1" and two[0][0].tag == "error"
    assert two[0][0].get("message") == "two.yaml: is refused"
