"""`servotwin test` runs what failed last time, or what a change touches, and says so."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from orchestrator.batch.discovery import SuiteFile
from orchestrator.batch.history import failed
from orchestrator.batch.verdict import Verdict
from tests.support.commands import servotwin

SCENARIO = """
title: A source
components:
  source: {{model: excitation, parameters: {{amplitude: 1.0}}}}
run: {{stop: 1, step: 0.1}}
expect:
  - {{signal: source.signal, below: {limit}}}
"""


@pytest.fixture
def suite(tmp_path: Path) -> Path:
    folder = tmp_path / "suite"
    folder.mkdir()
    for name, limit in (("good", 2), ("bad", -2), ("worse", -3)):
        (folder / f"{name}.yaml").write_text(SCENARIO.format(limit=limit))
    return folder


def verdicts(suite: Path, *options: str, code: int = 0) -> dict[str, Any]:
    arguments = ["test", str(suite), "--out", str(suite.parent / "out"), "--json", *options]
    answer = servotwin(*arguments)
    assert answer.exit_code == code, answer.output
    document: dict[str, Any] = json.loads(answer.stdout) if code < 2 else {"said": answer.stderr}
    return document | {"names": [Path(one["file"]).stem for one in document.get("scenarios", [])]}


@pytest.mark.slow
def test_what_failed_last_time_is_run_until_it_passes(suite: Path) -> None:
    assert "run without --failed first" in verdicts(suite, "--failed", code=2)["said"]
    assert verdicts(suite, code=1)["names"] == ["bad", "good", "worse"]
    (suite / "bad.yaml").write_text(SCENARIO.format(limit=3))
    assert verdicts(suite, "--failed", code=1)["names"] == ["bad", "worse"]
    assert verdicts(suite, "--failed", code=1)["names"] == ["worse"]
    (suite / "worse.yaml").write_text(SCENARIO.format(limit=3))
    assert verdicts(suite, "--failed")["names"] == ["worse"]
    before = (suite.parent / "out" / "index.html").read_text()
    nothing = verdicts(suite, "--failed")
    assert nothing["names"] == [] and nothing["passed"]
    assert (suite.parent / "out" / "index.html").read_text() == before
    said = servotwin("test", str(suite), "--out", str(suite.parent / "out"), "--failed").output
    assert said == "nothing to run: none failed the last time\n"


@pytest.mark.slow
def test_changed_parameters_are_tried_in_what_is_chosen_and_nothing_is_left_out_silently(suite: Path) -> None:
    (suite / "bad.yaml").unlink()
    verdicts(suite, code=1)
    (suite / "worse.yaml").write_text(SCENARIO.format(limit=1.001))
    found = verdicts(suite, "--mutate", "--failed")
    assert {Path(one["file"]).stem for one in found["parameters"]} == {"worse"}
    refused = verdicts(suite, "--mutate", "--junit", "junit.xml", code=2)["said"]
    assert "--junit: has verdicts of scenarios, which --mutate does not give" in refused


def test_what_an_interrupted_suite_has_found_is_known_the_next_time(
    suite: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(
        tasks: Sequence[SuiteFile], out: Path, jobs: int, done: Callable[[Verdict], None], limits: object
    ) -> list[Verdict]:
        done(Verdict(tasks[0].file, 0.1, None, "failed"))
        raise KeyboardInterrupt

    monkeypatch.setattr("orchestrator.batch.suite.run_suite", interrupted)
    verdicts(suite, code=130)
    files = [suite / f"{name}.yaml" for name in ("bad", "good", "worse")]
    assert failed(files, suite.parent / "out") == files[:1]


@pytest.mark.slow
def test_what_a_change_touches_is_run(suite: Path) -> None:
    for arguments in (["init", "-q"], ["add", "."], ["commit", "-q", "-m", "begin"]):
        identity = ["-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false"]
        subprocess.run(["git", "-C", str(suite), *identity, *arguments], check=True, capture_output=True)
    assert verdicts(suite, "--changed", "HEAD")["names"] == []
    (suite / "good.yaml").write_text(SCENARIO.format(limit=3))
    assert verdicts(suite, "--changed", "HEAD")["names"] == ["good"]
    assert "git says" in verdicts(suite, "--changed", "nowhere", code=2)["said"]
