"""Runs and suites with isolated FMUs: what one does costs its scenario alone, and nothing outlives the command."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import pytest
from typer.testing import CliRunner

from identification.cli import app
from orchestrator import formats
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.batch.scenario_judge import ScenarioJudge
from orchestrator.batch.suite import judged
from orchestrator.engine import Timing
from orchestrator.fmi.isolation import IsolatedSlave, Isolation
from orchestrator.fmi.slave import Slave
from orchestrator.results import permission
from tests.support.commands import process
from tests.support.fmus import brute
from tests.support.fmus.brute import Mood
from tests.support.tools.own_processes import started, waited_for, workers

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc"),
]

ROOT = Path(__file__).parents[4]


def write_scenario(folder: Path, fmu: Path, name: str = "lag", stop: float = 1, **parameters: float) -> Path:
    """A scenario of the brutal FMU."""
    path = folder / f"{name}.yaml"
    document = {
        "title": "A lag",
        "components": {"wheel": {"fmu": os.path.relpath(fmu, folder), "parameters": parameters}},
        "stimuli": {"wheel.flow": {"constant": 1}},
        "run": {"stop": stop, "step": 0.01},
        "expect": [{"signal": "wheel.level", "below": 1}],
    }
    path.write_text(json.dumps(document))
    return path


def test_only_fmus_given_as_files_are_isolated(fmus: dict[int, Path], tmp_path: Path) -> None:
    system = SystemSpec({"wheel": ComponentSpec(fmus[2]), "hand": ComponentSpec("pendulum")})
    assembled = assemble(system, tmp_path)
    with OpenSystem(assembled) as opened:
        timing = Timing(Fraction(1), Fraction(1, 100))
        plain = opened.simulation(timing).components
        kinds = {name: type(each) for name, each in opened.simulation(timing, Isolation()).components.items()}
    assert set(map(type, plain.values())) == {Slave}
    assert kinds == {"wheel": IsolatedSlave, "hand": Slave}


def servotwin(*arguments: object, code: int = 0) -> Any:
    """The command in this process: its document, or the line on standard error where it fails."""
    answer = CliRunner().invoke(app, [str(argument) for argument in arguments])
    assert answer.exit_code == code, (answer.stdout, answer.stderr)
    if code > 1:
        (line,) = answer.stderr.splitlines()
        return line
    return json.loads(answer.stdout)


def test_a_run_with_a_crash_has_exit_code_3_and_leaves_what_was_recorded(fmus: dict[int, Path], tmp_path: Path) -> None:
    path = write_scenario(tmp_path, fmus[2], mood=Mood.SEGMENTATION, at=0.25)
    line = servotwin("run", path, "--out", tmp_path / "out", "--isolate", "--stream", "--json", code=3)
    assert (
        line.startswith("servotwin: ") and "wheel: its FMU crashed (signal SIGSEGV) in the step from t = 0.25 s" in line
    )
    assert formats.read(tmp_path / "out" / "run.parquet").trace.time[-1] == 0.25
    assert sorted(each.name for each in tmp_path.iterdir()) == ["lag.yaml", "out", "scratch"]


def test_an_isolated_run_leaves_the_same_trace(fmus: dict[int, Path], tmp_path: Path) -> None:
    path = write_scenario(tmp_path, fmus[3])
    servotwin("run", path, "--out", "here", "--json")
    servotwin("run", path, "--out", "there", "--isolate", "--patience", 20, "--json")
    assert Path("here/run.parquet").read_bytes() == Path("there/run.parquet").read_bytes()


@pytest.mark.parametrize("command", ["run", "test"])
@pytest.mark.parametrize(
    ("options", "problem"),
    [
        (["--patience", "5"], "--patience: is for isolated FMUs; give --isolate, too"),
        (["--isolate", "--patience", "0"], "--patience: is 0 s; give more than 0 and at most 1e+06 s"),
    ],
)
def test_a_patience_out_of_place_is_refused(
    fmus: dict[int, Path], tmp_path: Path, command: str, options: list[str], problem: str
) -> None:
    path = write_scenario(tmp_path, fmus[2])
    assert servotwin(command, path, *options, code=2) == f"servotwin: {problem}"
    assert not Path("out").exists()


@pytest.mark.slow
def test_the_other_scenarios_of_a_suite_go_on(fmus: dict[int, Path], tmp_path: Path) -> None:
    moods = {"a": 0, "b": Mood.SEGMENTATION, "c": Mood.HANG, "d": 0}
    files = [write_scenario(tmp_path, fmus[2], name, mood=mood) for name, mood in moods.items()]
    isolation = ("--isolate", "--patience", 5)
    running = process("test", *files, "--out", "out", "-j", 2, *isolation, "--junit", "j.xml", "--json")
    stdout, _ = running.communicate(timeout=300)
    assert running.returncode == 1
    verdicts = {Path(each["file"]).stem: each for each in json.loads(stdout)["scenarios"]}
    assert {name: each["passed"] for name, each in verdicts.items()} == {"a": True, "b": False, "c": False, "d": True}
    assert "wheel: its FMU crashed (signal SIGSEGV) in the step from t = 0.5 s" in verdicts["b"]["error"]
    assert "wheel: its FMU hangs, without an answer for 5 s, in the step" in verdicts["c"]["error"]
    errors = [each.get("message") for each in ET.parse("j.xml").getroot().iter("error")]
    assert errors == [verdicts["b"]["error"], verdicts["c"]["error"]]
    assert [path.parent.name for path in sorted(Path("out").rglob("*.parquet"))] == ["a", "b", "c", "d"]


def test_a_scenario_with_a_crash_fails_and_leaves_what_was_recorded(fmus: dict[int, Path], tmp_path: Path) -> None:
    path = write_scenario(tmp_path, fmus[2], mood=Mood.ABORT)
    verdict = judged(ScenarioJudge(Isolation()), path, tmp_path / "out", permission())
    assert not verdict.passed
    assert "wheel: its FMU crashed (signal SIGABRT) in the step from t = 0.5 s by 0.01 s" in verdict.first_error
    assert formats.read(tmp_path / "out" / "run.parquet").trace.time[-1] == 0.5


@pytest.mark.slow
def test_without_isolation_a_crash_fails_its_scenario_alone_and_points_to_isolation(
    fmus: dict[int, Path], tmp_path: Path
) -> None:
    files = [write_scenario(tmp_path, fmus[2], name, mood=mood) for name, mood in {"a": Mood.ABORT, "b": 0}.items()]
    running = process("test", *files, "--out", "out", "--json")
    crashed, well = json.loads(running.communicate(timeout=300)[0])["scenarios"]
    assert well["passed"]
    assert re.fullmatch(
        r".*a.yaml: \S+ \(.*brute2.*\) crashed the process that ran it, which died \(SIGABRT\); give --isolate.*",
        crashed["error"],
    )


def test_what_isolated_fmus_print_does_not_mix_with_the_document(
    fmus: dict[int, Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = write_scenario(tmp_path, fmus[2], mood=Mood.PRINT)
    assert servotwin("run", path, "--out", "out", "--isolate", "--json")["passed"] is True
    stdout, stderr = capfd.readouterr()
    assert (stdout, stderr.count("here I am")) == ("", 100)


def busy(command: str, path: Path) -> subprocess.Popen[str]:
    """A command that has an isolated FMU hanging in a step."""
    running = process(command, path, "--out", "out", "--isolate", "--json")
    waited_for(lambda: any(asleep(number) for number in workers()) or running.poll() is not None)
    assert running.poll() is None, running.communicate()
    return running


def asleep(number: int) -> bool:
    """Whether a process waits for a signal."""
    try:
        return "pause" in Path(f"/proc/{number}/wchan").read_text()
    except OSError:
        return False


@pytest.mark.parametrize("command", ["run", pytest.param("test", marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "group", [pytest.param(False, id="alone", marks=pytest.mark.slow), pytest.param(True, id="as a terminal does")]
)
def test_an_interrupt_does_not_wait_for_a_hanging_fmu(
    fmus: dict[int, Path], tmp_path: Path, command: str, group: bool
) -> None:
    running = busy(command, write_scenario(tmp_path, fmus[2], mood=Mood.HANG))
    (os.killpg if group else os.kill)(running.pid, signal.SIGINT)
    _, stderr = running.communicate(timeout=30)
    assert running.returncode == 130
    assert stderr.startswith("interrupted") and len(stderr.splitlines()) == 1
    assert started() == []


@pytest.mark.slow
def test_whichever_signal_ends_a_run_whose_fmu_hangs_it_was_interrupted(fmus: dict[int, Path], tmp_path: Path) -> None:
    numbers = [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT]
    scenario = write_scenario(tmp_path, fmus[2], mood=Mood.HANG)
    running = [process("run", scenario, "--out", f"out{number}") for number in numbers]
    waited_for(lambda: sum(asleep(child) for child, _ in started()) == len(numbers))
    for each, number in zip(running, numbers, strict=True):
        each.send_signal(number)
    ends = [(each.communicate(timeout=300)[1], each.returncode) for each in running]
    assert {code for _, code in ends} == {130}
    assert all(re.search(r"interrupted; wheel \(.*brute2.fmu\) did not let go\n$", said) for said, _ in ends)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["run", "test"])
def test_nothing_outlives_a_main_process_that_is_killed(fmus: dict[int, Path], tmp_path: Path, command: str) -> None:
    running = busy(command, write_scenario(tmp_path, fmus[2], mood=Mood.HANG))
    running.kill()
    running.communicate(timeout=30)
    waited_for(lambda: started() == [])


def test_not_even_an_fmu_that_hangs_while_it_is_loaded_outlives_the_main_process(tmp_path: Path) -> None:
    path = brute.build(tmp_path / "never.fmu", flags=("-DNEVER_LOADED",))
    running = busy("run", write_scenario(tmp_path, path))
    running.kill()
    running.communicate(timeout=30)
    waited_for(lambda: started() == [])
