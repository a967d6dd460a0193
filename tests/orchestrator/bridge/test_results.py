"""What a coupling leaves: its record, a manifest and a report, and how it is judged."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from orchestrator import formats
from orchestrator.bridge import results
from tests.support.can.coupled import (
    go,
    proportional,
)
from tests.support.can.coupling_samples import ScriptedBus

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def test_the_folder_has_record_manifest_and_report(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    (tmp_path / "aside").mkdir()
    expect = [{"signal": "hand.angle", "below": 0.6}, {"frames_lost": "none"}, {"late_steps": "none"}]
    coupled = go(folder, tmp_path / "aside", expect=expect)
    results.write(coupled, tmp_path / "out")
    manifest = json.loads((tmp_path / "out" / "manifest.json").read_text())
    assert manifest["passed"] and manifest["ended"] == "done"
    assert manifest["can"]["received"]["messages"] == {"Command": 199}
    assert manifest["can"]["sent"] == {
        "frames": 201,
        "acknowledged": False,
        "no_room": 0,
        "no_bus": 0,
        "skipped": 0,
        "bus_full": 0,
        "messages": {"State": 201},
    }
    assert manifest["can"]["deadlines"]["steps"] == 200
    assert len(formats.read(tmp_path / "out" / "run.parquet").trace) == 201
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Steps by their lateness." in page and "State" in page and "spare rests at the initial value" in page
    seconds = max(manifest["can"]["seconds"], 1e-9)  # steps that wait for nothing may be done before their time
    for way, count in (("received", 199), ("sent", 201)):
        assert f"<dt>frames {way}</dt><dd>{count}</dd><dd class='remark'>{count / seconds:.4g} a second</dd>" in page
    assert re.findall(r'<tr class="group"><th colspan="3">(.*?)</th></tr><tr><th>(.*?)</th>', page)[-2:] == [
        ("received", "Command"),
        ("sent", "State"),
    ]


def test_the_report_of_one_of_several_cases_shows_that_one_and_inputs_of_the_bus_as_such(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus(proportional).plug_in(monkeypatch)
    (tmp_path / "aside").mkdir()
    cases = [{"name": "at rest"}, {"name": "turned", "set": {"hand.angle_start": 0.3}}]
    coupled = go(folder, tmp_path / "aside", cases=cases)
    results.write(coupled, tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "at rest" in page and "turned" not in page
    assert "from the bus" in page and "every 0.001 s" in page
    assert '"label":"input"' not in page  # the safe value, which was not what the bus gave


def test_an_expectation_that_fails_or_looks_beyond_the_record_is_judged_so(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ScriptedBus().plug_in(monkeypatch)
    coupled = go(
        folder,
        tmp_path,
        expect=[{"signal": "hand.angle", "below": 0.1}, {"signal": "hand.angle", "below": 0.6, "after": 9}],
    )
    assert [check.held for check in coupled.result.cases[0].checks] == [False, False]
    assert coupled.result.cases[0].checks[1].found == "there is no sample from 9 to 0.2 s"
