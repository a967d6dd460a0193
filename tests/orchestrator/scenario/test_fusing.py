"""A wired system as one FMU: the same trajectory to the last bit, in other tools too, and nothing fused by half."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from fmpy import read_model_description
from fmpy.fmi1 import FMICallException

from fmus.errors import FmuFileError, InputError, WiringError
from fmus.packaging import archive
from fmus.packaging.native import compiler
from fmus.packaging.system import manifest
from fmus.parameters.write_back import write_back
from orchestrator import formats
from orchestrator.assembly.assembly import OpenSystem, assemble, open_system
from orchestrator.engine import Run
from orchestrator.scenario.fusing import fuse
from orchestrator.scenario.schema import load_scenario
from orchestrator.ssp.tree import tree
from orchestrator.trace import Trace
from tests.support.commands import servotwin
from tests.support.fmus.either import opened
from tests.support.fmus.sanitized import harnessed
from tests.support.simulation.fused import Wired, fused, many_rates, stepped, wired
from tests.support.simulation.fused_contract import FusedContract, advance

pytestmark = [
    pytest.mark.slow,  # compilers
    pytest.mark.skipif(not compiler.available(), reason="no C compiler here"),
]
SCENARIOS = Path(__file__).parents[3] / "scenarios"
SHIPPED = {"butterfly/energy_control": 2.0, "flexible_arm/closed_loop": 1.0, "flexible_arm/control/payload": 1.0}


def assert_equal(path: Path, expected: Wired) -> None:
    found = stepped(path, expected)
    for number, (name, values) in enumerate(expected.outputs.items()):
        assert np.array_equal(found[:, number], values), name
        assert np.isfinite(values).all()


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("name", SHIPPED)
def test_a_shipped_system_moves_in_its_fmu_as_it_does_wired(tmp_path: Path, name: str, fmi: int) -> None:
    file = SCENARIOS / f"{name}.yaml"
    expected = wired(file, SHIPPED[name])
    assert any(np.ptp(values) > 0.1 for values in expected.outputs.values())
    assert_equal(fused(file, tmp_path, fmi), expected)


@pytest.mark.parametrize("order", ["gauss-seidel", "jacobi"])
def test_rates_delays_units_and_arrays_are_those_of_the_wired_system(tmp_path: Path, order: str) -> None:
    file = many_rates(tmp_path, ("{stop: 1.2, step: 0.002}", f"{{stop: 1.2, step: 0.002, order: {order}}}"))
    expected = wired(file, 1.2)
    assert expected.outputs["meter.warm"][-1] == pytest.approx(26.85 - 0.5)
    assert_equal(fused(file, tmp_path), expected)


@pytest.mark.parametrize("shape", ["held", "smooth"])
@pytest.mark.parametrize("order", ["gauss-seidel", "jacobi"])
def test_what_comes_later_does_so_in_the_fmu_too(tmp_path: Path, shape: str, order: str) -> None:
    late = f"  late: {{model: delay, step: 0.002, parameters: {{delay: 0.0131, shape: {shape}}}}}\nconnections:"
    file = many_rates(
        tmp_path,
        ("connections:", late),
        (
            "- controller.voltage -> drive.voltage",
            "- controller.voltage -> late.signal\n  - late.late -> drive.voltage",
        ),
        ("{stop: 1.2, step: 0.002}", f"{{stop: 1.2, step: 0.002, order: {order}}}"),
    )
    assert_equal(fused(file, tmp_path), wired(file, 1.2))


def test_a_run_that_begins_later_is_counted_from_there(tmp_path: Path) -> None:
    file = many_rates(tmp_path, ("{stop: 1.2, step: 0.002}", "{start: 1/3, stop: 1, step: 0.002}"))
    expected = wired(file, 0.5)
    assert expected.time[0] == 1 / 3
    assert_equal(fused(file, tmp_path), expected)


def test_a_part_of_a_system_in_one_fmu_acts_in_the_rest_without_a_delay(tmp_path: Path) -> None:
    """A controller, its drive and a filter, static or sampled, are one component: their outputs hold at once."""
    whole = many_rates(tmp_path)
    expected = wired(whole, 1.0)
    inner = tmp_path / "inner.yaml"
    inner.write_text(
        "title: Control\n"
        "components:\n"
        "  controller: {model: pd, parameters: {kp: 1.5, kd: 0.1, sample_time: 0.004}}\n"
        "  drive: {model: servo_drive}\n"
        "connections: [controller.voltage -> drive.voltage]\n"
        "stimuli: {controller.reference: {constant: 0}, controller.position: {constant: 0},"
        " controller.speed: {constant: 0}}\n"
        "run: {stop: 1, step: 0.002}\n"
    )
    path = fused(inner, tmp_path)
    changes = [
        ("  controller: {model: pd, step: 0.002, parameters: {kp: 1.5, kd: 0.1, sample_time: 0.004}}\n", ""),
        ("  drive: {model: servo_drive, step: 0.002}\n", f"  control: {{fmu: {path}, step: 0.002}}\n"),
        ("  - controller.voltage -> drive.voltage\n", ""),
        ("-> controller.reference", "-> control.controller.reference"),
        ("-> controller.position", "-> control.controller.position"),
        ("-> controller.speed", "-> control.controller.speed"),
        ("* drive.torque", "* control.drive.torque"),
    ]
    scenario = load_scenario(many_rates(tmp_path, *changes))
    with (
        OpenSystem(assemble(scenario.system, tmp_path, scenario.driven)) as system,
        system.simulation(replace(scenario.timing, stop=Fraction(1))) as simulation,
    ):
        driven = {"meter.warmth": np.full(len(simulation.instants()), 26.85)}
        trace = simulation.run(system.assembled.system.values(), driven).trace
    for name in ("hand.angle", "filter.y", "other.speed"):
        assert np.array_equal(trace[name], expected.outputs[name]), name
    assert np.array_equal(trace["control.drive.torque"], expected.outputs["drive.torque"])


def test_what_goes_wrong_in_a_part_is_told_with_its_name(tmp_path: Path) -> None:
    log = list[tuple[int, str, str]]()
    with opened(fused(SCENARIOS / "butterfly" / "energy_control.yaml", tmp_path), log=log) as fmu:
        fmu.start()
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.005)
        assert log[-1][2].startswith("energy_control: controller: start energy is that of the downward equilibrium")
        with pytest.raises(FMICallException):
            fmu.step(0.0, 0.005)
        assert "may not be called in failed mode" in log[-1][2]
        fmu.fmu.reset()
        fmu.start(**{"hand.angle_start": 0.5})
        fmu.step(0.0, 0.005)
        with pytest.raises(FMICallException):
            fmu.set("hand.inertia", 1.0)
        assert log[-1][2] == "energy_control: 'hand.inertia' is fixed once the initialisation is over"
        with pytest.raises(FMICallException):
            fmu.set("hand.angle", 1.0)
        assert log[-1][2] == "energy_control: 'hand.angle' is computed and cannot be set"


def test_an_output_that_is_not_finite_ends_a_run_unless_the_scenario_allows_it(tmp_path: Path) -> None:
    log = list[tuple[int, str, str]]()
    with opened(fused(many_rates(tmp_path), tmp_path), log=log) as fmu:
        fmu.start()
        fmu.step(0.0, 0.03)
        fmu.set("meter.warmth", np.inf)
        with pytest.raises(FMICallException):
            fmu.step(0.03, 0.03)
        assert log[-1][2] == "many_rates: 'meter.warm' is inf at t = 0.03 s"
    allowed = ("{stop: 1.2, step: 0.002}", "{stop: 1.2, step: 0.002, nonfinite: allow}")
    with opened(fused(many_rates(tmp_path, allowed), tmp_path)) as fmu:
        fmu.start(**{"meter.warmth": np.inf})
        fmu.step(0.0, 0.03)
        assert fmu.get("meter.warm") == [np.inf]


def test_a_step_of_many_base_steps_ends_where_single_ones_do_and_others_are_refused(tmp_path: Path) -> None:
    file = many_rates(tmp_path)
    expected = wired(file, 1.2)
    path, log = fused(file, tmp_path), list[tuple[int, str, str]]()
    found = stepped(path, expected, every=4)
    assert np.array_equal(found, np.column_stack([*expected.outputs.values()])[::4])
    with opened(path, log=log) as fmu:
        fmu.start()
        for time, duration, problem in (
            (0.0, 0.0015, "a step of 0.0015 s is no multiple of the system's base step of 0.001 s"),
            (0.5, 0.001, "cannot step from 0.5 s: it is at 0 s"),
        ):
            with pytest.raises(FMICallException):
                fmu.step(time, duration)
            assert problem in log[-1][2]
        for k in range(8):  # what was refused has moved nothing
            fmu.step(k * 0.001, 0.001)
        assert fmu.get(*expected.outputs) == found[1].tolist()


@pytest.mark.parametrize("fmi", [2, 3])
def test_the_base_step_is_known_so_that_no_run_begins_with_another(tmp_path: Path, fmi: int) -> None:
    path = fused(many_rates(tmp_path), tmp_path, fmi)
    declared = read_model_description(str(path)).coSimulation.fixedInternalStepSize
    assert fmi == 2 or float(declared) == 0.001
    with open_system({"f": path}) as system:
        with pytest.raises(WiringError, match=r"f\.step: 0\.0015 s is not a multiple of the FMU's own 0\.001 s"):
            system.run("0.3", "0.0015")
        assert len(system.run("0.3", "0.002").trace) == 151


class TestSystemOfModels(FusedContract):
    convention = "structured"

    @staticmethod
    def built(folder: Path, fmi: int) -> Path:
        return fused(many_rates(folder), folder, fmi)


def test_a_serialised_state_goes_to_another_instance_and_a_damaged_one_does_not(tmp_path: Path) -> None:
    path = fused(many_rates(tmp_path), tmp_path)
    with opened(path) as fmu, opened(path) as other:
        fmu.start(**FusedContract.MOVED)
        advance(fmu, 0, 50)
        state = fmu.save()
        kept, later = fmu.serialize(state), advance(fmu, 50, 200)
        other.start()
        moved = other.deserialize(kept)
        other.restore(moved)
        assert advance(other, 50, 200) == later
        with pytest.raises(FMICallException):
            other.deserialize(kept[:-9] + bytes([kept[-9] ^ 1]) + kept[-8:])
        fmu.drop(state)
        other.drop(moved)


def test_only_what_is_exposed_is_shown_and_the_rest_keeps_the_scenarios_values(tmp_path: Path) -> None:
    file = many_rates(tmp_path)
    path = fused(file, tmp_path, expose=["hand.*_start", "filter.A", "controller.k?"])
    with opened(path) as fmu:
        shown = [name for name, variable in fmu.variables.items() if variable.causality == "parameter"]
    assert shown == [
        "controller.kp",
        "controller.kd",
        *(f"filter.A[{row},{column}]" for row in (1, 2) for column in (1, 2)),
        "hand.angle_start",
        "hand.speed_start",
    ]
    assert_equal(path, wired(file, 0.3))


def test_that_cases_stay_behind_is_said_where_they_differ(tmp_path: Path) -> None:
    alone, behind = "hand: {model: pendulum, parameters: {inertia: 0.02}}", "that cases have of their own stay behind"
    file = tmp_path / "swing.yaml"
    file.write_text(f"title: swing\ncomponents: {{{alone}}}\nrun: {{stop: 1, step: 0.01}}\n")
    assert not any(behind in note for note in fuse(file).notes)
    with file.open("a") as more:
        more.write("cases:\n- {name: heavy, set: {hand.inertia: 0.03}}\n")
    assert any(behind in note for note in fuse(file).notes)


@pytest.mark.parametrize("fmi", [2, 3])
def test_values_are_written_back_into_parts_and_only_where_they_are_shown(tmp_path: Path, fmi: int) -> None:
    path = fused(many_rates(tmp_path), tmp_path, fmi, ["filter.A", "hand.angle_start"])
    values = {"filter.A[1,2]": 0.25, "hand.angle_start": -0.6}
    write_back(path, values, tmp_path / "new.fmu")
    with opened(path) as old, opened(tmp_path / "new.fmu") as new:
        old.start(**values)
        new.start()
        assert new.get(*values) == [*values.values()]
        for fmu in (old, new):
            fmu.step(0.0, 0.5)
        assert old.get("hand.angle", "filter.y") == new.get("hand.angle", "filter.y")
    with pytest.raises(FmuFileError, match=r"hand\.inertia: no such variable"):
        write_back(path, {"hand.inertia": 0.1}, tmp_path / "other.fmu")


def test_arrays_of_a_part_are_arrays_in_fmi_3(tmp_path: Path) -> None:
    path = fused(many_rates(tmp_path), tmp_path, fmi=3)
    with opened(path) as fmu:
        fmu.start(**{"filter.A[1,2]": 0.25})
        assert fmu.get("filter.A[1,1]", "filter.A[1,2]", "filter.A[2,1]") == [0.9, 0.25, -0.1]


REFUSED = [
    (("model: servo_drive", "model: servo_drives"), "is not in the library"),
    (("hand.angle -> filter.u", "hand.angl -> filter.u"), "did you mean 'angle'?"),
    (("run: {", "can: {database: a.dbc, frames: {}}\nrun: {"), "can"),
    (("run: {", "buses: {can0: {nodes: [a.x, b.x]}}\nrun: {"), "remove them, or hand on the scenario"),
    (("{model: servo_drive, step: 0.002}", "{fmu: drive.fmu}"), "drive.fmu: no such file"),
    (("source.signal ->", "controller.effort ->"), "runs in a circle"),
    (("step: 0.012,", "step: 0.012, solver: {method: cvode},"), "solvers cannot be inside an FMU"),
    (("angle_start: 12 deg", "angle_start: 12 s"), "angle_start"),
]


@pytest.mark.parametrize(("change", "problem"), REFUSED)
def test_what_cannot_be_fused_is_refused_and_nothing_written(
    tmp_path: Path, change: tuple[str, str], problem: str
) -> None:
    file = many_rates(tmp_path, change)
    done = servotwin("build", "--system", file, "--out", tmp_path / "out")
    assert done.exit_code == 2 and problem in done.stderr and done.stderr.count("\n") == 1, done.output
    assert not (tmp_path / "out").exists()


def test_circles_that_a_run_iterates_are_refused_by_name(tmp_path: Path) -> None:
    iterated = ("{stop: 1.2, step: 0.002}", "{stop: 1.2, step: 0.002, cycles: {}}")
    file = many_rates(tmp_path, ("source.signal ->", "controller.effort ->"), iterated)
    with pytest.raises(InputError, match="a circle through controller, which cannot be iterated in an FMU"):
        fuse(file)


def test_what_stays_behind_is_told(tmp_path: Path) -> None:
    assert fuse(many_rates(tmp_path)).notes == ()
    notes = fuse(SCENARIOS / "butterfly" / "energy_control.yaml").notes
    assert "values and components that cases have of their own stay behind" in notes
    assert any(note.startswith("motor.voltage is recorded in the scenario") for note in notes)
    recording = Trace(np.array([0.0, 2.0]), {"warmth": np.array([300.0, 310.0])}, {"warmth": "K"})
    formats.write(recording, tmp_path / "warmth.csv")
    played = ("{constant: 300 K}", "{file: warmth.csv, signal: warmth}")
    fused_one = fuse(many_rates(tmp_path, played))
    assert fused_one.notes == ("meter.warmth is an input: what drives it in the scenario stays behind",)
    assert fused_one.system.parts["meter"].values["warmth"] == pytest.approx(26.85)
    assert_equal(fused(many_rates(tmp_path, played), tmp_path), wired(many_rates(tmp_path, played), 1.0))


def test_options_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    file = str(many_rates(tmp_path))
    for arguments, problem in (
        (["pendulum", "--system", file], "--system: does not go with pendulum"),
        (["--system", file, "--target", "python"], "--system: does not go with --target python"),
        (["--system", file, "--from-sources"], "--system: does not go with --from-sources"),
        (["--system", file, "--fmi", "1"], "FMI 1 is not offered"),
        (["--expose", "hand.inertia"], "--expose: says what the FMU of a system shows"),
        (["--system", file, "--expose", "hand.inertai"], "did you mean 'hand.inertia'?"),
    ):
        done = servotwin("build", *arguments, "--out", tmp_path / "out")
        assert done.exit_code == 2 and problem in done.stderr, done.output
    assert not (tmp_path / "out").exists()


def test_the_tree_of_a_fused_fmu_shows_its_models_their_steps_and_the_wires(tmp_path: Path) -> None:
    path = fused(many_rates(tmp_path), tmp_path)
    lines = list(tree(path).lines())
    assert lines[0] == f"{path}: many_rates, FMI 2.0, base step 0.001 s"
    assert "  hand: pendulum, every 0.003 s, outputs hold from the end of its step" in lines
    assert "  drive: servo_drive, every 0.002 s, outputs hold at once" in lines
    assert "  hand.angle -> controller.position: 1.25 * value + 0.05" in lines
    assert "  controller.voltage -> drive.voltage" in lines


@pytest.mark.parametrize(
    "content",
    [
        b"{",
        b"[]",
        b'{"name": 1}',
        b'{"name":"a","title":"b","base_step":1e999}',
        b'{"name":"a","title":"b","base_step":0}',
    ],
)
def test_a_damaged_manifest_is_refused_by_name(tmp_path: Path, content: bytes) -> None:
    archive.write(tmp_path / "a.fmu", {manifest.NAME: content})
    with pytest.raises(FmuFileError, match=r"a\.fmu: extra/org\.servotwin/system\.json: is damaged"):
        tree(tmp_path / "a.fmu")


@pytest.mark.parametrize("fmi", [2, 3])
def test_declared_dependencies_are_the_ones_that_show_in_values(tmp_path: Path, fmi: int) -> None:
    """Whatever moves an output at the start, or within the step in which an input changes, is declared to do so."""
    path = fused(many_rates(tmp_path), tmp_path, fmi)
    described = read_model_description(str(path))
    initial = {u.variable.name: {d.name for d in u.dependencies} for u in described.initialUnknowns}
    with opened(path) as fmu:
        fmu.start()
        before = dict(zip(initial, fmu.get(*initial), strict=True))
        for name in ("hand.angle_start", "meter.warmth", "meter.zero", "filter.x_start[1]", "source.amplitude"):
            fmu.fmu.reset()
            fmu.start(**{name: 0.7})
            moved = {key for key, value in zip(initial, fmu.get(*initial), strict=True) if value != before[key]}
            known = name if fmi == 2 else name.partition("[")[0]
            assert moved or name == "source.amplitude"
            assert all(known in initial[key] for key in moved), name
    instant = {u.variable.name: {d.name for d in u.dependencies} for u in described.outputs}
    assert instant["meter.warm"] == {"meter.warmth"}
    assert not any(inputs for name, inputs in instant.items() if not name.startswith("meter."))


@pytest.mark.parametrize("fmi", [2, 3])
def test_no_call_leaves_memory_behind_or_its_bounds(tmp_path: Path, fmi: int) -> None:
    path = fused(many_rates(tmp_path), tmp_path, fmi, platforms=())
    assert harnessed(path, tmp_path / "unpacked", fmi) == (0, "")


@pytest.mark.parametrize("order", ["gauss-seidel", "jacobi"])
def test_tangents_pass_through_the_fmu_as_through_the_wires(tmp_path: Path, order: str) -> None:
    """Along parameters and start values of fast and slow parts, the sensitivities are those of the wired system."""
    file = many_rates(tmp_path, ("{stop: 1.2, step: 0.002}", f"{{stop: 1.2, step: 0.002, order: {order}}}"))
    scenario, system = load_scenario(file), fuse(file).system
    by = ["hand.inertia", "hand.angle_start", "controller.kp", "drive.torque_constant", "filter.A[1,2]", "meter.zero"]
    names = [name for name in system.outputs if name != "meter.seen"]  # which counts
    with (
        OpenSystem(assemble(scenario.system, tmp_path, scenario.driven)) as wires,
        open_system({"f": fused(file, tmp_path)}) as whole,
        wires.simulation(scenario.timing) as wired_one,
        whole.simulation(scenario.timing) as fused_one,
    ):
        driven = {"meter.warmth": np.full(len(wired_one.instants()), 26.85)}
        expected = wired_one.sensitivities(Run(wires.assembled.system.values(), driven, names), by)
        found = fused_one.sensitivities(Run({}, {}, [f"f.{name}" for name in names]), [f"f.{name}" for name in by])
    assert np.abs(expected.slopes).max(axis=(0, 1)).min() > 0
    assert found.slopes == pytest.approx(expected.slopes, rel=1e-12, abs=1e-12)
