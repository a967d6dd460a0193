"""Study files: what fits is read exactly, what does not is refused with file, line and key."""

from __future__ import annotations

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

from fmus.errors import ScenarioError, WiringError
from identification.output_error.schema import OutputErrorBlock
from identification.output_error.windows import cut_windows
from identification.recordings.campaign import FileField, load_campaign, trace_values
from identification.resonance.schema import ResonanceBlock
from identification.study import load_study
from orchestrator.fmi.interface import Port
from tests.support.identification.small_study import plain_study, record, study, write_study

STUDIES = Path(__file__).parents[2] / "scenarios" / "butterfly"


def loaded(path: Path) -> OutputErrorBlock:
    block = load_study(path).block
    assert isinstance(block, OutputErrorBlock)
    return block


def with_traces(**changes: Any) -> dict[str, Any]:
    merged = study()["traces"] | changes
    return {key: value for key, value in merged.items() if value is not None}


def line_of(path: Path, key: str) -> int:
    """Number of the first line that holds a key."""
    return next(n for n, line in enumerate(path.read_text().splitlines(), 1) if f'"{key}"' in line)


@pytest.mark.parametrize(
    ("changes", "key", "problem"),
    [
        ({"wieght": "none"}, "wieght", "unknown key; did you mean 'weight'?"),
        ({"windows": {"length": 1, "skipp": 2}}, "windows.skipp", "unknown key; did you mean 'skip'?"),
        ({"parameters": {"hand.inertia": {"strat": 1}}}, "parameters.hand.inertia.strat", "unknown key"),
        ({"traces": with_traces(scenario="a.yaml")}, "traces", "give either `files` or `scenario`"),
        ({"traces": with_traces(files=None, values={})}, "traces", "give either `files` or `scenario`"),
        (
            {"parameters": {"hand.inertia": {"tied": "motor.torque_gain", "min": 0.1}}},
            "parameters.hand.inertia",
            "a tied parameter has no start and no bounds",
        ),
        (
            {"traces": with_traces(file_name={"pattern": "rig_(?P<mass>["})},
            "traces.file_name",
            "`pattern` is no regular expression",
        ),
        (
            {"traces": with_traces(file_name={"pattern": r"(?P<m>\d+)", "fields": {"mass": {}}})},
            "traces.file_name",
            "`pattern` has no group mass",
        ),
        ({"traces": with_traces(values={"hand.added_mass": "weight"})}, "traces", "`file_name` has no field 'weight'"),
        ({"traces": with_traces(values={"hand.added_mass": "mass"}, file_name=None)}, "traces", "no field 'mass'"),
        ({"windows": {"length": 0}}, "windows", "`length` and `every` must be positive"),
        ({"windows": {"length": 1, "every": -1}}, "windows", "`length` and `every` must be positive"),
        ({"windows": {"length": 1, "skip": -1}}, "windows", "`skip` not negative"),
        ({"windows": {"length": 1, "most": 0}}, "windows.most", "greater than or equal to 1"),
        ({"windows": {"length": "soon"}}, "windows.length", "is no time"),
        ({"step": 0}, "", "`step` must be positive"),
        ({"step": -0.01}, "", "`step` must be positive"),
        ({"outputs": {}}, "outputs", "at least 1 item"),
        ({"parameters": {}}, "parameters", "at least 1 item"),
        ({"weight": "heavy"}, "weight", "'window', 'output' or 'none'"),
        ({"loss": {"kind": "l1"}}, "loss.kind", "'linear'"),
        ({"loss": {"scale": 0}}, "loss.scale", "greater than 0"),
        ({"options": {"starts": 0}}, "options.starts", "greater than or equal to 1"),
        ({"compare": {"old": {"hand.inertia": "big"}}}, "compare.old.hand.inertia", "valid number"),
        (
            {"initial": {"hand.speed_start": {"signal": "angle", "derivative": 2, "degree": 1}}},
            "initial.hand.speed_start",
            "a polynomial of degree 1 has no derivative 2 but 0",
        ),
        (
            {"initial": {"hand.added_mass": {"signal": "angle"}}},
            "",
            "hand.added_mass is given by `traces.values` and by another key; remove one",
        ),
        ({"title": None}, "title", "is missing; write `title: "),
        ({"connections": ["motor.torque = hand.torque"]}, "connections", "write source -> target"),
    ],
)
def test_what_does_not_fit_is_refused_with_file_line_and_key(
    tmp_path: Path, changes: dict[str, Any], key: str, problem: str
) -> None:
    path = write_study(tmp_path / "study.yaml", **changes)
    with pytest.raises(ScenarioError) as refused:
        load_study(path)
    text = str(refused.value)
    place, _, rest = text.partition(": ")
    file, _, line = place.rpartition(":")
    assert file == str(path) and line.isdigit()
    assert rest.startswith(key) and problem in text
    assert "\n" not in text


