"""A case that crashes, hangs or takes too much fails alone: the scenario's other cases and the suite go on."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest

from fmus.errors import InputError
from orchestrator import formats
from orchestrator.batch.discovery import SuiteFile, find_scenarios
from orchestrator.batch.limits import CaseLimits
from orchestrator.batch.suite import run_suite
from orchestrator.processes.last_words import LastWords
from orchestrator.results import FileDocument
from tests.support.fmus import brute
from tests.support.fmus.brute import Mood

CALM = 0


def hoarding(file: Path, out: Path) -> FileDocument:
    """Takes 400 MB and waits, as a judge of a file."""
    taken = b"x" * (400 << 20)
    time.sleep(60)
    return {"title": str(len(taken)), "passed": True, "out": str(out), "cases": []}


def scenario(path: Path, **moods: int) -> Path:
    """A scenario of the FMU beside it with a case for each mood."""
    document = {
        "title": "moods",
        "components": {"lag": {"fmu": "brute.fmu", "parameters": {"flow": 1}}},
        "run": {"stop": 1, "step": 0.1},
        "expect": [{"signal": "lag.level", "above": -1}],
        "cases": [{"name": name, "set": {"lag.mood": int(mood)}} for name, mood in moods.items()],
    }
    path.write_text(json.dumps(document))
    return path


@pytest.mark.slow
def test_a_case_that_crashes_or_hangs_is_one_failed_case(tmp_path: Path) -> None:
    brute.build(tmp_path / "brute.fmu")
    moods = {"first": CALM, "crash": Mood.SEGMENTATION, "second": CALM, "hang": Mood.HANG, "third": CALM}
    scenario(tmp_path / "moods.yaml", **moods)
    scenario(tmp_path / "calm.yaml", only=CALM)
    calm, verdict = run_suite(find_scenarios([tmp_path], {}), tmp_path / "out", 2, limits=CaseLimits(seconds=5))
    assert calm.passed and not verdict.passed and verdict.document is not None
    assert {case["name"]: case["passed"] for case in verdict.cases} == {name: moods[name] == CALM for name in moods}
    crash, hang = (case for case in verdict.cases if not case["passed"])
    assert "crashed the process that ran it, which died (SIGSEGV); give --isolate" in str(crash["error"])
    assert "case hang: was killed after 5 s, the limit of a case" in str(hang["error"])
    assert hang["seconds"] >= 5
    for name in ("first", "second", "third"):
        written = Path(verdict.document["out"]) / f"{name}.parquet"
        assert formats.read(written).trace.time[-1] == 1


@pytest.mark.slow
def test_what_takes_more_memory_than_it_may_is_killed(tmp_path: Path) -> None:
    tasks = [SuiteFile(tmp_path / "study.yaml", hoarding, Path("a", "study"))]
    (verdict,) = run_suite(tasks, tmp_path / "out", 1, limits=CaseLimits(megabytes=300))
    assert "MB of memory, over the 300 MB of a case" in verdict.error and verdict.seconds < 60


@pytest.mark.parametrize("limits", [{"seconds": 0}, {"megabytes": -1}, {"seconds": float("nan")}])
def test_a_limit_that_nothing_keeps_is_refused(limits: dict[str, float]) -> None:
    with pytest.raises(InputError, match="give more than 0"):
        CaseLimits(**limits)


def test_time_counts_from_when_a_process_has_come_to_its_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    said = LastWords(tmp_path / "words")
    limits, heard = CaseLimits(seconds=100.0), LastWords(tmp_path / "words")

    def exceeded(now: float, begun: float) -> bool:
        monkeypatch.setattr("orchestrator.batch.limits.monotonic", lambda: now)
        return bool(limits.exceeded(0, heard, begun))

    given = time.monotonic()
    assert exceeded(given + 101, given) and not exceeded(given + 99, given)
    with said.working_on(3):
        come = heard.part_since
        assert heard.part == 3 and come is not None
        assert exceeded(come + 101, come - 50) and not exceeded(come + 99, come - 50)
    left = heard.part_since
    assert heard.part is None and left is not None
    assert exceeded(left + 101, left - 50) and not exceeded(left + 99, left - 50)
