"""Studies and FMUs that do not do: the exit code, one line that names the place, nothing written."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from identification.calibrate import calibrate_study
from orchestrator import formats
from orchestrator.processes.pool import at_most
from orchestrator.trace import Trace
from tests.support.commands import servotwin
from tests.support.identification.small_study import COUNT, LENGTH, STEP, study, voltage, write_study

Change = dict[str, Any]

needs_compiler = pytest.mark.skipif(not compiler.available(), reason="there is no C compiler")
pytestmark = pytest.mark.usefixtures("in_this_process")


def refused(folder: Path, data: Path, code: int, **changes: Any) -> str:
    """The one line with which the command ends with this exit code, and which its document has; nothing written."""
    study_file = write_study(folder / "study.yaml", **changes)
    before = {path.name for path in folder.iterdir()}
    result = servotwin("calibrate", study_file, "--data", data, "--out", folder / "out" / "deep", "--json")
    assert result.exit_code == code, (result.stderr, result.exception)
    (line,) = result.stderr.splitlines()
    told = json.loads(result.stdout)["error"]
    assert told["exit_code"] == code and all(told[part] in line for part in ("place", "problem", "fix"))
    assert {path.name for path in folder.iterdir()} == before
    return str(line)


def parameters(**blocks: Any) -> Change:
    return {"parameters": {name.replace("__", "."): block for name, block in blocks.items()}}


FREE = {"start": 1.0, "min": 0.1, "max": 2.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            parameters(hand__inertai=FREE),
            "parameters.hand.inertai: no variable 'inertai' in 'hand'; did you mean 'inertia'?",
        ),
        (parameters(hnad__inertia=FREE), "parameters.hnad.inertia: no component 'hnad'; did you mean 'hand'?"),
        (parameters(inertia=FREE), "'inertia' does not name a variable; write component.variable"),
        (parameters(hand__angle=FREE), "parameters.hand.angle: is an output; name a parameter"),
        (
            parameters(hand__inertia={"start": 3, "min": 0.1, "max": 2}),
            "hand.inertia: start 3 is not within 0.1 to 2; move the start or the bounds",
        ),
        (parameters(hand__inertia={"start": 1, "min": 2, "max": 0.1}), "hand.inertia: bounds 2 and 0.1 leave no room"),
        (
            parameters(hand__inertia={"start": 1, "min": -0.5}),
            "hand.inertia: is -0.5, outside its bounds [0, inf); choose a value inside",
        ),
        (parameters(hand__inertia={"min": 0.1}), "parameters.hand.inertia: has no start value; give `start`"),
        (parameters(motor__back_emf={"start": 0, "min": 0}), "motor.back_emf: starts at 0 with an open bound"),
        (parameters(hand__inertia={"start": 1, "fixed": True}), "parameters: nothing is free; free a parameter"),
        (parameters(hand__inertia={"tied": "hand.angle_start"}), "is tied to 'hand.angle_start', which is no declared"),
        (
            parameters(hand__inertia=FREE | {"start": -1, "min": -2, "scale": "log"}),
            "start -1 on a log scale; start above 0",
        ),
        ({"outputs": {"hand.inertia": {"signal": "angle"}}}, "outputs.hand.inertia: is a parameter; name an output"),
        (
            {"outputs": {"hand.angel": {"signal": "angle"}}},
            "outputs.hand.angel: no variable 'angel' in 'hand'; did you mean",
        ),
        ({"outputs": {"hand.angle": {"signal": "angel"}}}, "has no signal 'angel'; it holds voltage, angle"),
        (
            {"inputs": {"motor.voltag": {"signal": "voltage"}}},
            "no variable 'voltag' in 'motor'; did you mean 'voltage'?",
        ),
        (
            {"inputs": {"hand.torque": {"signal": "voltage"}}},
            "hand.torque: has two sources, motor.torque and a stimulus",
        ),
        (
            {"inputs": {"motor.resistance": {"signal": "voltage"}}},
            "'motor.resistance' is a fixed parameter; only an input",
        ),
        ({"initial": {"hand.angel_start": {"signal": "angle"}}}, "initial.hand.angel_start: no variable 'angel_start'"),
        ({"compare": {"old": {"hand.inertai": 1}}}, "compare.old.hand.inertai: no variable 'inertai'"),
        ({"compare": {"old": {"hand.inertia": -1}}}, "hand.inertia: is -1, outside its bounds"),
        ({"truth": {"hand.mass": 1}}, "truth.hand.mass: no variable 'mass'"),
        (
            {"traces": study()["traces"] | {"values": {"hand.mass": "mass"}}},
            "traces.values.hand.mass: no variable 'mass'",
        ),
        ({"connections": ["motor.torque -> hand.angle"]}, "'hand.angle' is an output; only an input can be a target"),
        ({"step": 0.03}, "windows.length: 1 s is not a multiple of 0.03 s"),
        ({"components": {"motor": {"model": "dc_moto"}, "hand": {"model": "pendulum"}}}, "model 'dc_moto'"),
        ({"components": {"motor": {"model": "own.py"}, "hand": {"model": "pendulum"}}}, "own.py: no such file"),
        (
            {
                "components": study()["components"]
                | {"hand": {"model": "pendulum", "parameters": {"gravity": "strong"}}}
            },
            "hand.gravity: cannot be 'strong'",
        ),
    ],
)
def test_a_study_that_does_not_fit_is_one_line_with_its_place(
    tmp_path: Path, data: Path, changes: Change, problem: str
) -> None:
    line = refused(tmp_path, data, 2, **changes)
    study = tmp_path / "study.yaml"
    assert problem in line
    place = re.match(rf"servotwin: {re.escape(str(study))}(?::(\d+))?: ", line)
    elsewhere = (": has no signal", ".py", "model '", "cannot be 'strong'")
    assert place or any(words in line for words in elsewhere)
    if place and place[1]:  # the line of the key that is named
        key = study.read_text().splitlines()[int(place[1]) - 1].split('"')[1]
        assert f"{key}: " in line


def test_what_stands_in_the_way_of_the_result_is_found_before_the_work(tmp_path: Path, data: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "thesis.doc").write_text("precious")
    calls: list[float] = []
    with pytest.raises(ValueError, match="is not empty and holds no result"):
        calibrate_study(
            write_study(tmp_path / "study.yaml"), data, tmp_path / "out", lambda at, remark: calls.append(at)
        )
    assert calls == [] and (tmp_path / "out" / "thesis.doc").read_text() == "precious"


def stripped(files: dict[str, bytes]) -> dict[str, bytes]:
    return {name: text for name, text in files.items() if not name.startswith("binaries/linux")}


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (lambda fmu: fmu.write_text("no zip"), "hand.fmu: is not a zip archive"),
        (lambda fmu: fmu.write_bytes(fmu.read_bytes()[:3000]), "hand.fmu: is not a zip archive"),
        (lambda fmu: fmu.unlink(), "hand.fmu: no such file"),
        (lambda fmu: archive.write(fmu, {"a": b""}), "hand.fmu: holds no modelDescription.xml; is it an FMU?"),
        (
            lambda fmu: archive.write(fmu, stripped(archive.read(fmu))),
            "hand.fmu: has no binary for linux64 (it has: win64); export it for this platform",
        ),
    ],
)
def test_an_fmu_that_cannot_be_used_is_refused(
    tmp_path: Path, data: Path, spoil: Callable[[Path], Any], problem: str
) -> None:
    spoil(targets.build("pendulum", tmp_path / "hand.fmu", target="python"))
    components = study()["components"] | {"hand": {"fmu": "hand.fmu", "parameters": {"added_length": LENGTH}}}
    assert problem in refused(tmp_path, data, 2, components=components)


FRAGILE = '''"""Works for half a second."""
from . import ops
from .model import Model, State, input_, output, parameter

def derivatives(t, x, u, p):
    return {"y": p.gain * u.v + 0.0 * ops.log(0.5 - t)}

MODEL = Model("fragile", "Fragile", (
    input_("v", "V", "Input"), output("y", "1", "Output"), parameter("gain", "1", 1.0, "Gain"),
), states=(State("y"),), derivatives=derivatives, solver_step=lambda p: 0.01)
'''


def fragile(folder: Path, stop: float) -> Change:
    """A study of the fragile model with windows that long."""
    (folder / "fragile.py").write_text(FRAGILE)
    trace = Trace(np.arange(COUNT) * STEP, {"v": voltage(0), "y": np.cumsum(voltage(0)) * 2 * STEP})
    formats.write(trace, folder / "fragile.csv")
    return {
        "components": {"plant": {"model": "fragile.py"}},
        "connections": None,
        "traces": {"files": "fragile.csv"},
        "inputs": {"plant.v": {"signal": "v"}},
        "outputs": {"plant.y": {"signal": "y"}},
        "parameters": {"plant.gain": FREE},
        "truth": None,
        "windows": {"length": stop, "most": 1},
        "validation": None,
    }


@pytest.mark.slow
@pytest.mark.parametrize("processes", [1, 2])
@pytest.mark.parametrize(
    ("packaging", "reason"),
    [
        ("python", "ValueError: math domain error"),
        pytest.param("native", "state 'y' is nan at t = 0.5 s", marks=needs_compiler),
    ],
)
def test_an_fmu_that_fails_in_a_step_is_told_from_bad_input_by_the_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, processes: int, packaging: str, reason: str
) -> None:
    monkeypatch.setattr(targets, "preferred", lambda: packaging)
    with at_most(processes):
        line = refused(tmp_path, tmp_path, 3, **fragile(tmp_path, 0.8))
    assert line.startswith(
        f"servotwin: {tmp_path / 'study.yaml'}: start: cannot be simulated: plant: step from t = 0.4"
    )
    assert reason in line


@pytest.mark.slow
@pytest.mark.parametrize("packaging", ["python", pytest.param("native", marks=needs_compiler)])
def test_parameters_that_do_not_fit_together_are_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, packaging: str
) -> None:
    monkeypatch.setattr(targets, "preferred", lambda: packaging)
    changes = fragile(tmp_path, 0.4)
    model = FRAGILE.replace(
        '"Gain"),', '"Gain"), parameter("least", "1", 2.0, "Least"), parameter("most", "1", 1.0, "Most"),'
    ).replace(
        "solver_step=", 'requirements=(Requirement(lambda t, x, u, p: p.least < p.most, "no range"),), solver_step='
    )
    (tmp_path / "fragile.py").write_text(model.replace("import Model,", "import Model, Requirement,"))
    line = refused(tmp_path, tmp_path, 2, **changes)
    assert line == (
        f"servotwin: {tmp_path / 'study.yaml'}: start: plant: least = 2, most = 1: no range; change one of them"
    )


def test_the_same_fmu_is_calibrated_on_what_it_can_do(tmp_path: Path) -> None:
    study_file = write_study(tmp_path / "study.yaml", **fragile(tmp_path, 0.4))
    document = calibrate_study(study_file, tmp_path, tmp_path / "out", lambda at, remark: None)
    assert document["search"]["failures"] == 0


HANGING = '''"""Its solver takes steps without end where the rate is above 0.7."""
from . import ops
from .model import Model, State, input_, output, parameter

def derivatives(t, x, u, p):
    return {"y": u.v - p.rate * x.y}

MODEL = Model("hanging", "Hanging", (
    input_("v", "V", "Input"), output("y", "1", "Output"), parameter("rate", "1/s", 1.0, "Rate"),
), states=(State("y"),), derivatives=derivatives, solver_step=lambda p: ops.where(p.rate > 0.7, 1e-13, 0.01))
'''


def hanging(folder: Path) -> Change:
    """A study of the hanging model; the true rate is 0.8 / s."""
    (folder / "hanging.py").write_text(HANGING)
    v, y = np.repeat([1.0, -1.0, 0.5, 0.0], 50), [0.0]
    for driven in v[:-1]:
        y.append(y[-1] * np.exp(-0.08) + driven * (1 - np.exp(-0.08)) / 0.8)
    formats.write(Trace(np.arange(200) * 0.1, {"v": v, "y": np.array(y)}), folder / "hanging.csv")
    return {
        "components": {"plant": {"model": "hanging.py"}},
        "connections": None,
        "step": 0.1,
        "traces": {"files": "hanging.csv"},
        "inputs": {"plant.v": {"signal": "v"}},
        "outputs": {"plant.y": {"signal": "y"}},
        "parameters": {"plant.rate": {"start": 0.5, "min": 0.05, "max": 5}},
        "truth": None,
        "windows": {"length": 19},
        "validation": None,
    }


@needs_compiler
@pytest.mark.slow
def test_an_fmu_that_hangs_for_some_values_is_calibrated_on_the_others(tmp_path: Path) -> None:
    """The best of the plant is where it hangs: what it takes to learn that is counted and bounded."""
    study_file = write_study(tmp_path / "study.yaml", **hanging(tmp_path))
    asked = ("--isolate", "--patience", "1", "--json")
    answer = servotwin("calibrate", study_file, "--data", tmp_path, "--out", tmp_path / "out", *asked)
    assert answer.exit_code == 0, answer.stderr
    document = json.loads(answer.stdout)
    assert 0.6 < document["parameters"]["plant.rate"]["value"] <= 0.7
    assert document["search"]["failures"] > 0 and "gave no answer for" in document["search"]["reasons"][0]
    assert "points ahead could not be simulated; try narrower `min` and `max`" in document["verdict"]["said"]
