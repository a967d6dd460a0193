"""Wired systems as linear models: those of textbooks, of other programs, and of the runs that they are taken from."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import control
import numpy as np
import pytest
from fmpy import extract, read_model_description
from fmpy.fmi2 import FMU2Model
from ruamel.yaml import YAML
from scipy.linalg import expm
from scipy.signal import cont2discrete

from fmus import library
from fmus.errors import IdentificationError, InputError, WiringError
from fmus.packaging import targets
from identification import linearise
from identification.linear.fmu import model_in
from identification.linear.model import LinearModel
from identification.linearisation.result import FMU, Linearised
from identification.linearisation.slopes import DIFFERENCES, DIRECTIONAL, MATRICES, TANGENTS
from orchestrator import open_system, run
from orchestrator.fmi.file import FmuDescription
from orchestrator.trace import FloatArray
from tests.support.commands import servotwin
from tests.support.identification.beam import Arm, finite_element_modes

pytestmark = pytest.mark.slow  # each builds FMUs
INERTIA, FRICTION, GRAVITY = 3.25e-3, 1e-3, 0.04905
PENDULUM = {"inertia": INERTIA, "viscous_friction": FRICTION, "gravity_torque": GRAVITY}
SMOOTH = {"bristle_stiffness": 1e-6, "bristle_damping": 0.0}


def scenario(folder: Path, **document: Any) -> Path:
    file = folder / "scenario.yaml"
    YAML().dump({"title": "A test", **document}, file)
    return file


def hand(**parameters: float) -> dict[str, Any]:
    return {"model": "pendulum", "parameters": PENDULUM | parameters}


def swinging(folder: Path, step: float = 0.01, torque: float = 0.0, **parameters: float) -> Path:
    return scenario(
        folder,
        components={"hand": hand(**parameters)},
        stimuli={"hand.torque": {"constant": torque}},
        run={"stop": 4, "step": step},
        record=["hand.angle", "hand.speed"],
    )


def held(a: FloatArray, b: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """A and B of x' = a x + b u over a step of held inputs."""
    n, m = b.shape
    whole = expm(np.block([[a, b], [np.zeros((m, n + m))]]) * step)
    return whole[:n, :n], whole[:n, n:]


def same_response(
    found: LinearModel, a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray, **near: float
) -> None:
    """Whatever the states are: the responses at some frequencies are those of these discrete matrices."""
    for omega in np.array([0.01, 0.1, 0.5, 0.9]) * math.pi / found.step:
        z = np.exp(1j * omega * found.step)
        known = c @ np.linalg.solve(z * np.eye(len(a)) - a, b) + d
        [response] = found.frequency_response(np.array([omega]))
        assert response == pytest.approx(known, **(near or {"rel": 1e-7, "abs": 1e-12}))


@pytest.mark.parametrize("angle", [0.0, 0.6, math.pi])
def test_a_pendulum_has_the_modes_of_its_closed_form_hanging_held_aside_and_upright(
    tmp_path: Path, angle: float
) -> None:
    found = linearise(swinging(tmp_path, torque=GRAVITY * math.sin(angle), angle_start=angle))
    a = np.array([[0, 1], [-GRAVITY * math.cos(angle) / INERTIA, -FRICTION / INERTIA]])
    b = np.array([[0], [1 / INERTIA]])
    same_response(found.model, *held(a, b, 0.01), np.eye(2), np.zeros((2, 1)))
    assert sorted(np.log(found.model.eigenvalues) / 0.01, key=lambda x: (x.real, x.imag)) == pytest.approx(
        sorted(np.linalg.eigvals(a), key=lambda x: (x.real, x.imag)), rel=1e-7
    )
    assert found.by == {"hand": DIRECTIONAL}
    assert found.zero.y == pytest.approx([angle, 0.0])
    assert found.zero.u == pytest.approx([GRAVITY * math.sin(angle)])
    assert "rests" in found.point
    assert any("unstable" in remark for remark in found.remarks) == (angle > 2)


def test_modes_are_told_as_frequency_and_damping(tmp_path: Path) -> None:
    [mode] = linearise(swinging(tmp_path)).modes
    natural = math.sqrt(GRAVITY / INERTIA)
    assert mode.frequency == pytest.approx(natural / 2 / math.pi, rel=1e-7)
    assert mode.damping == pytest.approx(FRICTION / INERTIA / 2 / natural, rel=1e-6)


