"""Studies and results that do not fit together: the exit code, one line that names the place, nothing written."""

from __future__ import annotations

import hashlib
import itertools
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from typer.testing import CliRunner

from fmus.errors import FmuError
from fmus.packaging import archive, targets
from fmus.packaging.native import compiler
from identification.calibrate import calibrate_study, layout_of, validate_result
from identification.cli import app
from identification.output_error import calibration
from identification.output_error.simulator import SystemSimulator
from orchestrator import formats
from orchestrator.processes import pool
from orchestrator.results import RECORD
from orchestrator.scenario.exchange import export
from orchestrator.trace import Trace
from tests.support.identification.small_study import COUNT, LENGTH, STEP, record, study, voltage, write_study

Change = dict[str, Any]

needs_compiler = pytest.mark.skipif(not compiler.available(), reason="there is no C compiler")


@pytest.fixture(autouse=True)
def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(calibration, "processors", lambda: 1)


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record(tmp_path_factory.mktemp("data"))


def refused(folder: Path, data: Path, code: int, **changes: Any) -> str:
    """The one line with which the command ends with this exit code, and which its document has; nothing written."""
    study_file = write_study(folder / "study.yaml", **changes)
    before = {path.name for path in folder.iterdir()}
    command = ["calibrate", str(study_file), "--data", str(data), "--out", str(folder / "out" / "deep"), "--json"]
    result = CliRunner().invoke(app, command)
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
    assert problem in line
    assert (
        line.startswith(f"servotwin: {tmp_path / 'study.yaml'}: ")
        or ": has no signal" in line
        or ".py" in line
        or ("model '" in line or "cannot be 'strong'" in line)
    )


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
    monkeypatch.setattr(calibration, "processors", lambda: processes)
    monkeypatch.setattr(targets, "preferred", lambda: packaging)
    line = refused(tmp_path, tmp_path, 3, **fragile(tmp_path, 0.8))
    assert line.startswith(
        f"servotwin: {tmp_path / 'study.yaml'}: start: cannot be simulated: plant: step from t = 0.4"
    )
    assert reason in line


def test_the_same_fmu_is_calibrated_on_what_it_can_do(tmp_path: Path) -> None:
    study_file = write_study(tmp_path / "study.yaml", **fragile(tmp_path, 0.4))
    document = calibrate_study(study_file, tmp_path, tmp_path / "out", lambda at, remark: None)
    assert document["search"]["failures"] == 0


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory, data: Path) -> Path:
    """A calibration of one parameter."""
    folder = tmp_path_factory.mktemp("result")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration, "processors", lambda: 1)
        study_file = write_study(folder / "study.yaml", **parameters(hand__inertia={"start": 0.004, "min": 0.001}))
        calibrate_study(study_file, data, folder / "out", lambda at, remark: None)
    return folder / "out"


def validate(folder: Path, data: Path, *options: str) -> Any:
    return CliRunner().invoke(app, ["validate", str(folder), "--data", str(data), *options])


def test_progress_of_a_calibration_never_goes_back_and_ends_full(tmp_path: Path, data: Path) -> None:
    told: list[float] = []
    calibrate_study(write_study(tmp_path / "study.yaml"), data, tmp_path / "out", lambda at, remark: told.append(at))
    assert told == sorted(told) and told[-1] == 1 and all(0 <= at <= 1 for at in told)


def test_a_validation_that_misses_its_target_has_exit_code_1_and_still_leaves_its_report(
    result: Path, data: Path, tmp_path: Path
) -> None:
    """One parameter alone cannot make up for the others, which are the library's."""
    answer = validate(result, data, "--out", str(tmp_path / "out"), "--json")
    assert answer.exit_code == 1, answer.stderr
    document = json.loads(answer.stdout)
    assert document["held"] is False and document["fit"]["unseen"]["median"] < document["at_least"]
    assert {path.name for path in (tmp_path / "out").iterdir()} - {RECORD} == {"summary.json", "report.html"}


def calibrated(folder: Path, data: Path, *options: str, **changes: Any) -> Any:
    study_file = write_study(folder / "study.yaml", **changes)
    out = str(folder / "out")
    return CliRunner().invoke(app, ["calibrate", str(study_file), "--data", str(data), "--out", out, *options])


@pytest.mark.slow
def test_a_calibration_whose_validation_misses_its_target_ends_with_exit_code_1_and_says_so_last(
    tmp_path: Path, data: Path
) -> None:
    answer = calibrated(tmp_path, data, validation={"length": 1, "at_least": 1.0})
    assert answer.exit_code == 1
    assert answer.stdout.splitlines()[-1].startswith("MISSED: median FIT, unseen, 0.9")
    assert "± 95 %: intervals take the model, and whatever is fixed in it" in " ".join(answer.stdout.split())
    verdict = json.loads((tmp_path / "out" / "summary.json").read_text())["verdict"]
    assert not verdict["held"] and verdict["converged"] and 0.9 < verdict["reached"] < verdict["at_least"] == 1.0
    assert "MISSED: median FIT, unseen" in (tmp_path / "out" / "report.html").read_text()


