"""What an FMU answers with: every status is taken for what it is, and named with the FMU's own words."""

from __future__ import annotations

import logging
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np
import pytest

from fmus.errors import FmuError
from orchestrator.assembly.wiring import wire
from orchestrator.engine import CycleSettings, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.fmus import moody
from tests.support.simulation.slaves import Load
from tests.support.tools import third_party

STATUS_NAMES = {2: "discard", 3: "error", 4: "fatal error", 5: "pending", 77: "77"}


ACTIONS = {
    "set": "set input = 2.0",
    "setup": "enter initialisation",
    "enter": "enter initialisation",
    "exit": "initialise",
    "step": "step from t = 0 s by 0.1 s",
    "get": "get get, input",  # read back when the initialisation is over
    "save": "save its state",
}


def life(slave: Slave, place: str, status: int) -> None:
    """Instantiate to first step, where one function returns this status."""
    slave.bind(["input"], ["output"])
    slave.set({place: status})
    slave.set({"input": 2.0})
    slave.begin(0.0, None)
    slave.run()
    slave.step(0.0, 0.1)
    slave.read()
    slave.save()


@pytest.mark.parametrize("place", ACTIONS)
@pytest.mark.parametrize("status", STATUS_NAMES)
def test_every_status_but_ok_and_warning_is_an_error_with_the_message_formatted(
    moody_fmu: Path, place: str, status: int, load: Load
) -> None:
    slave = load(moody_fmu, "fmu")
    with pytest.raises(FmuError) as failed:
        life(slave, place, status)
    said = f"{place} said {status}, 2.500 times no"
    deadly = place == "set" and status >= 4  # an FMU that may be asked no more does not say which value it was
    action = "set set, input" if deadly else ACTIONS[place]
    problem, fix = "", ""
    if (place, STATUS_NAMES[status]) == ("exit", "discard"):
        problem = ": there is no start from these values"
        fix = "; change its parameters, start values or first inputs"
    if (place, STATUS_NAMES[status]) == ("step", "discard"):
        fix = "; it did not get through the whole step: give the run a shorter `step`"
    assert str(failed.value) == f"fmu: {action}: returned {STATUS_NAMES[status]}{problem} ({said}){fix}"
    assert failed.value.exit_code == 3


def test_a_failure_to_read_outputs_is_named(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    life(slave, "step", 0)
    slave.set({"get": 3})
    with pytest.raises(FmuError, match=r"fmu: get outputs: returned error \(get said 3, 2.500 times no\)"):
        slave.read()


def test_warnings_are_counted_and_logged_not_raised(
    moody_fmu: Path, load: Load, caplog: pytest.LogCaptureFixture
) -> None:
    slave = load(moody_fmu, "fmu")
    life(slave, "step", 1)
    assert slave.warnings == 1
    assert ("servotwin.fmu", logging.WARNING, "fmu: step said 1, 2.500 times no") in caplog.record_tuples
    slave.reset()
    assert slave.warnings == 0


@pytest.mark.parametrize("place", ACTIONS)
def test_after_a_fatal_error_no_function_of_the_fmu_is_called(moody_fmu: Path, place: str, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    with pytest.raises(FmuError, match="fatal"):
        life(slave, place, 4)
    slave.reset()
    life(slave, "step", 0)
    slave.close()
    assert moody.counter(slave, "calls_after_fatal") == 0


def test_closing_frees_the_instance_once(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    assert moody.counter(slave, "instances") == 1
    slave.close()
    slave.close()
    assert moody.counter(slave, "instances") == 0


def test_a_failure_to_instantiate_carries_the_fmus_message(moody_fmu: Path) -> None:
    with FmuFile(moody_fmu) as fmu, pytest.raises(FmuError) as failed:
        Slave(fmu, "_nobody")
    assert str(failed.value) == "_nobody: instantiate: Failed to instantiate model (no licence for '_nobody')"


def test_a_parameter_that_does_not_take_is_an_error(moody_fmu: Path, load: Load) -> None:
    slave = load(moody_fmu, "fmu")
    slave.set({"stubborn": 2.0})
    slave.begin(0.0, None)
    with pytest.raises(FmuError) as failed:
        slave.run()
    assert str(failed.value) == (
        "fmu.stubborn: was set to 2.0 but is 1.0; the FMU does not take it; remove it or ask the supplier"
    )


def test_a_failed_step_in_an_iteration_frees_its_snapshots_and_the_next_run_is_clean(moody_fmu: Path) -> None:
    with FmuFile(moody_fmu) as fmu:
        system = wire({"a": Part(fmu.interface)}, [("a.output", "a.input")])
        timing = Timing(Fraction(1), Fraction(1, 10), cycles=CycleSettings(iterate=True))
        with Simulation(system, {"a": Slave(fmu, "a")}, timing) as made:
            first = made.run().trace
            with pytest.raises(FmuError, match=r"a: step from t = 0 s by 0\.1 s: returned error"):
                made.run({"a.step": 3})
            assert np.array_equal(made.run().trace["a.output"], first["a.output"])


def test_messages_reach_their_own_instance_also_after_fmpy_ran_on_its_own(moody_fmu: Path, load: Load) -> None:
    one = load(moody_fmu, "one")
    fmpy.simulate_fmu(str(third_party.reference(2, "Dahlquist")), stop_time=0.1, logger=lambda *_: None)
    other = load(moody_fmu, "other")
    for slave, place in ((one, "step"), (other, "exit")):
        with pytest.raises(FmuError, match=rf"\({place} said 3, 2.500 times no\)"):
            life(slave, place, 3)
