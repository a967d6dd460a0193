"""A profile has every step of every component on its track, and a run is the same whether it is watched or not."""

from __future__ import annotations

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from orchestrator.engine import RunProfile, profile
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import Keeping, ScenarioResult, run_scenario

SCENARIO = """
title: A swing
components:
  motor: {model: dc_motor}
  hand: {model: pendulum, parameters: {angle_start: 0.5}}
connections: [motor.torque -> hand.torque, hand.speed -> motor.speed]
stimuli: {motor.voltage: {constant: 0.1}}
run: {stop: 0.2, step: 0.01}
cases: [{name: first}, {name: second, set: {hand.angle_start: 0.2}}]
"""


def ran(folder: Path, watched: RunProfile | None) -> ScenarioResult:
    file = folder / "swing.yaml"
    file.write_text(SCENARIO)
    return run_scenario(file, keeping=Keeping(profile=watched))


def events(document: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    """track -> its events in time."""
    named = {one["tid"]: one["args"]["name"] for one in document["traceEvents"] if one["name"] == "thread_name"}
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in named.values()}
    for one in document["traceEvents"]:
        if one["ph"] == "X":
            found[named[one["tid"]]].append(one)
    return {track: sorted(own, key=lambda one: one["ts"]) for track, own in found.items()}


def test_every_step_is_an_event_within_its_case(tmp_path: Path) -> None:
    watched = RunProfile()
    ran(tmp_path, watched)
    found = events(watched.document())
    assert set(found) == {"run", "motor", "hand"}
    cases = [one for one in found["run"] if one["name"].startswith("case ")]
    assert [one["name"] for one in cases] == ["case first", "case second"]
    for track in ("motor", "hand"):
        steps = found[track]
        assert [one["args"]["until [s]"] for one in steps] == pytest.approx([0.01 * n for n in range(1, 21)] * 2)
        assert all(before["ts"] + before["dur"] <= after["ts"] + 1e-3 for before, after in pairwise(steps))
        for case, own in zip(cases, (steps[:20], steps[20:]), strict=True):
            assert all(case["ts"] <= one["ts"] and one["dur"] >= 0 for one in own)
            assert own[-1]["ts"] + own[-1]["dur"] <= case["ts"] + case["dur"]


def test_a_watched_run_gives_the_same_and_says_why_it_is_slower(tmp_path: Path) -> None:
    plain, watched = ran(tmp_path, None), ran(tmp_path, RunProfile())
    for one, other in zip(plain.cases, watched.cases, strict=True):
        assert one.trace == other.trace
        assert other.result is not None and other.result.account.reason == "it was asked for"


def test_the_profile_lies_beside_the_report_as_json(tmp_path: Path) -> None:
    write_run(ran(tmp_path, RunProfile()), {}, tmp_path / "out")
    document = json.loads((tmp_path / "out" / "profile.json").read_text())
    assert {"traceEvents", "displayTimeUnit"} <= set(document)
    assert [one["name"] for one in events(document)["run"]][-1] == "write the report"
    write_run(ran(tmp_path, None), {}, tmp_path / "plain")
    assert not (tmp_path / "plain" / "profile.json").exists()


def test_what_is_left_out_of_a_long_profile_is_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(profile, "MOST", 30)
    watched = RunProfile()
    ran(tmp_path, watched)
    document = watched.document()
    assert sum(len(own) for track, own in events(document).items() if track != "run") == 30
    assert document["otherData"] == {"steps left out": 50}
