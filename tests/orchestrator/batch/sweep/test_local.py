"""Whatever is killed, and whenever: a study that goes on is complete, with the bytes of one that nobody disturbed."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from orchestrator.batch.limits import CaseLimits
from orchestrator.batch.sweep.runs import queue
from orchestrator.batch.sweep.runs.local import Local
from orchestrator.batch.sweep.sweep import sweep
from orchestrator.fmi.isolation import Isolation
from orchestrator.processes.pool import Processes
from tests.support.fmus import brute
from tests.support.fmus.brute import Mood
from tests.support.sweeping import FALLING, Here, results, study

ROOT = Path(__file__).parents[4]
LONGER = FALLING | {"run": {"stop": 10, "step": 0.001}}
COMMAND = [sys.executable, "-c", "from identification.cli import main; main()", "sweep"]


def ran(out: Path) -> list[int]:
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    stretches = [one for line in lines for one in line.get("runs", [])]
    return [run for first, last in stretches for run in range(first, last + 1)]


def killed(file: Path, out: Path, after: float) -> int | None:
    """The exit code of the command, None where it and all its processes were killed after some seconds of runs."""
    started = subprocess.Popen(
        [*COMMAND, str(file), "-j", "2", "--out", str(out), "-q"], cwd=ROOT, start_new_session=True
    )
    end = time.monotonic() + 120
    before = len(ran(out)) if (out / "manifest.jsonl").exists() else 0
    while started.poll() is None and time.monotonic() < end:
        if (out / "manifest.jsonl").exists() and len(ran(out)) > before:
            time.sleep(after)
            break
        time.sleep(0.01)
    if started.poll() is None:
        os.killpg(started.pid, signal.SIGKILL)
        started.wait()
        return None
    return started.returncode


def test_the_manifest_tells_of_runs_that_a_command_kept_and_was_killed_before_it_said_so(tmp_path: Path) -> None:
    file, manifest = study(tmp_path, FALLING), tmp_path / "out" / "manifest.jsonl"
    sweep(file, tmp_path / "out", Here())
    done = ran(tmp_path / "out")
    lines = manifest.read_text().splitlines(keepends=True)
    manifest.write_text("".join(line for line in lines if "runs" not in json.loads(line)))
    sweep(file, tmp_path / "out", Here())
    assert done and ran(tmp_path / "out") == sorted(done)


@pytest.mark.slow
def test_a_command_that_is_killed_again_and_again_comes_to_the_same_bytes(tmp_path: Path) -> None:
    file = study(tmp_path, LONGER, design={"by": "sobol", "samples": 700, "seed": 3}, traces=None)
    sweep(file, tmp_path / "whole", Here())
    rng, ends = random.Random(1), list[int | None]()
    for _ in range(3):
        ends.append(killed(file, tmp_path / "out", rng.uniform(0, 0.7)))
    assert None in ends
    done = subprocess.run(
        [*COMMAND, str(file), "--out", str(tmp_path / "out")], cwd=ROOT, capture_output=True, check=False
    )
    assert done.returncode == 0, done.stderr
    assert results(tmp_path / "out") == results(tmp_path / "whole")
    twice = len(ran(tmp_path / "out")) - 700
    assert twice == 0 and list((tmp_path / "out" / "pending").iterdir()) == []


@pytest.mark.slow
def test_a_process_that_is_killed_costs_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pools: list[Processes[Any, Any]] = []

    enter = Processes.__enter__

    def entered(pool: Processes[Any, Any]) -> Processes[Any, Any]:
        pools.append(pool)
        return enter(pool)

    killed: list[int] = []

    def kill(fraction: float, doing: str) -> None:
        if len(killed) < 3 and fraction > 0.2 * (1 + len(killed)):
            killed.append(next(pid for pid in pools[0].pids if pid))
            os.kill(killed[-1], signal.SIGKILL)

    monkeypatch.setattr(Processes, "__enter__", entered)
    monkeypatch.setattr(queue, "LONG", 0.03)
    file = study(tmp_path, LONGER, design={"by": "sobol", "samples": 300, "seed": 3}, traces=None)
    sweep(file, tmp_path / "whole", Here())
    sweep(file, tmp_path / "out", Local(2), kill)
    assert len(killed) == 3
    assert results(tmp_path / "out") == results(tmp_path / "whole")
    assert sorted(ran(tmp_path / "out")) == list(range(300))


MOODS = [0, int(Mood.SEGMENTATION), 0, 0, int(Mood.HANG), 0, int(Mood.EXIT), 0]


def moods(folder: Path) -> Path:
    """A study whose FMU crashes in one run, hangs in another, and ends its process in a third."""
    brute.build(folder / "brute.fmu")
    scenario = {
        "title": "moods",
        "components": {"lag": {"fmu": "brute.fmu", "parameters": {"flow": 1}}},
        "run": {"stop": 1, "step": 0.1},
        "expect": [{"signal": "lag.level", "below": 1}],
    }
    return study(folder, scenario, vary={"lag.mood": MOODS}, design={"by": "grid"}, traces=None)


@pytest.mark.slow
def test_an_fmu_that_crashes_or_hangs_fails_its_runs_alone(tmp_path: Path) -> None:
    file = moods(tmp_path)
    rows = sweep(file, tmp_path / "out", Local(2, CaseLimits(2.0))).table().to_pylist()
    assert [row["state"] == "failed" for row in rows] == [mood != 0 for mood in MOODS]
    assert "crashed the process that ran it, which died (SIGSEGV)" in rows[1]["reason"]
    assert "was killed after 2 s" in rows[4]["reason"] and "exit code 7" in rows[6]["reason"]
    assert all(row["passed"] and row["e1"] == rows[0]["e1"] for row in rows if row["lag.mood"] == 0)


@pytest.mark.slow
def test_an_isolated_fmu_that_crashes_or_hangs_fails_its_runs_and_no_process_of_the_sweep_dies(tmp_path: Path) -> None:
    file = moods(tmp_path)
    rows = sweep(file, tmp_path / "out", Local(2), isolation=Isolation(2.0)).table().to_pylist()
    assert [row["state"] == "failed" for row in rows] == [mood != 0 for mood in MOODS]
    assert [row["reason"].partition(" in the step")[0] for row in rows if row["reason"]] == [
        "lag: its FMU crashed (signal SIGSEGV)",
        "lag: its FMU hangs, without an answer for 2 s,",
        "lag: its FMU ended the process it runs in (exit code 7)",
    ]
    assert all(row["passed"] and row["e1"] == rows[0]["e1"] for row in rows if row["lag.mood"] == 0)
