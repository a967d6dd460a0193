"""The folder of a run: a trace a case, a manifest that says what went in, and a report."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.files import sha256
from orchestrator import formats
from orchestrator.engine import compiled
from orchestrator.results import RECORD
from orchestrator.scenario import accounts
from orchestrator.scenario.report import interruption
from orchestrator.scenario.results import document_of, trace_file, write_run
from orchestrator.scenario.run import Keeping, ScenarioInterrupted, ScenarioResult, run_scenario

SCENARIO: dict[str, Any] = {
    "title": "A swing",
    "description": "Released at 0.5 rad",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},
    "run": {"stop": 0.2, "step": 0.01},
}


def run(folder: Path, overrides: dict[str, Any] | None = None, **changes: Any) -> ScenarioResult:
    folder.mkdir(exist_ok=True)
    path = folder / "swing.yaml"
    path.write_text(json.dumps(SCENARIO | changes))
    return run_scenario(path, overrides)


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {RECORD}


def manifest(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_text(), parse_constant=pytest.fail)
    return document


def test_every_case_leaves_its_trace_bit_for_bit(tmp_path: Path) -> None:
    cases = [{"name": "low"}, {"name": "high", "set": {"hand.angle_start": 0.9}}]
    result = run(tmp_path, cases=cases)
    write_run(result, {}, tmp_path / "out")
    assert names(tmp_path / "out") == {"low.parquet", "high.parquet", "manifest.json", "report.html"}
    for case in result.cases:
        trace = formats.read(tmp_path / "out" / f"{case.name}.parquet").trace
        assert case.result is not None and trace.names == case.result.trace.names
        for name in trace.names:
            np.testing.assert_array_equal(trace[name], case.result.trace[name])
            assert trace.unit(name) == case.result.trace.unit(name)


def test_the_manifest_says_what_went_in_and_how_it_went(tmp_path: Path) -> None:
    result = run(tmp_path, {"hand.inertia": 0.01}, expect=[{"signal": "hand.angle", "below": 0.4}])
    write_run(result, {"hand.inertia": 0.01}, tmp_path / "out")
    document = manifest(tmp_path / "out")
    assert document["scenario"] == {"file": "swing.yaml", "sha256": sha256(tmp_path / "swing.yaml")}
    assert document["overrides"] == {"hand.inertia": 0.01}
    assert document["passed"] is False
    (case,) = document["cases"]
    assert case["trace"] == "run.parquet" and (tmp_path / "out" / case["trace"]).is_file()
    (check,) = case["checks"]
    assert (check["text"], check["held"], check["found"]) == (
        "hand.angle stays below 0.4 rad",
        False,
        "largest 0.5 rad",
    )
    assert (check["figure"], check["unit"], check["margin"]) == (0.5, "rad", pytest.approx(-0.1))
    assert case["statistics"]["hand"]["calls"] == 20 and case["statistics"]["hand"]["seconds"] > 0
    assert "servotwin" in document["versions"] and document["fmus"] == {"hand": "model"}
    assert document == document_of(result, {"hand.inertia": 0.01}, tmp_path / "out")


def test_the_manifest_says_how_the_record_was_made(tmp_path: Path) -> None:
    cases = [{"name": "a"}, {"name": "wrong", "set": {"hand.inertia": -1}, "expect": [{"refused": "bounds"}]}]
    path = tmp_path / "swing.yaml"
    path.write_text(json.dumps(SCENARIO | {"cases": cases}))
    (tmp_path / "aside").mkdir()
    write_run(run_scenario(path, keeping=Keeping(4, tmp_path / "aside")), {}, tmp_path / "out")
    document = manifest(tmp_path / "out")
    assert document["record"] == {"stride": 4, "stream": True} and document["interrupted"] is False
    made, refused = document["cases"]
    stepping = made["stepping"]
    compiled_loop = compiled.available()
    assert stepping["engine"] == ("compiled" if compiled_loop else "python")
    assert stepping["reason"] == ("" if compiled_loop else compiled.NOT_BUILT)
    assert (stepping["steps"], stepping["step"], stepping["start"], stepping["reached"]) == (20, 0.01, 0.0, 0.2)
    assert stepping["real_time_factor"] == pytest.approx(0.2 / stepping["seconds"], rel=0.01)
    assert made["statistics"]["hand"]["share"] + made["loop"]["share"] == pytest.approx(100, abs=0.02)
    assert made["state"] == refused["state"] == "done" and "stepping" not in refused


GAIN = '''"""Half of what comes in."""
from .model import Model, input_, output

def outputs(t, x, u, p):
    return {"y": 0.5 * u.u}

MODEL = Model("gain", "Gain", (input_("u", "1", "Input"), output("y", "1", "Output")), outputs=outputs)
'''


def test_a_loop_in_python_is_explained(tmp_path: Path) -> None:
    (tmp_path / "gain.py").write_text(GAIN)
    components = {name: {"model": "gain.py"} for name in ("one", "two")}
    result = run(
        tmp_path,
        components=components,
        connections=["one.y -> two.u", "two.y -> one.u"],
        run={"stop": 0.2, "step": 0.01, "cycles": {}},
    )
    stepping = document_of(result, {}, tmp_path)["cases"][0]["stepping"]
    assert stepping["engine"] == "python"
    reason = "there is a cycle of direct feed-through to be iterated" if compiled.available() else compiled.NOT_BUILT
    assert stepping["reason"] == reason
    assert f"by the loop in Python ({reason});" in accounts.sentence_of(result)


def test_a_refused_case_has_its_reason_and_no_trace(tmp_path: Path) -> None:
    cases = [
        {"name": "fine"},
        {"name": "wrong", "set": {"hand.inertia": -1}, "expect": [{"refused": "outside its bounds"}]},
    ]
    result = run(tmp_path, cases=cases)
    write_run(result, {}, tmp_path / "out")
    fine, wrong = manifest(tmp_path / "out")["cases"]
    assert fine["error"] is None and "trace" in fine
    assert "outside its bounds" in wrong["error"] and "trace" not in wrong and wrong["passed"]
    assert names(tmp_path / "out") == {"fine.parquet", "manifest.json", "report.html"}


def test_a_recorder_leaves_text_as_a_logger_would(tmp_path: Path) -> None:
    recorder = {"signals": {"angle": "hand.angle"}, "every": 0.02, "seed": 3}
    write_run(run(tmp_path, recorder=recorder), {}, tmp_path / "out")
    trace = formats.read(tmp_path / "out" / "run.csv").trace
    assert trace.names == ("angle",) and trace.unit("angle") == "rad"
    assert np.ptp(np.diff(trace.time)) > 0


@pytest.mark.parametrize(
    ("cases", "files"),
    [
        (["a b", "a_b", "a/b"], ["a_b.parquet", "a_b-2.parquet", "a_b-3.parquet"]),
        (["../../up", "C:\\x"], [".._.._up.parquet", "C_x.parquet"]),
        (["", "¼ Öl"], ["_.parquet", "¼_Öl.parquet"]),
    ],
)
def test_any_name_of_a_case_gives_a_file_of_its_own_in_the_folder(
    tmp_path: Path, cases: list[str], files: list[str]
) -> None:
    result = run(tmp_path, cases=[{"name": name} for name in cases])
    assert [trace_file(result, case) for case in result.cases] == files
    write_run(result, {}, tmp_path / "out")
    assert names(tmp_path / "out") == {*files, "manifest.json", "report.html"}
    assert names(tmp_path) == {"out", "swing.yaml"}


def test_a_case_named_like_another_ones_file_does_not_overwrite_it(tmp_path: Path) -> None:
    result = run(tmp_path, cases=[{"name": name} for name in ("a_b-2", "a b", "a_b", "a_b-3", "A_B")])
    found = [trace_file(result, case) for case in result.cases]
    assert len({name.casefold() for name in found}) == 5


def test_two_runs_leave_the_same_bytes_in_their_traces(tmp_path: Path) -> None:
    for name in ("one", "two"):
        write_run(run(tmp_path / name, cases=[{"name": "a"}, {"name": "b"}]), {}, tmp_path / name / "out")
    for case in ("a", "b"):
        one, two = (tmp_path / name / "out" / f"{case}.parquet" for name in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()


def test_a_second_run_replaces_the_first(tmp_path: Path) -> None:
    for case in ("first", "second"):
        write_run(run(tmp_path, cases=[{"name": case}]), {}, tmp_path / "out")
    assert names(tmp_path / "out") == {"second.parquet", "manifest.json", "report.html"}


def test_every_check_and_every_case_without_one_has_a_row(tmp_path: Path) -> None:
    expect = [{"signal": "hand.angle", "below": 1}, {"signal": "hand.angle", "above": 0.49}]
    result = run(tmp_path, cases=[{"name": "a", "expect": expect}, {"name": "b"}])
    assert [row[:3] for row in result.rows()] == [
        ("a", "hand.angle stays below 1 rad", "yes"),
        ("a", "hand.angle stays above 0.49 rad", "NO"),
        ("b", "-", "-"),
    ]


def test_the_report_shows_checks_and_a_limited_number_of_cases(tmp_path: Path) -> None:
    cases = [{"name": f"case {number}"} for number in range(14)]
    result = run(tmp_path, cases=cases, expect=[{"signal": "hand.angle", "below": 1}])
    write_run(result, {}, tmp_path / "out")
    html = (tmp_path / "out" / "report.html").read_text()
    assert "A swing" in html and "Released at 0.5 rad" in html and "All held." in html
    assert "The first 12 of 14 cases." in html and "stays below 1" in html
    assert "://" not in html
    assert "280 steps of 0.01 s in " in html and "recorded every step." in html and "(the loop itself)" in html


def test_an_interrupted_run_leaves_what_it_has_and_says_how_far_it_came(tmp_path: Path) -> None:
    def stop(fraction: float, doing: str) -> None:
        if fraction > 0.6:
            raise KeyboardInterrupt

    path = tmp_path / "swing.yaml"
    changes = {
        "cases": [{"name": name} for name in "abc"],
        "run": {"stop": 300, "step": 0.01},
        "recorder": {"signals": {"angle": "hand.angle"}, "every": 0.5},
    }
    path.write_text(json.dumps(SCENARIO | changes))
    with pytest.raises(ScenarioInterrupted) as stopped:
        run_scenario(path, progress=stop)
    write_run(stopped.value.result, {}, tmp_path / "out")
    assert names(tmp_path / "out") == {"a.csv", "b.csv", "manifest.json", "report.html"}
    reached = manifest(tmp_path / "out")["cases"][1]["stepping"]["reached"]
    last = formats.read(tmp_path / "out" / "b.csv").trace.time[-1]
    assert reached - 5 < last < reached <= 300
    assert interruption(stopped.value.result) == f"interrupted at t = {reached:g} s of case b"
    assert [row[3] for row in stopped.value.result.rows()] == [
        "ran through",
        f"interrupted at t = {reached:g} s",
        "not run",
    ]
    html = (tmp_path / "out" / "report.html").read_text()
    assert f"The run was interrupted at t = {reached:g} s of case b." in html and "held." not in html


def test_the_manifest_says_what_was_seen_in_recordings(tmp_path: Path) -> None:
    (tmp_path / "odd.csv").write_text("time [s];torque [N.m];angle [rad]\n0;0,5;0,5\n1;0,5;0,5\n")
    recording = {"file": "odd.csv", "signal": "torque"}
    near = {"signal": "hand.angle", "reference": {"file": "odd.csv", "signal": "angle"}, "within": 9}
    result = run(tmp_path, stimuli={"hand.torque": recording}, expect=[near])
    told = ["odd.csv: its cells are separated by ;", "odd.csv: its numbers have decimal commas"]
    document = document_of(result, {}, tmp_path / "out")
    assert document["notes"] == told
    digest = hashlib.sha256((tmp_path / "odd.csv").read_bytes()).hexdigest()
    assert document["recordings"] == [
        {"read_for": what, "file": "odd.csv", "sha256": digest} for what in ("stimulus hand.torque", "reference")
    ]
