"""What a study predicts with its latencies, others predict with nothing set: the engine, an SSP, FMPy at any step."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Slave
from ruamel.yaml import YAML

from fmus.packaging import archive, targets
from fmus.parameters.write_back import write_back
from identification.calibrate import calibrate_study
from orchestrator import formats, run
from orchestrator.trace import FloatArray
from tests.support.identification.small_study import TRUTH, record, write_study
from tests.support.ssv import read_values

pytestmark = pytest.mark.usefixtures("in_this_process")

WIRE, CLOCK = 0.0137, 0.0216  # of the command and of the reading [s], no multiples of the step
CLOSE = 1e-4  # of an output's range: how near a free run with twice the step is; torques are held over its steps
FEW: dict[str, Any] = {
    **{name: {"start": value, "fixed": True} for name, value in TRUTH.items()},
    "hand.viscous_friction": {"start": 0.001, "min": 0.0, "max": 0.05},
}


def calibrated(folder: Path, **changes: Any) -> Path:
    """The result of the small study, all but its friction known, with a command and a reading that come late."""
    late: dict[str, Any] = {
        "step": 0.001,
        "inputs": {"motor.voltage": {"signal": "voltage", "delay": WIRE}},
        "outputs": {"hand.angle": {"signal": "angle", "delay": "clock"}},
        "parameters": {**FEW, "clock": {"start": CLOCK, "fixed": True}},
        "windows": {"length": 0.8},
        "validation": None,
        "truth": None,
    }
    file = write_study(folder / "study.yaml", **late | changes)
    calibrate_study(file, record(folder / "data"), folder / "out", lambda fraction, remark: None)
    return folder / "out"


def apart(file: Path) -> dict[str, float]:
    """Signal -> root mean square distance of a run from what the study predicts, over its range."""
    [case] = run(file).cases
    assert case.passed
    return {check.text.split()[0]: float(check.figure or 0.0) for check in case.checks}


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return calibrated(tmp_path_factory.mktemp("late"))


@pytest.mark.slow
@pytest.mark.parametrize("form", ["yaml", "ssp"])
def test_the_scenario_in_the_result_runs_as_the_study_predicts(result: Path, form: str) -> None:
    found = apart(result / f"free_run.{form}")
    assert found == {"hand_angle_delay.late": pytest.approx(0, abs=1e-12)}


def test_what_was_on_its_way_when_the_window_began_arrives_by_its_mean(tmp_path: Path) -> None:
    """The voltage changes 5 ms before the window: the impulse of what arrives late is right, its form is not."""
    result = calibrated(tmp_path, windows={"length": 0.7, "skip": 0.105})
    assert 0 < apart(result / "free_run.yaml")["hand_angle_delay.late"] < 1e-3


class Plain:
    """An FMU of a result as FMPy runs it, with nothing set but what is of the window."""

    def __init__(self, file: Path) -> None:
        description = read_model_description(str(file))
        self._references = {variable.name: variable.valueReference for variable in description.modelVariables}
        self._fmu = FMU2Slave(
            guid=description.guid,
            unzipDirectory=extract(str(file)),
            modelIdentifier=description.coSimulation.modelIdentifier,
            instanceName=file.stem,
        )
        self._fmu.instantiate()
        self._fmu.setupExperiment(startTime=0.0)
        self._fmu.enterInitializationMode()
        self._fmu.exitInitializationMode()

    def get(self, name: str) -> float:
        return float(self._fmu.getReal([self._references[name]])[0])

    def step(self, time: float, step: float, **inputs: float) -> None:
        for name, value in inputs.items():
            self._fmu.setReal([self._references[name]], [value])
        self._fmu.doStep(currentCommunicationPoint=time, communicationStepSize=step)

    def close(self) -> None:
        self._fmu.terminate()
        self._fmu.freeInstance()


@contextmanager
def plainly(result: Path, *names: str) -> Iterator[list[Plain]]:
    with ExitStack() as stack:
        opened = []
        for name in names:
            opened.append(Plain(result / "fmus" / f"{name}.fmu"))
            stack.callback(opened[-1].close)
        yield opened


def by_fmpy(result: Path, step: float) -> tuple[FloatArray, FloatArray]:
    """(K,) instants [s] and (K,) the late angle [rad] of the first window, stepped by FMPy alone."""
    commands = formats.read(result / "free_run_commands.csv").trace
    count = round(commands.time[-1] / step)
    late = []
    with plainly(result, "motor_voltage_delay", "motor", "hand", "hand_angle_delay") as (wire, motor, hand, clock):
        for k in range(count):
            row = int(np.searchsorted(commands.time, k * step + 1e-9, side="right")) - 1
            angle, speed = hand.get("angle"), hand.get("speed")
            wire.step(k * step, step, signal=float(commands["motor.voltage"][row]))
            motor.step(k * step, step, voltage=wire.get("late"), speed=speed)
            hand.step(k * step, step, torque=motor.get("torque"))
            clock.step(k * step, step, signal=angle)
            late.append(clock.get("late"))
    return np.arange(1, count + 1) * step, np.array(late)


@pytest.mark.parametrize(("step", "close"), [(1e-3, 1e-10), (2e-3, CLOSE)])
def test_plain_fmpy_predicts_what_the_study_does_whatever_its_step(result: Path, step: float, close: float) -> None:
    time, late = by_fmpy(result, step)
    predicted = formats.read(result / "free_run_outputs.csv").trace
    own = np.searchsorted(time, predicted.time - 1e-9)
    both = np.isclose(time[np.minimum(own, len(time) - 1)], predicted.time, rtol=0, atol=1e-9)
    assert both.sum() > 300
    angle = predicted["hand.angle"]
    assert late[own[both]] == pytest.approx(angle[both], abs=close * np.ptp(angle))
    prompt = np.interp(time[own[both]] + CLOCK, time, late)
    assert np.abs(prompt - angle[both]).max() > 100 * CLOSE * np.ptp(angle)  # without the delay it would be seen


def test_of_values_for_each_recording_the_free_run_has_those_of_its_own(tmp_path: Path) -> None:
    several: dict[str, Any] = {
        "hand.viscous_friction": {"start": 0.001, "min": 0.0, "max": 0.05, "by": "trace"},
        "wire": {"start": 0.005, "min": 0.0, "max": 0.02, "by": "trace"},
    }
    wired = {"motor.voltage": {"signal": "voltage", "delay": "wire"}}
    angle = {"hand.angle": {"signal": "angle"}}
    result = calibrated(tmp_path, inputs=wired, outputs=angle, parameters={**FEW, **several})
    assert apart(result / "free_run.yaml") == {"hand.angle": pytest.approx(0, abs=1e-12)}


def test_what_is_early_stays_behind_and_is_told(tmp_path: Path) -> None:
    early = {"motor.voltage": {"signal": "voltage", "delay": -0.004}}
    result = calibrated(tmp_path, inputs=early, outputs={"hand.angle": {"signal": "angle"}}, parameters=FEW)
    warnings = json.loads((result / "summary.json").read_text())["warnings"]
    assert any("motor.voltage is driven -0.004 s late, which stays in the result" in line for line in warnings)
    assert {file.name for file in (result / "fmus").iterdir()} == {"motor.fmu", "hand.fmu"}
    assert apart(result / "free_run.yaml") == {"hand.angle": pytest.approx(0, abs=1e-12)}


def of_another_tool(path: Path) -> Path:
    """A pendulum that says that another tool has built it, so that nothing can be written into it."""
    files = archive.read(targets.build("pendulum", path.with_name("ours.fmu")))
    description = files["modelDescription.xml"]
    files["modelDescription.xml"] = description.replace(b'generationTool="servotwin"', b'generationTool="another"')
    assert files["modelDescription.xml"] != description
    archive.write(path, files)
    return path


def test_fmus_that_cannot_hold_values_are_given_them_by_the_scenario(tmp_path: Path) -> None:
    of_another_tool(tmp_path / "hand.fmu")
    hand = {"fmu": "hand.fmu", "parameters": {"added_length": 0.1}}
    result = calibrated(tmp_path, components={"motor": {"model": "dc_motor"}, "hand": hand})
    assert (result / "fmus" / "hand.ssv").is_file()
    for form in ("yaml", "ssp"):
        assert apart(result / f"free_run.{form}") == {"hand_angle_delay.late": pytest.approx(0, abs=1e-12)}


@pytest.mark.slow
def test_a_component_keeps_its_own_step_and_solver(tmp_path: Path) -> None:
    solved = {"model": "pendulum", "parameters": {"added_length": 0.1}, "solver": {"relative_tolerance": 1e-8}}
    slow = {"model": "dc_motor", "step": 0.002}
    result = calibrated(tmp_path, components={"motor": slow, "hand": solved})
    written = YAML().load(result / "free_run.yaml")["components"]
    assert written["motor"]["step"] == "0.002" and written["hand"]["solver"]["relative_tolerance"] == 1e-8
    close = 1e-6  # steps of the solver, which rounding errors of its inputs decide, are within its tolerance
    assert apart(result / "free_run.yaml") == {"hand_angle_delay.late": pytest.approx(0, abs=close)}


def test_the_parameter_set_has_what_an_fmu_had_before_too(tmp_path: Path) -> None:
    built = targets.build("dc_motor", tmp_path / "plain.fmu")
    write_back(built, {"back_emf": 0.001}, tmp_path / "motor.fmu")
    components = {
        "motor": {"fmu": "motor.fmu"},
        "hand": {"model": "pendulum", "parameters": {"added_length": 0.1}},
    }
    result = calibrated(tmp_path, components=components)
    values = read_values(result / "parameters.ssv")
    assert values["motor.back_emf"] == 0.001
    assert values["hand.added_length"] == 0.1
    assert "motor.resistance" not in values