def test_about_a_point_of_a_motion_the_model_tells_departures_from_it(tmp_path: Path) -> None:
    """Two runs with a little torque more or less part as the model says, to second order."""
    file = swinging(tmp_path, angle_start=1.0)
    found = linearise(file, at=1.0)
    angle = run(file).cases[0].trace["hand.angle"][100]  # type: ignore[index]
    assert found.zero.y[0] == pytest.approx(angle, rel=1e-9)
    assert "moves" in found.point
    assert any("does not rest at 1 s" in remark for remark in found.remarks)
    a = np.array([[0, 1], [-GRAVITY * math.cos(angle) / INERTIA, -FRICTION / INERTIA]])
    same_response(found.model, *held(a, np.array([[0], [1 / INERTIA]]), 0.01), np.eye(2), np.zeros((2, 1)))


def test_the_arm_has_the_modes_of_finite_elements(tmp_path: Path) -> None:
    """To what five assumed modes give; the hub is free but for a viscosity that hardly damps it."""
    file = scenario(
        tmp_path,
        components={"arm": {"model": "flexible_arm", "parameters": {**SMOOTH, "viscous_friction": 1e-6}}},
        stimuli={"arm.torque": {"constant": 0}},
        run={"stop": 1, "step": 0.002},
        record=["arm.angle", "arm.middle_strain"],
    )
    found = sorted(mode.frequency for mode in linearise(file).modes if mode.frequency > 1)
    assert found[:3] == pytest.approx(finite_element_modes(Arm(), 3), rel=0.01)


def test_an_fmu_is_the_one_that_fmpy_and_scipy_make_of_its_directional_derivatives(tmp_path: Path) -> None:
    file = targets.build(
        library.find("flexible_arm"), tmp_path / "arm.fmu", target="native", parameters={**SMOOTH, "payload": 0.2}
    )
    a, b, c, d = by_fmpy(file, tmp_path / "unpacked", ["torque"], ["angle", "speed", "middle_strain"])
    known = cont2discrete((a, b, c, d), 0.01)
    found = linearise(file)
    rows = [[signal.name for signal in found.outputs].index(name) for name in ("angle", "speed", "middle_strain")]
    column = [[signal.name for signal in found.inputs].index("torque")]
    model = found.model
    chosen = LinearModel(
        model.a, model.b[:, column], model.c[rows], model.d[np.ix_(rows, column)], model.step, ("u",), tuple("abc")
    )
    same_response(chosen, *known[:4], rel=1e-6, abs=1e-9)


def by_fmpy(file: Path, folder: Path, inputs: list[str], outputs: list[str]) -> tuple[FloatArray, ...]:
    """The continuous matrices of an FMU 2.0 where it starts."""
    description = read_model_description(str(file))
    by_name = {variable.name: variable for variable in description.modelVariables}
    rates = [unknown.variable for unknown in description.derivatives]
    knowns = [rate.derivative.valueReference for rate in rates] + [by_name[name].valueReference for name in inputs]
    unknowns = [rate.valueReference for rate in rates] + [by_name[name].valueReference for name in outputs]
    fmu = FMU2Model(
        guid=description.guid,
        unzipDirectory=extract(str(file), str(folder)),
        modelIdentifier=description.modelExchange.modelIdentifier,
    )
    fmu.instantiate()
    fmu.setupExperiment()
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    whole = np.array([fmu.getDirectionalDerivative(unknowns, [known], [1.0]) for known in knowns]).T
    fmu.terminate()
    fmu.freeInstance()
    n = len(rates)
    return whole[:n, :n], whole[:n, n:], whole[n:, :n], whole[n:, n:]


def servo(folder: Path, **changes: Any) -> Path:
    """A pendulum on a motor under a sampled controller, which measures it by a channel."""
    document: dict[str, Any] = {
        "components": {
            "controller": {"model": "pi", "parameters": {"sample_time": 0.01}},
            "channel": {"model": "daq", "parameters": {"sample_time": 0.01, "filter_order": 1, "cutoff": 20.0}},
            "motor": {"model": "dc_motor", "parameters": {"torque_gain": 0.5, "back_emf": 0.02}},
            "hand": hand(),
        },
        "connections": [
            "hand.angle -> channel.signal",
            "channel.measured -> controller.position",
            "controller.voltage -> motor.voltage",
            "hand.speed -> motor.speed",
            "motor.torque -> hand.torque",
        ],
        "stimuli": {"controller.reference": {"constant": 0}},
        "run": {"stop": 3, "step": 0.01},
        "record": ["hand.angle", "controller.voltage"],
    }
    return scenario(folder, **document | changes)


