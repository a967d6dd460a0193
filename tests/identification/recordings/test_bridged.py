"""The record of a coupling as a recording: when its inputs had safe values is left out."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from identification.recordings.bridged import safe_stretches
from identification.recordings.campaign import TraceSource, load_campaign
from orchestrator import formats
from orchestrator.bridge.safety.watchdog import PeerPresence, WatchdogEvent, WatchdogReport
from orchestrator.trace import Trace


def written(folder: Path, *events: tuple[float, str, str], first: float | None = 0.02, more: int = 0) -> Path:
    """The record of a coupling of 10 s with these events."""
    time = 0.01 * np.arange(1001)
    formats.write(Trace(time, {"rig.speed": np.sin(time)}), folder / "run.parquet")
    peer = PeerPresence(900, first, 0.1, 1, 0.5, {"rig.speed": 0.0})
    watchdog = WatchdogReport({"Sensors": peer}, len(events) + more, [WatchdogEvent(*event) for event in events])
    document = {"cases": [{"name": "run", "trace": "run.parquet"}], "can": {"watchdog": asdict(watchdog)}}
    (folder / "manifest.json").write_text(json.dumps(document))
    return folder / "run.parquet"


def test_stretches_in_which_inputs_had_safe_values_are_marks_of_the_record(tmp_path: Path) -> None:
    written(tmp_path, (0.02, "Sensors", "first"), (5.0, "Sensors", "silent"), (6.5, "Sensors", "back"))
    (recorded,) = load_campaign(TraceSource(tmp_path, files="*.parquet"))
    assert [str(mark) for mark in recorded.marks] == ["safe values from 0 to 0.02 s", "safe values from 4.9 to 6.5 s"]
    assert "1.62 of 10 s are left out" in recorded.remarks[-1]


@pytest.mark.parametrize(
    ("events", "first", "more", "expected"),
    [
        ([], None, 0, [(0, 10)]),
        ([(3.0, "Sensors", "silent")], 0.0, 0, [(2.9, 10)]),
        ([(3.0, "rig.torque", "rests"), (3.4, "rig.torque", "runs")], 0.0, 0, [(3, 3.4)]),
        ([(3.0, "Sensors", "silent"), (3.4, "Sensors", "back")], 0.0, 7, [(2.9, 3.4), (3.4, 10)]),
    ],
)
def test_what_is_not_told_to_have_ended_lasts(
    events: list[tuple[float, str, str]],
    first: float | None,
    more: int,
    expected: list[tuple[float, float]],
    tmp_path: Path,
) -> None:
    found = safe_stretches(written(tmp_path, *events, first=first, more=more), 10.0)
    assert [(mark.start, mark.stop) for mark in found] == [pytest.approx(stretch) for stretch in expected]


@pytest.mark.parametrize("text", ["", "{}", "[]", '{"cases": [], "can": 3}', "[" * 100_000])
def test_a_manifest_that_is_none_of_a_coupling_tells_nothing(text: str, tmp_path: Path) -> None:
    file = written(tmp_path)
    (tmp_path / "manifest.json").write_text(text)
    assert safe_stretches(file, 10.0) == []