def test_the_line_is_that_of_the_key(tmp_path: Path) -> None:
    path = write_study(tmp_path / "study.yaml", windows={"length": 1, "skipp": 2})
    with pytest.raises(ScenarioError, match=f"study.yaml:{line_of(path, 'skipp')}: windows.skipp"):
        load_study(path)


def test_an_unknown_method_is_refused_with_those_there_are(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="method: 'guess' is unknown; use output-error or resonance"):
        load_study(write_study(tmp_path / "study.yaml", method="guess"))


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"none\.yaml: no such file"):
        load_study(tmp_path / "none.yaml")


def test_times_are_exact(tmp_path: Path) -> None:
    windows = {"length": 2.7, "every": "1/3", "skip": 0.1}
    block = loaded(write_study(tmp_path / "study.yaml", windows=windows, step=0.003))
    found = (block.windows.length, block.windows.every, block.windows.skip, block.step)
    assert found == (Fraction(27, 10), Fraction(1, 3), Fraction(1, 10), Fraction(3, 1000))


def test_the_real_study_is_read_as_it_is_written() -> None:
    block = loaded(STUDIES / "calibration.yaml")
    assert block.windows.length == 4 and block.step == Fraction(1, 500)
    assert set(block.parameters) >= {"motor.torque_gain", "hand.inertia", "hand.gravity_torque"}
    assert len(block.traces.hold_out) == 9
    assert block.traces.layout.layout(Path()).columns == {"voltage": 1, "angle": 2}
    assert block.compare["thesis, Table 5"]["hand.inertia"] == 0.0028
    assert block.validation is not None and block.validation.at_least == 0.94


def test_every_study_of_the_project_fits_its_schema() -> None:
    studies = [path for path in STUDIES.glob("*.yaml") if "\nmethod:" in path.read_text(encoding="utf-8")]
    assert {path.stem for path in studies} >= {"calibration", "thesis", "synthetic"}
    assert all(load_study(path).block.title for path in studies)


@pytest.mark.parametrize("changes", [{"hold_out": ["x"]}, {"values": {"hand.added_mass": "mass"}}])
def test_keys_that_mean_nothing_in_a_resonance_study_are_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    path = write_study(tmp_path / "study.yaml", **resonance(**changes))
    with pytest.raises(ScenarioError, match="mean nothing here"):
        load_study(path)


def resonance(write: str = "p1", **traces: Any) -> dict[str, Any]:
    """What makes a resonance study of the small one."""
    gone = ("step", "inputs", "outputs", "windows", "validation", "parameters", "truth")
    plain = {"hold_out": None, "values": None} | traces
    return dict.fromkeys(gone) | {
        "method": "resonance",
        "traces": with_traces(**plain),
        "campaign": {"signal": "angle", "added_mass": "mass", "added_length": 0.1, "amplitude": 1, "frequency": 2},
        "script": "recordings",
        "bounds": {"lower": [0, 0, 0], "upper": [1, 1, 1]},
        "write": {write: "hand.inertia"},
    }


def test_only_the_four_parameters_of_the_model_can_be_written(tmp_path: Path) -> None:
    assert isinstance(load_study(write_study(tmp_path / "study.yaml", **resonance())).block, ResonanceBlock)
    with pytest.raises(ScenarioError, match="'p1', 'p2', 'p3' or 'p4'"):
        load_study(write_study(tmp_path / "study.yaml", **resonance("p5")))


@pytest.mark.parametrize(
    ("text", "decimal", "factor", "number"),
    [
        ("120_5", "underscore", 0.001, 0.1205),
        ("52", "underscore", 0.001, 0.052),
        ("4_75", "underscore", 1.0, 4.75),
        ("0015", "after first digit", 1.0, 0.015),
        ("004", "after first digit", 1.0, 0.04),
        ("01", "after first digit", 1.0, 0.1),
        ("0003", "after first digit", 1.0, 0.003),
        ("0", "after first digit", 1.0, 0.0),
        ("154.5", "point", 0.001, 0.1545),
        ("-2", "point", 3.0, -6.0),
    ],
)
def test_digits_in_a_name_are_the_number_they_mean_to_the_last_bit(
    text: str, decimal: Any, factor: float, number: float
) -> None:
    assert FileField(decimal=decimal, factor=factor).number(text) == number