def test_the_command_line_says_how_many_simulations_run_at_a_time(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[int] = []
    monkeypatch.setattr(calibration, "processors", lambda: asked.append(pool.processors()) or 1)
    monkeypatch.setattr(calibration, "_SHORT", 0)
    assert calibrated(tmp_path, data, "-j", "3").exit_code == 0
    assert set(asked) == {3}


def test_a_target_without_recordings_held_out_is_for_the_fitted_ones(tmp_path: Path, data: Path) -> None:
    traces = study()["traces"] | {"hold_out": []}
    answer = calibrated(tmp_path, data, traces=traces, validation={"length": 1, "at_least": 0.5})
    assert answer.exit_code == 0
    assert answer.stdout.splitlines()[-1].startswith("held: median FIT, fitted (no trace was held out), 0.9")


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
    command = ["calibrate", str(study_file), "--data", str(tmp_path), "--out", str(tmp_path / "out"), "--json"]
    answer = CliRunner().invoke(app, [*command, "--isolate", "--patience", "1"])
    assert answer.exit_code == 0, answer.stderr
    document = json.loads(answer.stdout)
    assert 0.6 < document["parameters"]["plant.rate"]["value"] <= 0.7
    assert document["search"]["failures"] > 0 and "gave no answer for" in document["search"]["reasons"][0]
    assert "points ahead could not be simulated; try narrower `min` and `max`" in document["verdict"]["said"]


def test_an_interrupt_leaves_what_had_been_estimated(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs, simulate = itertools.count(), SystemSimulator.simulate

    def interrupted(self: SystemSimulator, window: int, values: dict[str, float]) -> Any:
        if next(runs) > 40:
            raise KeyboardInterrupt
        return simulate(self, window, values)

    monkeypatch.setattr(SystemSimulator, "simulate", interrupted)
    answer = calibrated(tmp_path, data)
    out = tmp_path / "out"
    assert answer.exit_code == 130
    (line,) = answer.stderr.splitlines()
    assert line == f"interrupted; what had been estimated is in {out}, without intervals and not validated"
    document = json.loads((out / "summary.json").read_text())
    assert document["verdict"]["said"].startswith("STOPPED, stopped: interrupted; the values are those of iteration")
    assert document["parameters"]["hand.inertia"]["std"] is None and document["fit"]["validation"] is None
    assert {"fmus", "parameters.ssv", "report.html"} <= {path.name for path in out.iterdir()}


def test_an_interrupt_before_anything_was_estimated_says_so(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(self: SystemSimulator, window: int, values: dict[str, float]) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(SystemSimulator, "simulate", interrupted)
    answer = calibrated(tmp_path, data)
    assert answer.exit_code == 130 and not (tmp_path / "out").exists()
    assert answer.stderr.strip() == "interrupted before anything was estimated; nothing is written"


def test_fmus_that_fail_in_the_validation_do_not_take_the_estimate_with_them(
    tmp_path: Path, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failed(*_: Any) -> None:
        raise FmuError("hand", "step from t = 0.5 s by 0.01 s: returned error")

    monkeypatch.setattr(calibration, "judge", failed)
    answer = calibrated(tmp_path, data)
    assert answer.exit_code == 3
    (line,) = answer.stderr.splitlines()
    assert line.endswith(f"returned error; what had been estimated is in {tmp_path / 'out'}, not validated")
    document = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert document["parameters"]["hand.inertia"]["std"] is not None
    assert document["verdict"]["said"].startswith("STOPPED, not validated: hand: step from")


def test_a_search_that_was_cut_short_says_on_the_last_line_what_to_do(tmp_path: Path, data: Path) -> None:
    answer = calibrated(tmp_path, data, "--json", options={"max_evaluations": 1}, validation=None)
    assert answer.exit_code == 0
    verdict = json.loads(answer.stdout)["verdict"]
    assert verdict["held"] and not verdict["converged"]
    assert (
        verdict["said"].startswith("NOT CONVERGED: stopped") and "`options.max_evaluations` above 1" in verdict["said"]
    )
    assert "`scale: log` for hand.inertia" in verdict["said"]


def test_recordings_are_known_by_their_bytes_not_by_their_names(result: Path, data: Path, tmp_path: Path) -> None:
    shutil.copyfile(data / "rig_0__a.csv", tmp_path / "rig_0__renamed.csv")
    document = json.loads(validate(result, tmp_path, "--out", str(tmp_path / "out"), "--json").stdout)
    assert set(document["fit"]) == {"fitted"}
    assert document["warnings"] == ["every recording was used in the fit; this judges nothing new"]


def test_one_file_can_be_validated_and_lies_beside_the_result_by_default(
    result: Path, data: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(result, copy)
    document = json.loads(validate(copy, data / "rig_100__c.csv", "--json").stdout)
    assert set(document["fit"]["unseen"]["traces"]) == {"rig_100__c"}
    assert (copy / "validation" / "report.html").is_file()


@pytest.mark.parametrize(
    ("spoil", "problem"),
    [
        (shutil.rmtree, "holds no study.yaml; give a folder that `servotwin calibrate` wrote"),
        (lambda folder: (folder / "study.yaml").unlink(), "holds no study.yaml"),
        (lambda folder: (folder / "summary.json").unlink(), "holds no summary.json"),
        (lambda folder: (folder / "summary.json").write_text("{"), "is not a calibration's summary"),
        (lambda folder: (folder / "summary.json").write_text("[]"), "is not a calibration's summary"),
        (lambda folder: (folder / "fmus" / "hand.fmu").unlink(), "hand.fmu: no such file"),
        (lambda folder: archive.write(folder / "fmus" / "hand.fmu", {"a": b""}), "holds no modelDescription.xml"),
    ],
)
def test_a_folder_that_is_no_result_is_refused_in_one_line(
    result: Path, data: Path, tmp_path: Path, spoil: Callable[[Path], Any], problem: str
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(result, copy)
    spoil(copy)
    answer = validate(copy, data, "--out", str(tmp_path / "out"), "--json")
    assert answer.exit_code == 2 and json.loads(answer.stdout)["error"]["exit_code"] == 2
    (line,) = answer.stderr.splitlines()
    assert problem in line
    assert not (tmp_path / "out").exists()


def test_recordings_that_a_result_cannot_read_are_refused(result: Path, tmp_path: Path) -> None:
    answer = validate(result, tmp_path / "none", "--out", str(tmp_path / "out"))
    assert answer.exit_code == 2 and "none: no such file or folder" in answer.stderr
    assert list(tmp_path.iterdir()) == []


def test_the_layout_of_a_study_reads_recordings_elsewhere(tmp_path: Path) -> None:
    traces = study()["traces"] | {"layout": {"time": "t", "columns": {"angle": "theta"}}}
    layout = layout_of(write_study(tmp_path / "study.yaml", traces=traces))
    assert (layout.time, layout.columns) == ("t", {"angle": "theta"})


def test_validating_twice_gives_the_same_verdict(result: Path, data: Path, tmp_path: Path) -> None:
    one, other = (validate_result(result, data, tmp_path / name, lambda at, remark: None) for name in ("a", "b"))
    assert one == other


def test_a_study_takes_its_system_from_an_ssp(tmp_path: Path, data: Path) -> None:
    system = {key: study()[key] for key in ("components", "connections")}
    scenario = {"title": "rig", **system, "run": {"stop": 1, "step": 0.01}}
    (tmp_path / "rig.yaml").write_text(json.dumps(scenario))
    export(tmp_path / "rig.yaml", tmp_path / "rig.ssp")
    plain = write_study(tmp_path / "plain.yaml")
    taken = write_study(tmp_path / "taken.yaml", include=["rig.ssp"], components=None, connections=None)
    expected, found = (
        calibrate_study(file, data, tmp_path / file.stem, lambda fraction, doing: None)["parameters"]
        for file in (plain, taken)
    )
    assert {name: one["value"] for name, one in found.items()} == {name: one["value"] for name, one in expected.items()}
    judged = [
        validate_result(tmp_path / name, data, tmp_path / f"{name}-judged", lambda fraction, doing: None)
        for name in ("taken", "plain")
    ]
    assert judged[0]["fit"] == judged[1]["fit"]


def test_the_parameter_set_comes_with_what_it_is_from(tmp_path: Path, data: Path) -> None:
    summary = calibrate_study(write_study(tmp_path / "s.yaml"), data, tmp_path / "out", lambda fraction, doing: None)
    root = ElementTree.fromstring((tmp_path / "out" / "parameters.srmd").read_bytes())
    content = (tmp_path / "out" / "parameters.ssv").read_bytes()
    assert root.get("checksum") == hashlib.sha3_256(content).hexdigest()
    said = {str(entry.get("keyword")): str(entry.text) for entry in root.iter() if entry.get("keyword")}
    assert said["method"] == "output-error"
    assert all(any(one["sha256"] in text for text in said.values()) for one in summary["data"])
    for name, parameter in summary["parameters"].items():
        low, high = parameter["ci95"] or (None, None)
        assert said[name] == f"95 % from {low!r} to {high!r} {parameter['unit']}"
