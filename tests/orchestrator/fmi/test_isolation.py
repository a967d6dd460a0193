"""Isolated FMUs compute the same bits; what they do to their process costs that component alone and leaves nothing."""

from __future__ import annotations

import json
import logging
import os
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from typer.testing import CliRunner

from fmus.errors import FmuError, FmuFileError, InputError, ServotwinError
from fmus.packaging import targets
from identification.cli import app
from orchestrator import formats
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.batch.scenario_judge import ScenarioJudge
from orchestrator.batch.suite import judged
from orchestrator.engine import CycleSettings, Simulation, Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.isolation import IsolatedSlave, Isolation
from orchestrator.fmi.slave import Slave
from orchestrator.results import permission
from orchestrator.solvers.base import SolverSettings
from orchestrator.system import Part, wire
from orchestrator.trace import Trace
from tests.support import brute, moody, third_party
from tests.support.brute import Mood

ROOT = Path(__file__).parents[3]
MARK = "SERVOTWIN_TEST_MARK"
COMMAND = [sys.executable, "-c", "from identification.cli import main; main()"]
Make = Callable[[FmuFile, str], Component]

pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc"),
]


def isolated(fmu: FmuFile, name: str, patience: float = 20.0, make: Make = Slave) -> IsolatedSlave:
    return IsolatedSlave(make, fmu, name, Isolation(patience))


MAKERS: dict[str, Make] = {"here": Slave, "isolated": isolated}


