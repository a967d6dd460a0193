"""Isolated FMUs compute the same bits; what they do to their process costs that component alone and leaves nothing."""

from __future__ import annotations

import logging
import re
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import FmuError, InputError, ServotwinError, WiringError
from fmus.packaging import targets
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.assembly.wiring import wire
from orchestrator.engine import CycleSettings, Simulation, Timing
from orchestrator.fmi.component import Component
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.isolation import IsolatedSlave, Isolation
from orchestrator.fmi.slave import Slave
from orchestrator.solvers.base import SolverSettings
from orchestrator.system import Part
from orchestrator.trace import Trace
from tests.support.fmus import brute
from tests.support.fmus.brute import Mood
from tests.support.tools import third_party

ROOT = Path(__file__).parents[4]


Make = Callable[[FmuFile, str], Component]


pytestmark = [
    pytest.mark.slow,  # processes, compilers or minutes of work
    pytest.mark.skipif(sys.platform != "linux", reason="finds processes in /proc"),
]


def isolated(fmu: FmuFile, name: str, patience: float = 20.0, make: Make = Slave) -> IsolatedSlave:
    return IsolatedSlave(make, fmu, name, Isolation(patience))


MAKERS: dict[str, Make] = {"here": Slave, "isolated": isolated}


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
    ({"stubborn": "much"}, WiringError, "fmu.stubborn: cannot be 'much'; give a Real"),
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


def test_an_isolated_fmu_is_not_asked_for_its_debug_messages(
    fmus: dict[int, Path], caplog: pytest.LogCaptureFixture
) -> None:
    with FmuFile(fmus[2]) as fmu, caplog.at_level(logging.DEBUG, "servotwin.fmu"):
        component = isolated(fmu, "wheel")
        lag(component)
        component.close()
    assert not caplog.messages


@pytest.mark.parametrize("patience", [0.0, -1.0, float("nan"), float("inf")])
def test_a_patience_that_is_none_is_refused(patience: float) -> None:
    with pytest.raises(InputError, match=r"--patience: is .* s; give more than 0 and at most 1e"):
        Isolation(patience)
