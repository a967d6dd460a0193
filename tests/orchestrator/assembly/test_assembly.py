"""Systems of plain values: FMUs and models wired and run without a file."""

from __future__ import annotations

import pickle
from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus import library
from fmus.errors import FmuFileError, ModelError, TraceError, WiringError
from fmus.modelling.model import Table
from fmus.packaging import targets
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble, link, open_system
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace

WIRES = ["hand.speed -> motor.speed", "motor.torque -> hand.torque"]
FILE = """
title: two
components:
  motor: {model: dc_motor}
  hand: {model: pendulum, parameters: {viscous_friction: 0.002}}
connections: [hand.speed -> motor.speed, motor.torque -> hand.torque]
stimuli: {motor.voltage: {constant: 0.002}}
run: {stop: 0.5, step: 0.01}
"""


def torque(*values: float) -> Trace:
    return Trace(np.linspace(0.0, 1.0, len(values)), {"u": list(values)}, {"u": "N.m"}, "torques")


def test_two_components_run_without_a_file_as_they_do_with_one(tmp_path: Path) -> None:
    (tmp_path / "two.yaml").write_text(FILE)
    expected = run_scenario(tmp_path / "two.yaml").cases[0].result
    hand = ComponentSpec("pendulum", {"viscous_friction": 0.002})
    with open_system({"motor": "dc_motor", "hand": hand}, WIRES, ["motor.voltage"]) as system:
        found = system.run(0.5, 0.01, stimuli={"motor.voltage": 0.002})
    assert expected is not None and found.trace == expected.trace


@pytest.mark.parametrize("text", [True, False])
def test_a_file_a_model_and_a_name_are_the_same_component(tmp_path: Path, text: bool) -> None:
    model = library.find("pendulum")
    file = targets.build(model, tmp_path / "built.fmu")
    traces = []
    for source in ("pendulum", model, str(file) if text else file):
        with open_system({"hand": source}) as system:
            traces.append(system.run(0.1, "1/100", {"hand.angle_start": 0.3}, record=["hand.angle"]).trace)
    assert traces[0] == traces[1] == traces[2]
    assert traces[0]["hand.angle"][0] == 0.3


SIZED = """
title: A model of another size
components:
  plant:
    model: state_space
    parameters: {A: [[0.5, 0, 0], [1, 0, 0], [0, 1, 0]], B: [[1], [0], [0]], C: [[0, 0, CORNER]]}
stimuli: {plant.u: {constant: 1}}
run: {stop: 0.06, step: 0.01}
"""


def test_arrays_given_as_a_whole_give_a_model_of_any_size_its_own(tmp_path: Path) -> None:
    (tmp_path / "sized.yaml").write_text(SIZED.replace("CORNER", "2"))
    result = run_scenario(tmp_path / "sized.yaml").cases[0].result
    assert result is not None
    assert result.trace["plant.y"].tolist() == [0, 0, 0, 2, 3, 3.5, 3.75]


def test_arrays_of_a_model_that_do_not_fit_together_are_refused(tmp_path: Path) -> None:
    (tmp_path / "sized.yaml").write_text(SIZED.replace("CORNER", "2, 1"))
    with pytest.raises(WiringError, match=r"plant\.C: is given as 1 x 4 and is 1 x 3"):
        run_scenario(tmp_path / "sized.yaml")


def test_each_run_starts_afresh_with_its_own_values_and_stimuli() -> None:
    with open_system({"hand": "pendulum"}, stimulated=["hand.torque"]) as system:
        still = system.run(0.1, 0.01, stimuli={"hand.torque": 0.0})
        pushed = system.run(0.1, 0.01, {"hand.inertia": 0.1}, {"hand.torque": 1.0})
        again = system.run(0.1, 0.01, stimuli={"hand.torque": 0})
    assert again.trace == still.trace
    assert np.ptp(still.trace["hand.angle"]) == 0 < np.ptp(pushed.trace["hand.angle"])