@pytest.mark.parametrize("text", ["", "heavy", "1.2.3", "nan", "inf", "1e999999", "1e99999999999999999999"])
@pytest.mark.parametrize("decimal", ["point", "underscore", "after first digit"])
def test_digits_that_are_no_number_are_none(text: str, decimal: Any) -> None:
    with pytest.raises(ValueError, match=r"is no number|is not finite"):
        FileField(decimal=decimal).number(text)


def test_numbers_may_have_units_of_their_own() -> None:
    parameters = {
        "motor.torque_gain": {"start": 6.0, "min": 0.5, "max": "50 N.m/V", "scale": "log"},
        "hand.inertia": {"min": "5000 g.mm2", "max": "200 g.m2"},
        "hand.equilibrium_angle": {"start": "90 deg", "min": "-0.5 turn", "max": 3.5},
        "wire": {"start": "2 ms", "min": 0, "max": "0.01 s"},
        "hand.viscous_friction": {"start": 0.002, "min": 0, "max": 1, "by": {"warm": ["w.csv"], "cold": ["c.csv"]}},
    }
    hand = {"model": "pendulum", "parameters": {"added_length": 0.1, "inertia": "400 g.cm2"}}
    found = plain_study(
        components=study()["components"] | {"hand": hand},
        inputs={"motor.voltage": {"signal": "voltage", "delay": "wire"}},
        parameters=parameters,
        compare={"other": {"hand.equilibrium_angle": "45 deg", "wire": "3 ms"}},
        truth={"hand.inertia": "4 kg.m2", "hand.viscous_friction@cold": "2 mN.m.s/rad"},
    )
    told = {one.name: (one.start, one.lower, one.upper) for one in found.parameters.parameters}
    assert told["motor.torque_gain"] == (6, 0.5, 50)
    assert told["hand.inertia"] == pytest.approx((4e-5, 5e-6, 0.2))
    assert told["hand.equilibrium_angle"] == pytest.approx((math.pi / 2, -math.pi, 3.5))
    assert told["wire"] == pytest.approx((0.002, 0, 0.01))
    assert found.run.estimated_delays[0].highest == pytest.approx(0.01)
    assert found.compare["other"] == pytest.approx({"hand.equilibrium_angle": math.pi / 4, "wire": 0.003})
    assert found.truth == pytest.approx({"hand.inertia": 4.0, "hand.viscous_friction@cold": 0.002})
    parameters["hand.inertia"]["max"] = "2 mm"
    with pytest.raises(WiringError, match=r"hand.inertia: mm does not fit kg.m2"):
        plain_study(inputs={"motor.voltage": {"signal": "voltage", "delay": "wire"}}, parameters=parameters)


def test_what_names_tell_in_a_unit_comes_in_that_of_the_variable(tmp_path: Path) -> None:
    name = {"pattern": r"rig_(?P<mass>\d+)__\w+", "fields": {"mass": {"unit": "g"}}}
    asked = plain_study(traces=with_traces(file_name=name))
    traces = load_campaign(asked.traces, record(tmp_path))
    assert [trace.fields["mass"] for trace in traces] == pytest.approx([0, 0.1, 0.05])
    for unit, factor in {"kg": 1, "t": 0.001}.items():
        port = Port("added_mass", 0, "Real", "parameter", unit=unit)
        windows = cut_windows(asked.run, traces, asked.windows, {"hand.added_mass": port})
        assert [one.constants["hand.added_mass"] for one in windows] == pytest.approx([0, 0.1 * factor, 0.05 * factor])
    with pytest.raises(ScenarioError, match="'gg' is no unit that is known; give a `factor` to SI"):
        loaded(
            write_study(tmp_path / "a.yaml", traces=with_traces(file_name=name | {"fields": {"mass": {"unit": "gg"}}}))
        )
    with pytest.raises(ScenarioError, match="give `factor` or `unit`"):
        both = {"mass": {"unit": "g", "factor": 1}}
        loaded(write_study(tmp_path / "b.yaml", traces=with_traces(file_name=name | {"fields": both})))


def test_a_field_that_a_trace_does_not_have_is_named(tmp_path: Path) -> None:
    traces = loaded(write_study(tmp_path / "study.yaml")).traces.values
    assert trace_values(traces, "rig", {"mass": 0.1}) == {"hand.added_mass": 0.1}
    with pytest.raises(ScenarioError, match=r"traces.values.hand.added_mass: trace rig has no field 'mass'"):
        trace_values(traces, "rig", {})
