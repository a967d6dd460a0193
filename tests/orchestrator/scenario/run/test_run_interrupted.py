"""Ctrl-C in `servotwin run` ends it with a whole result of all up to there; `make bench` says how soon."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.packaging import targets
from orchestrator import formats
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace
from tests.support.fmus import slow

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(sys.platform == "win32", reason="needs POSIX signals"),
]
ROOT = Path(__file__).parents[4]
SAYING = """
import sys
from identification.cli import main
from orchestrator.engine import simulation
step = simulation._step
def announced(*arguments):
    print("stepping", file=sys.stderr, flush=True)
    step(*arguments)
simulation._step = announced
main()
"""
SCENARIO: dict[str, Any] = {
    "title": "A long swing",
    "run": {"stop": 5000, "step": 0.001},
    "record": ["hand.angle"],
    "cases": [{"name": "first"}, {"name": "second"}],
    "expect": [{"signal": "hand.angle", "below": 0.6}],
}


@dataclass(frozen=True)
class Ended:
    """How an interrupted command ended."""

    code: int
    stdout: str
    stderr: str


def interrupted(scenario: Path, *options: str, group: bool = False, after: float = 0.3) -> Ended:
    """`servotwin run` into the folder `out` beside the scenario, interrupted when it has stepped for a while [s].

    Nothing but the scenario and the result may be there when it has ended.
    """
    folder = scenario.parent
    (folder / "scratch").mkdir()
    command = [sys.executable, "-c", SAYING, "run", str(scenario), "--out", str(folder / "out"), *options]
    environment = os.environ | {"PYTHONPATH": str(ROOT), "TMPDIR": str(folder / "scratch")}
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, env=environment
    ) as running:
        assert running.stderr is not None and running.stderr.readline() == "stepping\n"
        time.sleep(after)
        (os.killpg if group else os.kill)(running.pid, signal.SIGINT)
        stdout, stderr = running.communicate(timeout=60)
    (folder / "scratch").rmdir()
    assert {path.name for path in folder.iterdir()} <= {scenario.name, "out", "slow.py", "slow.fmu"}
    return Ended(running.returncode, stdout, stderr)


@pytest.fixture(scope="module")
def swing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An FMU that is the same for all."""
    folder = tmp_path_factory.mktemp("fmu")
    return targets.build("pendulum", folder / "hand.fmu", parameters={"angle_start": 0.5})


def written(folder: Path, fmu: Path, **changes: Any) -> Path:
    path = folder / "swing.yaml"
    path.write_text(json.dumps(SCENARIO | {"components": {"hand": {"fmu": str(fmu)}}} | changes))
    return path


def left(folder: Path) -> tuple[dict[str, Any], Trace]:
    """The manifest, and the trace of its first case."""
    document = json.loads((folder / "out" / "manifest.json").read_text(), parse_constant=pytest.fail)
    return document, formats.read(folder / "out" / document["cases"][0]["trace"]).trace


@pytest.mark.parametrize(
    ("options", "group"),
    [([], False), (["--stream"], True), (["--stride", "100"], False)],
    ids=["in memory", "streamed, as a terminal interrupts", "thinned"],
)
def test_an_interrupted_run_keeps_all_up_to_there(tmp_path: Path, swing: Path, options: list[str], group: bool) -> None:
    ended = interrupted(written(tmp_path, swing), *options, group=group)
    document, trace = left(tmp_path)
    first, second = document["cases"]
    reached = first["stepping"]["reached"]
    assert (ended.code, ended.stdout) == (130, "")
    assert ended.stderr == (
        f"interrupted at t = {reached:g} s of case first; the result up to there is in {tmp_path / 'out'}\n"
    )
    assert document["interrupted"] and not document["passed"]
    assert (first["state"], first["passed"], first["checks"]) == ("interrupted", False, [])
    untouched = {"name": "second", "state": "not run", "passed": False, "error": None, "seconds": 0.0, "checks": []}
    assert second == untouched
    assert f"was interrupted at t = {reached:g} s of case first" in (tmp_path / "out" / "report.html").read_text()
    every = document["record"]["stride"]
    assert first["stepping"]["steps"] == round(1000 * reached) > 0
    assert len(trace) == -(-first["stepping"]["steps"] // every)
    whole = run_scenario(written(tmp_path, swing, run={"stop": reached, "step": 0.001}, cases=[{"name": "first"}]))
    made = whole.cases[0].result
    assert made is not None and np.array_equal(trace["hand.angle"], made.trace["hand.angle"][:-1:every])
    assert np.array_equal(trace.time, made.trace.time[:-1:every])


@pytest.mark.skipif(targets.preferred() != "native", reason="there is no C compiler for native FMUs")
@pytest.mark.parametrize("option", ["--stream", "--stride=100"])
def test_an_interrupted_run_prints_its_manifest_as_json_and_says_where_it_is_even_if_quiet(
    tmp_path: Path, swing: Path, option: str
) -> None:
    ended = interrupted(written(tmp_path, swing), option, "--json", "--quiet")
    assert ended.code == 130 and json.loads(ended.stdout) == left(tmp_path)[0]
    assert ended.stderr.startswith("interrupted at t = ")


def test_an_interrupt_in_a_step_that_takes_long_keeps_those_that_are_done(tmp_path: Path) -> None:
    """An FMU in Python that does not come back is broken off; its failure is explained by the interrupt."""
    slow.write(tmp_path, 0.3)
    targets.build(tmp_path / "slow.py", tmp_path / "slow.fmu", target="python")
    scenario = written(tmp_path, tmp_path / "slow.fmu", run={"stop": 10, "step": 0.1}, record=["hand.y"], expect=[])
    ended = interrupted(scenario, after=3.0)
    document, trace = left(tmp_path)
    assert ended.code == 130 and re.search(r"interrupted at t = 0\.[1-9] s", ended.stderr)
    steps = document["cases"][0]["stepping"]["steps"]
    assert steps == len(trace) and trace["hand.y"] == pytest.approx(np.arange(steps) / 10)