def test_a_recording_drives_an_input_by_lines_or_by_steps() -> None:
    with open_system({"hand": "pendulum"}, stimulated=["hand.torque"]) as system:
        recorded = {
            hold: system.run(1, 0.1, stimuli={"hand.torque": Stimulus(torque(1.0, 3.0), hold)}, record=["hand.torque"])
            for hold in (False, True)
        }
    assert recorded[False].trace["hand.torque"] == pytest.approx(np.linspace(1.0, 3.0, 11))
    assert recorded[True].trace["hand.torque"].tolist() == [1.0] * 10 + [3.0]


def test_a_stimulus_has_one_signal_and_covers_the_run() -> None:
    with pytest.raises(TraceError, match=r"torques: drives an input with u, v; select one signal"):
        Stimulus(replace(torque(1.0, 2.0), signals={"u": [0.0, 1.0], "v": [0.0, 1.0]}))
    with open_system({"hand": "pendulum"}, stimulated=["hand.torque"]) as system:
        fix = "say `ends: hold` to keep its first and last value, or run from 0 to 1 s at most"
        with pytest.raises(WiringError, match=rf"stimuli\.hand\.torque: .* covers 0 to 1 s, not 0 to 2 s; {fix}"):
            system.run(2, 0.1, stimuli={"hand.torque": torque(1.0, 2.0)})
        with pytest.raises(WiringError, match=r"stimuli: \[\] given; give \['hand.torque'\]"):
            system.run(1, 0.1)


def test_a_stimulus_keeps_its_ends_when_it_is_told_to() -> None:
    early = torque(1.0, 3.0).shifted(0.25)
    stimulus = Stimulus(early, ends_held=True)
    with open_system({"hand": "pendulum"}, stimulated=["hand.torque"]) as system:
        driven = system.run(2, 0.5, stimuli={"hand.torque": stimulus}, record=["hand.torque"]).trace["hand.torque"]
    assert driven.tolist() == [1.0, 1.5, 2.5, 3.0, 3.0]
    assert stimulus.held(0, 2) == "keeps its first value until 0.25 s and its last value from 1.25 s on"
    assert stimulus.held(0.25, 1.25) == Stimulus(early).held(0, 2) == ""


@pytest.mark.slow
def test_what_is_assembled_has_plain_files_only_and_opens_in_another_process(tmp_path: Path) -> None:
    table = Table("playback", (0.0, 1.0), (2.0, 4.0))
    system = SystemSpec({"source": ComponentSpec(library.find("excitation"), tables=(table,))})
    assembled = assemble(system, tmp_path)
    assert (assembled.files, assembled.built) == ({"source": tmp_path / "source.fmu"}, frozenset({"source"}))
    with OpenSystem(pickle.loads(pickle.dumps(assembled))) as opened:
        assert opened.system.parts.keys() == {"source"}


def test_only_components_made_from_models_count_as_built(tmp_path: Path) -> None:
    file = targets.build("pendulum", tmp_path / "own.fmu")
    system = SystemSpec({"one": ComponentSpec(file), "other": ComponentSpec("pendulum", step=Fraction(1, 100))})
    assembled = assemble(system, tmp_path)
    assert assembled.built == {"other"} and assembled.files["one"] == file
    assert assembled.system.components["other"].step == Fraction(1, 100)


@pytest.mark.parametrize(
    ("components", "wires", "error", "problem"),
    [
        ({"hand": "pendulun"}, [], ModelError, "'pendulun': is not in the library"),
        ({"hand": Path("none.fmu")}, [], FmuFileError, "none.fmu"),
        ({"hand": "pendulum"}, ["hand.angle hand.torque"], WiringError, "is no connection; write source -> target"),
        ({"hand": "pendulum"}, ["hand.angel -> hand.torque"], WiringError, "did you mean 'angle'"),
    ],
)
def test_what_does_not_fit_is_refused_on_opening(
    components: dict[str, str | Path], wires: list[str], error: type[Exception], problem: str
) -> None:
    with pytest.raises(error, match=problem):
        open_system(components, wires)


def test_a_connection_is_read_as_source_and_target() -> None:
    assert link(" a.b->c.d ") == ("a.b", "c.d")
    for wrong in ("a.b", "a -> b -> c"):
        with pytest.raises(WiringError):
            link(wrong)
