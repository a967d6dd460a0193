"""A run whose record goes to its file while it runs leaves the same file and the same verdicts; a stride thins it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from fmus.errors import ScenarioError
from orchestrator import formats
from orchestrator.formats import parquet
from orchestrator.scenario.results import write_run
from orchestrator.scenario.run import Keeping, ScenarioResult, run_scenario
from orchestrator.trace import Trace

SCENARIO = """title: A pendulum
components:
  hand:
    model: pendulum
stimuli:
  hand.torque:
    constant: 0.01
run: {stop: 5, step: 0.005}
cases:
  - {name: light, set: {hand.added_mass: 0}}
  - {name: heavy, set: {hand.added_mass: 0.2, hand.added_length: 0.1}}
"""
EXPECT = """expect:
  - {signal: hand.angle, below: 0.3}
  - {signal: hand.speed, near: 0, within: 1}
"""


def left(folder: Path, text: str, keeping: Keeping | None) -> tuple[ScenarioResult, dict[str, Trace]]:
    """The scenario's result, and the traces in the folder that it leaves."""
    path = folder / "scenario.yaml"
    path.write_text(text)
    aside = folder / "aside"
    aside.mkdir(exist_ok=True)
    result = run_scenario(path, keeping=keeping)
    write_run(result, {}, folder / "out")
    names = {
        case["name"]: case["trace"] for case in json.loads((folder / "out" / "manifest.json").read_text())["cases"]
    }
    assert not any(aside.iterdir())
    return result, {case: formats.read(folder / "out" / name).trace for case, name in names.items()}


def equal(one: Trace, other: Trace) -> bool:
    same_columns = all(np.array_equal(one[name], other[name]) for name in one.names)
    return (
        one.names == other.names and np.array_equal(one.time, other.time) and same_columns and one.units == other.units
    )


@pytest.mark.parametrize("text", [SCENARIO, SCENARIO + EXPECT])
def test_a_streamed_run_leaves_the_same_traces_and_verdicts(tmp_path: Path, text: str) -> None:
    plain, expected = left(tmp_path, text, None)
    streamed, found = left(tmp_path, text, Keeping(stream=tmp_path / "aside"))
    assert [case.checks for case in streamed.cases] == [case.checks for case in plain.cases]
    assert found.keys() == expected.keys() == {"light", "heavy"}
    assert all(equal(found[case], expected[case]) for case in found)
    assert len(found["light"]) == 1001


@pytest.mark.parametrize("stream", [False, True])
def test_a_stride_keeps_every_nth_row(tmp_path: Path, stream: bool) -> None:
    _, whole = left(tmp_path, SCENARIO, None)
    _, thinned = left(tmp_path, SCENARIO, Keeping(7, tmp_path / "aside" if stream else None))
    for case, trace in whole.items():
        assert thinned[case].time.tolist() == trace.time[::7].tolist()
        assert np.array_equal(thinned[case]["hand.angle"], trace["hand.angle"][::7])


def test_what_a_recorder_samples_is_not_thinned(tmp_path: Path) -> None:
    path = tmp_path / "scenario.yaml"
    path.write_text(SCENARIO + "recorder: {signals: {angle: hand.angle}, every: 0.02}\n")
    with pytest.raises(ScenarioError, match="has a recorder"):
        run_scenario(path, keeping=Keeping(2))


@pytest.mark.parametrize("pieces", [1, 3])
def test_pieces_appended_to_a_parquet_file_are_the_trace(tmp_path: Path, pieces: int) -> None:
    time = np.arange(200_000) / 1000
    trace = Trace(time, {"a.x": np.sin(time), "a.y": np.cos(time)}, {"a.x": "rad", "a.y": "1"}, "simulation")
    with parquet.appending(tmp_path / "trace.parquet") as append:
        for rows in np.array_split(np.arange(len(time)), pieces):
            append(Trace(time[rows], {name: trace[name][rows] for name in trace.names}, trace.units, "simulation"))
    assert equal(formats.read(tmp_path / "trace.parquet").trace, trace)