def test_a_sampled_loop_is_that_of_python_control(tmp_path: Path) -> None:
    found = linearise(servo(tmp_path))
    pole, kp, ki = 2 * math.pi * 20.0, 0.3998, 0.0178
    a = np.array(
        [[0, 1, 0], [-GRAVITY / INERTIA, -(FRICTION + 0.5 * 0.02) / INERTIA, 0], [pole, 0, -pole]], dtype=float
    )
    plant = control.c2d(control.ss(a, [[0], [0.5 / INERTIA], [0]], [[1, 0, 0], [0, 0, 1]], 0), 0.01, "zoh")
    law = control.ss([[1]], [[ki * 0.01]], [[1]], [[kp + ki * 0.01]], 0.01)
    loop = control.feedback(control.series(law, plant), control.ss([], [], [], [[0, 1]], 0.01))
    place = [signal.of for signal in found.inputs].index("controller.reference")
    for omega in (0.1, 1.0, 10.0, 100.0):
        [response] = found.model.frequency_response(np.array([omega]))
        known = loop(np.exp(1j * omega * 0.01))
        assert response[0, place] == pytest.approx(known[0, 0], rel=1e-5, abs=1e-9)
    assert found.by == {"controller": TANGENTS, "channel": DIFFERENCES, "motor": DIRECTIONAL, "hand": DIRECTIONAL}
    assert found.model.step == 0.01


def test_a_sampled_loop_answers_small_commands_as_its_run_does(tmp_path: Path) -> None:
    """Without what couples within a step, to what the pendulum bends and its integration rounds."""
    file = servo(tmp_path)
    exact = {"channel.filter_order": 0, "motor.back_emf": 0.0}
    found = linearise(file, values=exact)
    document = YAML(typ="safe").load(file.read_text()) | {"stimuli": {"controller.reference": {"constant": 1e-4}}}
    YAML().dump(document, file)
    [case] = run(file, exact).cases
    assert case.trace is not None
    u = np.zeros((len(case.trace), len(found.inputs)))
    u[:, [signal.of for signal in found.inputs].index("controller.reference")] = 1e-4
    told = found.model.simulate(u)
    near = 2e-6 * np.abs(told).max(axis=0)
    assert np.abs(case.trace["hand.angle"] - told[:, 0]).max() < near[0]
    assert np.abs(case.trace["controller.voltage"][1:] - told[:-1, 1]).max() < near[1]


def test_what_a_source_gives_is_an_input(tmp_path: Path) -> None:
    file = scenario(
        tmp_path,
        components={"drive": {"model": "excitation", "parameters": {"amplitude": 0.0, "offset": 0.01}}, "hand": hand()},
        connections=["3 * drive.signal -> hand.torque"],
        run={"stop": 1, "step": 0.01},
        record=["hand.angle"],
    )
    found = linearise(file)
    assert [(signal.of, signal.zero) for signal in found.inputs] == [("drive.signal", 0.01)]
    alone = linearise(swinging(tmp_path))
    [[response]], [[[single], _]] = (one.model.frequency_response(np.array([5.0]))[:, 0:2] for one in (found, alone))
    assert response == pytest.approx(3 * single)


def test_the_fmu_that_is_written_holds_the_model_about_its_point_and_is_its_own_linearisation(tmp_path: Path) -> None:
    found = linearise(swinging(tmp_path, torque=GRAVITY * math.sin(0.6), angle_start=0.6))
    folder = found.write(tmp_path / "linear")
    file = folder / FMU
    assert model_in(FmuDescription(file).interface, "fmu") == found.model
    with open_system({"linear": file}, stimulated=["linear.torque"]) as system:
        rest = found.zero.u[0]
        result = system.run(1, "0.01", stimuli={"linear.torque": rest + 1e-4}).trace
    told = found.model.simulate(np.full((len(result), 1), 1e-4))
    assert result["linear.angle"] == pytest.approx(0.6 + told[:, 0], rel=1e-9)
    again = linearise(file)
    assert again.by == {"linear": MATRICES}
    assert again.model.step == found.model.step
    assert again.model.frequency_response(np.array([5.0])) == pytest.approx(
        found.model.frequency_response(np.array([5.0]))
    )