@pytest.fixture(scope="module")
def fmus(tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The brutal FMU by version of FMI."""
    folder = tmp_path_factory.mktemp("brute")
    return {version: brute.build(folder / f"brute{version}.fmu", version) for version in (2, 3)}


@pytest.fixture(scope="module")
def moody_fmu(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return moody.build(tmp_path_factory.mktemp("moody"))


@pytest.fixture(autouse=True)
def nothing_left(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """After each test none of the processes is there that it has started, directly or not, and no temporary folder."""
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setenv(MARK, secrets.token_hex(8))
    monkeypatch.setenv("TMPDIR", str(scratch))
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    monkeypatch.chdir(tmp_path)
    yield
    deadline = time.monotonic() + 10
    while (there := [*started(), *scratch.iterdir()]) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert there == []


def started() -> list[tuple[int, str]]:
    """Processes with this test's mark but this one: id and command line."""
    mark, found = f"{MARK}={os.environ[MARK]}".encode(), []
    for entry in Path("/proc").iterdir():
        try:
            if entry.name.isdigit() and mark in (entry / "environ").read_bytes():
                found.append((int(entry.name), (entry / "cmdline").read_bytes().decode(errors="replace")))
        except OSError:  # gone, a zombie, or somebody else's
            continue
    return [each for each in found if each[0] != os.getpid()]


def workers() -> list[int]:
    return [number for number, command in started() if "isolation_worker" in command]


def waited_for(condition: Callable[[], object]) -> None:
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def lag(component: Component, mood: int = 0, at: float = 0.2) -> list[float]:
    """The level of the brutal FMU after each of five steps of 0.1 s."""
    component.set({"mood": int(mood), "at": at})
    component.bind(["flow"], ["level"])
    component.begin(0.0, None)
    component.write([1.0])
    component.read()
    component.run()
    levels = []
    for k in range(5):
        component.write([1.0])
        component.step(k / 10, 0.1)
        levels += component.read()
    return levels


def broken(path: Path, mood: Mood, patience: float = 20.0) -> FmuError:
    """The error of a run of the isolated FMU."""
    with FmuFile(path) as fmu:
        component = isolated(fmu, "wheel", patience)
        with pytest.raises(FmuError) as failed:
            lag(component, mood)
        component.reset()  # makes a new process
        lag(component)
        component.close()
    return failed.value


def run(sources: dict[str, tuple[Path, Make]], links: list[tuple[str, str]], timing: Timing, **values: Any) -> Trace:
    """The second of two runs of these FMUs, the first with other values: it takes a reset."""
    with ExitStack() as stack:
        files = {name: stack.enter_context(FmuFile(path)) for name, (path, _) in sources.items()}
        system = wire({name: Part(file.interface) for name, file in files.items()}, links)
        made = {name: make(files[name], name) for name, (_, make) in sources.items()}
        simulation = stack.enter_context(Simulation(system, made, timing))
        simulation.run()
        return simulation.run({name.replace("__", "."): value for name, value in values.items()}).trace


def same(one: Trace, other: Trace) -> bool:
    return one.names == other.names and all(np.array_equal(one[name], other[name]) for name in one.names)


@pytest.mark.parametrize("version", [2, 3])
def test_isolated_fmus_give_the_same_bits(version: int) -> None:
    path, timing = third_party.reference(version, "VanDerPol"), Timing(Fraction(5), Fraction(1, 100))
    one, other = (run({"fmu": (path, make)}, [], timing, fmu__mu=2.0) for make in MAKERS.values())
    assert same(one, other)
    assert np.ptp(one["fmu.x0"]) > 1


def test_model_exchange_is_isolated_alike() -> None:
    file = third_party.reference(3, "VanDerPol")
    spec = ComponentSpec(file, solver=SolverSettings(relative_tolerance=1e-4))
    with spec.open(file) as fmu:
        ways = []
        for make in (spec.maker(fmu), partial(isolated, make=spec.maker(fmu))):
            component = make(fmu, "fmu")
            component.bind([], ["x0", "x1"])
            component.begin(0.0, None)
            component.run()
            ways.append([])
            for k in range(10):
                component.step(k / 10, 0.1)
                ways[-1] += component.read()
            component.close()
    assert ways[0] == ways[1] and np.ptp(ways[0]) > 0.1


def test_isolated_and_other_fmus_are_wired_together_as_ever(tmp_path: Path) -> None:
    """A motor here, its pendulum elsewhere, both in Python."""
    motor = targets.build("dc_motor", tmp_path / "motor.fmu", target="python")
    hand = targets.build("pendulum", tmp_path / "hand.fmu", target="python")
    links = [("motor.torque", "hand.torque"), ("hand.speed", "motor.speed")]
    timing = Timing(Fraction(1, 2), Fraction(1, 200))
    values = {"motor__voltage": 3.0, "motor__torque_gain": 0.05, "motor__back_emf": 0.05, "hand__angle_start": 0.5}
    one, other = (
        run({"motor": (motor, Slave), "hand": (hand, make)}, links, timing, **values) for make in MAKERS.values()
    )
    assert same(one, other)
    assert np.ptp(one["hand.angle"]) > 0.1 and np.ptp(one["motor.torque"]) > 0


def test_cycles_are_iterated_over_snapshots_as_ever(moody_fmu: Path) -> None:
    timing = Timing(Fraction(1), Fraction(1, 10), cycles=CycleSettings(iterate=True))
    one, other = (run({"a": (moody_fmu, make)}, [("a.output", "a.input")], timing) for make in MAKERS.values())
    assert same(one, other)


@pytest.mark.parametrize("version", [2, 3])
def test_a_saved_state_is_gone_back_to_exactly(version: int) -> None:
    with FmuFile(third_party.reference(version, "VanDerPol")) as fmu:
        component = isolated(fmu, "fmu")
        component.bind([], ["x0", "x1"])
        component.begin(0.0, None)
        component.run()
        states, ways = [component.save(), component.save()], []
        for state in states:
            component.restore(state)
            for k in range(10):
                component.step(k / 10, 0.1)
            ways.append(list(component.read()))
            component.drop(state)
        component.close()
    assert ways[0] == ways[1] != [2.0, 0.0]


def told(make: Make, path: Path, values: dict[str, Any]) -> tuple[type, str]:
    """Class and text of the error of a moody life."""
    with FmuFile(path) as fmu, ExitStack() as stack:
        try:
            component = make(fmu, "fmu")
            stack.callback(component.close)
            component.bind(["input"], ["output"])
            for name, value in values.items():
                component.set({name: value})
            component.begin(0.0, None)
            component.run()
            component.write([2.0])
            component.step(0.0, 0.1)
            component.read()
            component.save()
        except ServotwinError as error:
            return type(error), str(error)
    raise AssertionError("no error")


TROUBLES: list[tuple[dict[str, Any], type, str]] = [
    ({"step": 3}, FmuError, "fmu: step from t = 0 s by 0.1 s: returned error (step said 3, 2.500 times no)"),
    ({"exit": 4}, FmuError, "fmu: initialise: returned fatal error (exit said 4, 2.500 times no)"),
    ({"stubborn": 2.0}, FmuError, "fmu.stubborn: was set to 2.0 but is 1.0; the FMU does not take it; remove it or"),
    ({"stubborn": "much"}, FmuFileError, "fmu.stubborn: cannot be 'much'; give a Real"),
]


@pytest.mark.parametrize(("values", "kind", "text"), TROUBLES)
def test_errors_of_the_fmu_keep_their_class_and_text(
    moody_fmu: Path, values: dict[str, Any], kind: type, text: str
) -> None:
    assert told(isolated, moody_fmu, values) == (expected := told(Slave, moody_fmu, values))
    assert expected[0] is kind and expected[1].startswith(text)


def test_a_failure_to_instantiate_is_the_fmus_own_and_leaves_no_process(moody_fmu: Path) -> None:
    with FmuFile(moody_fmu) as fmu, pytest.raises(FmuError) as failed:
        isolated(fmu, "_nobody")
    assert str(failed.value) == "_nobody: instantiate: Failed to instantiate model (no licence for '_nobody')"


def test_log_messages_and_warnings_come_through(moody_fmu: Path, caplog: pytest.LogCaptureFixture) -> None:
    with FmuFile(moody_fmu) as fmu:
        component = isolated(fmu, "fmu")
        component.set({"step": 1})
        component.begin(0.0, None)
        component.run()
        component.step(0.0, 0.1)
        assert component.warnings == 1
        assert ("servotwin.fmu", logging.WARNING, "fmu: step said 1, 2.500 times no") in caplog.record_tuples
        component.reset()
        assert component.warnings == 0
        component.close()


LAST = "in the step from t = 0.2 s by 0.1 s{}; the last step it finished ended at t = 0.2 s; {}ask its supplier for a"
ENDINGS = [
    (2, Mood.SEGMENTATION, "its FMU crashed (signal SIGSEGV) ", ""),
    (3, Mood.SEGMENTATION, "its FMU crashed (signal SIGSEGV) ", ""),
    (2, Mood.ABORT, "its FMU crashed (signal SIGABRT) ", ""),
    (3, Mood.EXIT, "its FMU ended the process it runs in (exit code 7) ", ""),
    (2, Mood.ORPHAN, "its FMU crashed (signal SIGSEGV) ", ""),
    (2, Mood.LAST_WORDS, "its FMU crashed (signal SIGSEGV) ", " (brute: out of luck)"),
    (2, Mood.DEAF, "its FMU ended the process it runs in (exit code 0) ", ""),
    (2, Mood.GARBAGE, "what came from its process cannot be read ", ""),
]


@pytest.mark.parametrize(("version", "mood", "problem", "said"), ENDINGS)
def test_the_end_of_its_process_is_the_components_failure_with_the_last_step_it_finished(
    fmus: dict[int, Path], version: int, mood: Mood, problem: str, said: str
) -> None:
    error = broken(fmus[version], mood)
    assert str(error).startswith(f"wheel: {problem}{LAST.format(said, '')}")
    assert error.exit_code == 3


def test_a_hang_is_found_when_the_patience_is_over(fmus: dict[int, Path]) -> None:
    begun = time.monotonic()
    error = broken(fmus[3], Mood.HANG, patience=1.5)
    expected = f"its FMU hangs, without an answer for 1.5 s, {LAST.format('', 'give it more --patience, or ')}"
    assert str(error).startswith(f"wheel: {expected}")
    assert time.monotonic() - begun > 1.5


def test_a_hang_before_there_is_an_instance_is_found_too(tmp_path: Path) -> None:
    path = brute.build(tmp_path / "never.fmu", flags=("-DNEVER_LOADED",))
    with FmuFile(path) as fmu, pytest.raises(FmuError) as failed:
        isolated(fmu, "wheel", patience=0.5)
    assert str(failed.value).startswith(
        "wheel: its FMU hangs, without an answer for 0.5 s, when it was to instantiate; it had not finished a step; "
    )


def test_a_crash_on_leaving_is_logged_and_costs_nothing(
    fmus: dict[int, Path], caplog: pytest.LogCaptureFixture
) -> None:
    with FmuFile(fmus[2]) as fmu:
        calm, component = Slave(fmu, "calm"), isolated(fmu, "wheel")
        assert lag(component, Mood.BAD_END) == lag(calm)
        component.close()
        component.close()
        calm.close()
    assert re.match(r"wheel: its FMU crashed \(signal SIGSEGV\) when it was to free its instance;", caplog.messages[0])
    assert len(caplog.messages) == 1


@pytest.mark.parametrize("debug", [False, True])
def test_any_picklable_maker_of_components_will_do(
    fmus: dict[int, Path], caplog: pytest.LogCaptureFixture, debug: bool
) -> None:
    with FmuFile(fmus[2]) as fmu, caplog.at_level(logging.DEBUG, "servotwin.fmu"):
        component = isolated(fmu, "wheel", make=partial(Slave, debug_log=debug))
        lag(component)
        component.close()
    assert bool(caplog.messages) is debug


@pytest.mark.parametrize("patience", [0.0, -1.0, float("nan"), float("inf")])
def test_a_patience_that_is_none_is_refused(patience: float) -> None:
    with pytest.raises(InputError, match=r"--patience: is .* s; give more than 0 and at most 1e"):
        Isolation(patience)


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


def process(*arguments: object) -> subprocess.Popen[str]:
    """The command as a process of its own, in a session of its own."""
    return subprocess.Popen(
        COMMAND + [str(argument) for argument in arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
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