def test_a_case_has_its_own_values_and_its_own_components(tmp_path: Path) -> None:
    file = scenario(
        tmp_path,
        components={"hand": hand()},
        stimuli={"hand.torque": {"constant": 0}},
        run={"stop": 1, "step": 0.01},
        record=["hand.angle"],
        cases=[
            {"name": "bare"},
            {"name": "heavy", "set": {"hand.inertia": 4 * INERTIA}},
            {"name": "stiff", "components": {"hand": hand(gravity_torque=9 * GRAVITY)}},
        ],
    )
    bare, heavy, stiff = (linearise(file, case=name) for name in ("bare", "heavy", "stiff"))

    def omega(found: Linearised, gravity: float, inertia: float) -> None:
        [mode] = found.modes
        own, decay = gravity / inertia, FRICTION / (2 * inertia)
        assert 2 * math.pi * mode.frequency == pytest.approx(math.sqrt(own), rel=1e-6)
        assert mode.damping == pytest.approx(decay / math.sqrt(own), rel=1e-6)

    omega(bare, GRAVITY, INERTIA)
    omega(heavy, GRAVITY, 4 * INERTIA)
    omega(stiff, 9 * GRAVITY, INERTIA)
    assert [found.case for found in (bare, heavy, stiff)] == ["bare", "heavy", "stiff"]
    assert "of 3 cases it is the first, bare" in bare.remarks and "of 3 cases it is stiff" in stiff.remarks
    done = servotwin("linearise", file, "--case", "stiff", "--out", tmp_path / "out", "--json")
    assert json.loads(done.stdout)["case"] == "stiff"
    with pytest.raises(InputError, match="has no case 'light'; its cases are bare, heavy, stiff"):
        linearise(file, case="light")


def test_what_cannot_be_linearised_is_refused_with_the_reason(tmp_path: Path) -> None:
    with pytest.raises(IdentificationError, match="jumps or bends"):
        linearise(
            swinging(tmp_path, coulomb_friction_positive=0.01, coulomb_friction_negative=0.01, friction_speed=1e-6)
        )
    file = servo(tmp_path)
    with pytest.raises(IdentificationError, match=r"channel.*rounds what it samples; set its `bits` to 0"):
        linearise(file, values={"channel.bits": 12, "channel.range": 5.0})
    with pytest.raises(IdentificationError, match=r"channel: samples every 0.02 s, and controller every 0.01 s"):
        linearise(file, values={"channel.sample_time": 0.02})
    with pytest.raises(WiringError, match=r"--at: 9 s is outside of the run, 0 to 3 s"):
        linearise(file, at=9)
    with pytest.raises(WiringError, match=r"--at: 0.005 s is not a multiple of 0.01 s"):
        linearise(file, at=0.005)
    late = {"components": {"hand": hand(), "wire": {"model": "delay", "parameters": {"delay": 0.004}}}}
    late |= {"connections": ["wire.late -> hand.torque"], "run": {"stop": 1, "step": 0.01}}
    with pytest.raises(IdentificationError, match=r"wire.delay: 'signal' acts late"):
        linearise(scenario(tmp_path, **late))
    linearise(scenario(tmp_path, **late), values={"wire.delay": 0.0})
    python = targets.build(library.find("pendulum"), tmp_path / "hand.fmu", target="python")
    with pytest.raises(IdentificationError, match=r"hand: has no Model Exchange .* ask its supplier"):
        linearise(python)
    braked = {"components": {"hand": hand()}, "connections": ["-0.01 * hand.speed -> hand.torque"]}
    with pytest.raises(InputError, match="is driven by nothing; leave an input open"):
        linearise(scenario(tmp_path, **braked, run={"stop": 1, "step": 0.01}))


def test_the_command_prints_modes_and_signals_and_writes_what_it_tells_with_json(tmp_path: Path) -> None:
    file, out = swinging(tmp_path), tmp_path / "out"
    told = servotwin("linearise", file, "--out", out, "--set", "hand.added_mass=0")
    assert told.exit_code == 0, told.output
    for part in ("frequency", "hand.torque", "hand.angle", "rad/s", "the start of the run", DIRECTIONAL):
        assert part in told.output
    answer = servotwin("linearise", file, "--out", out, "--json", "--at", "2")
    document = json.loads(answer.stdout)
    assert document == json.loads((out / "summary.json").read_text())
    assert document["time"] == 2
    assert [signal["unit"] for signal in document["outputs"]] == ["rad", "rad/s"]
    model = document["model"]
    assert np.array(model["matrices"]["a"]).shape == (2, 2)


def test_a_notebook_is_shown_modes(tmp_path: Path) -> None:
    found: Linearised = linearise(swinging(tmp_path))
    assert "order 2" in repr(found)
    assert "damping" in found._repr_html_()
