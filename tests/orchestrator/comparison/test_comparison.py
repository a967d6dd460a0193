"""Two sides of any kind are held against each other; where they part first is found and told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus import build
from fmus.errors import TraceError, WiringError
from fmus.packaging import archive, targets
from orchestrator import formats
from orchestrator.comparison.comparison import Tolerance, compare_sides
from orchestrator.comparison.fmu_side import differences
from orchestrator.comparison.sides import WAYS, Side
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace
from tests.support.commands import servotwin

SWING = """
title: A swing
components:
  hand: {model: pendulum, parameters: {angle_start: 1.0}}
run: {stop: 0.5, step: 0.001}
record: [hand.angle, hand.speed]
cases:
  - {name: high}
  - {name: low, set: {hand.angle_start: 0.2}}
"""
TIME = np.linspace(0.0, 1.0, 101)


@pytest.fixture
def swing(tmp_path: Path) -> Path:
    file = tmp_path / "swing.yaml"
    file.write_text(SWING)
    return file


def compared(*arguments: object, code: int = 0) -> dict[str, Any]:
    answer = servotwin("compare", "--json", *map(str, arguments))
    assert answer.exit_code == code, answer.output
    return json.loads(answer.stdout) if code < 2 else {"said": answer.stderr}


def trace(unit: str = "rad", **signals: Any) -> Trace:
    return Trace(TIME, signals, dict.fromkeys(signals, unit), "trace")


def sides(one: Trace, other: Trace) -> tuple[Side, Side]:
    return Side("one", {"a": one}), Side("other", {"b": other})


@pytest.mark.parametrize(("unit", "other", "told"), [("rad", "", 1), ("", "rad", 1), ("1", "", 0), ("", "", 0)])
def test_a_unit_that_one_side_alone_has_is_told_with_what_is_assumed(unit: str, other: str, told: int) -> None:
    comparison = compare_sides(*sides(trace(unit, angle=TIME), trace(other, angle=TIME)), Tolerance())
    without = "other" if unit else "one"
    said = f"case a: angle has no unit of {without}, and is taken in rad as of {'one' if unit else 'other'}"
    assert comparison.agree and list(comparison.notes) == [said] * told


def test_the_signal_that_parts_first_is_named_with_its_time_and_by_what() -> None:
    late, early = np.where(TIME > 0.7, 1.0, 0.0), np.where(TIME > 0.3, 0.01, 0.0)
    zero = np.zeros(101)
    found = compare_sides(*sides(trace(x=zero, y=zero), trace(x=late, y=early)), Tolerance())
    assert found.first is not None and not found.agree
    case, first = found.first
    assert (case, first.signal) == ("a", "y") and first.first == pytest.approx(0.31) and first.by == 0.01
    assert found.largest[1].signal == "x"


def test_two_sides_on_which_nothing_moves_agree_with_a_word_about_it() -> None:
    still = trace(x=np.full(101, 2.0))
    for other, told in ((still, True), (trace(x=np.linspace(2.0, 2.0 + 1e-12, 101)), False)):
        found = compare_sides(*sides(still, other), Tolerance())
        assert found.agree and told == any("nothing moves on either side" in note for note in found.notes)


def test_sides_without_a_common_signal_are_told_what_there_is_and_how_to_pair_it() -> None:
    with pytest.raises(
        TraceError, match=r"^one: has no signal of other \(case a\): it holds x; there are phi; .*x=phi$"
    ):
        compare_sides(*sides(trace(x=TIME), trace(phi=TIME)), Tolerance())


def test_the_tolerance_is_the_larger_of_absolute_and_relative_or_the_signals_own_in_any_unit() -> None:
    one, other = trace(x=100 * TIME), trace(x=100 * TIME + 0.5)
    for tolerance, agree in (
        (Tolerance(0.4, 0), False),
        (Tolerance(0.6, 0), True),
        (Tolerance(0, 0.004), False),
        (Tolerance(0, 0.006), True),
        (Tolerance(9, 9, {"x": "0.4"}), False),
        (Tolerance(0, 0, {"x": "30 deg"}), True),
        (Tolerance(0, 0, {"x": "28 deg"}), False),
    ):
        assert compare_sides(*sides(one, other), tolerance).agree == agree


def test_signals_of_other_units_are_converted_and_what_one_alone_has_is_told() -> None:
    one, other = trace(x=TIME, z=TIME), trace("deg", x=np.degrees(TIME))
    found = compare_sides(*sides(one, other), Tolerance())
    assert found.agree and found.notes == ["case a: only one has z"] and len(found.crossings) == 1


@pytest.mark.parametrize(
    ("times", "told"),
    [
        ([0, 0.25, 0.5, 0.75, 1], ""),
        ([0, 0.25, 0.333, 0.5], "case a: compared at the 3 stamps of both; one has 51, other 4"),
        ([0, 0.333, 0.777], "case a: compared on lines between their stamps; one has 78, other 3"),
    ],
)
def test_stamps_that_are_of_one_side_alone_are_told(times: list[float], told: str) -> None:
    other = Trace(np.array(times), {"x": np.array(times)}, {"x": "rad"}, "trace")
    found = compare_sides(*sides(trace(x=TIME), other), Tolerance())
    assert found.agree and [note for note in found.notes if "stamps" in note] == ([told] if told else [])


def test_samples_without_a_number_on_either_side_are_told() -> None:
    gappy = np.where((TIME > 0.4) & (TIME < 0.445), np.nan, TIME)
    found = compare_sides(*sides(trace(x=gappy), trace(x=gappy)), Tolerance())
    assert found.agree and found.notes == ["case a: x has no number on either side at 4 stamps"]


def test_units_that_do_not_fit_are_refused_by_the_side_that_has_them() -> None:
    with pytest.raises(WiringError, match="other: x: m does not fit rad"):
        compare_sides(*sides(trace(x=TIME), trace("m", x=TIME)), Tolerance())


def test_the_packagings_and_the_loops_agree_and_are_what_they_say(swing: Path, tmp_path: Path) -> None:
    for pair in (("native", "python"), ("compiled", "python-loop"), ("half-step", swing)):
        assert compared(*pair, "--scenario", swing, "--case", "low", "--relative", 1e-6)["agree"]
    scenario = load_scenario(swing)
    made = WAYS["python"](scenario, tmp_path).system.components["hand"].fmu
    assert made is not None and any("pythonfmu" in name for name in archive.read(made))
    assert WAYS["half-step"](scenario, tmp_path).timing.step * 2 == scenario.timing.step


def test_a_result_a_recording_and_a_scenario_are_compared_with_each_other(swing: Path, tmp_path: Path) -> None:
    before = tmp_path / "before"
    assert servotwin("run", swing, "--out", before).exit_code == 0
    assert compared(before, swing)["agree"] and compared(before / "low.parquet", swing, "--case", "low")["agree"]
    swing.write_text(SWING.replace("0.2", "0.21"))
    found = compared(before, swing, "--out", tmp_path / "page", code=1)
    assert found["first"] == {
        "case": "low",
        "signal": "hand.angle",
        "time": 0.0,
        "by": pytest.approx(0.01),
        "unit": "rad",
        "tolerance": pytest.approx(2.1e-7, rel=0.01),
    }
    assert (tmp_path / "page" / "report.html").exists()
    assert compared(before, swing, "--case", "high")["agree"]


def test_two_versions_of_an_fmu_are_compared_in_the_place_of_a_component_and_alone(swing: Path, tmp_path: Path) -> None:
    old = build("pendulum", tmp_path / "old.fmu")
    new = build("pendulum", tmp_path / "new.fmu", parameters={"inertia": 3e-3, "angle_start": 0.5})
    found = compared(old, new, "--scenario", swing, code=1)
    assert found["first"]["signal"] == "hand.speed" and found["first"]["time"] == pytest.approx(0.001)
    assert any(line.startswith("inertia: start") for line in found["interface"])
    alone = compared(old, new, "--stop", 0.1, "--step", 0.01, code=1)
    assert alone["first"]["time"] == 0 and any("start values: torque" in line for line in alone["notes"])
    assert compared(old, old, "--scenario", swing, "--component", "hand")["agree"]
    assert differences(old, old) == []


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("native", "python"), "is a way to run a scenario; say which by --scenario FILE"),
        (("nothing.csv", "native"), "is neither there nor one of native, python"),
        (("{swing}", "{folder}"), "holds no manifest.json of a run"),
        (("{swing}", "{swing}", "--case", "middle"), "has no case 'middle'; its cases are high, low"),
        (("{swing}", "{swing}", "--within", "hand.angle=3 kg"), "kg does not fit rad"),
        (("{swing}", "{swing}", "--within", "hand.angle=x"), "is no number with a unit"),
        (("{swing}", "{swing}", "--within", "hand.angle=-1"), "is no distance"),
        (("{swing}", "{swing}", "--within", "hand.angles=1"), "is no signal of both"),
        (("{swing}", "{swing}", "--within", "hand.angle"), "has no value"),
        (("{recording}", "{swing}", "--case", "low"), "has no signal of"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_a_line(
    swing: Path, tmp_path: Path, arguments: tuple[str, ...], said: str
) -> None:
    recording = tmp_path / "recording.csv"
    formats.write(trace(other=TIME), recording)
    names = {"swing": swing, "folder": tmp_path, "recording": recording}
    answer = compared(*(text.format(**names) for text in arguments), code=2)
    assert said in answer["said"] and "Traceback" not in answer["said"]


def test_the_folders_of_two_suites_are_compared_scenario_by_scenario(swing: Path, tmp_path: Path) -> None:
    for suite, angle in (("before", "0.2"), ("after", "0.21")):
        swing.write_text(SWING.replace("0.2", angle))
        out = tmp_path / suite / "swings" / "swing"
        assert servotwin("run", swing, "--out", out).exit_code == 0
    found = compared(tmp_path / "before", tmp_path / "after", code=1)
    assert [case["name"] for case in found["cases"]] == ["swings/swing: high", "swings/swing: low"]
    assert found["first"]["case"] == "swings/swing: low"


def test_a_scenario_of_fmus_alone_has_nothing_to_be_packed(swing: Path, tmp_path: Path) -> None:
    build("pendulum", tmp_path / "hand.fmu")
    swing.write_text(SWING.replace("model: pendulum", "fmu: hand.fmu"))
    assert "has no model that could be packed" in compared("native", "python", "--scenario", swing, code=2)["said"]


def test_another_tools_recording_is_compared_under_its_own_names(swing: Path, tmp_path: Path) -> None:
    result = run_scenario(swing).cases[0].trace
    other = tmp_path / "other.csv"
    degrees = Trace(result.time, {"phi": np.degrees(result["hand.angle"])}, {"phi": "deg"}, "other")
    formats.write(degrees, other)
    arguments = (swing, other, "--case", "high")
    assert compared(*arguments, "--pair", "hand.angle=phi")["agree"]
    assert "has no signal 'psi'; it holds phi" in compared(*arguments, "--pair", "hand.angle=psi", code=2)["said"]


def test_a_folder_of_results_names_only_its_own_traces(tmp_path: Path, swing: Path) -> None:
    manifest = {"cases": [{"name": "a", "trace": "../secret.csv"}]}
    (tmp_path / "manifest.json").write_text(json.dumps(manifest))
    assert "is not in it" in compared(tmp_path, swing, code=2)["said"]


@pytest.mark.skipif(targets.preferred() != "native", reason="there is no C compiler for native FMUs")
def test_without_a_place_to_take_an_fmu_is_refused(swing: Path, tmp_path: Path) -> None:
    motor = build("dc_motor", tmp_path / "motor.fmu")
    assert "is a version of no component" in compared(motor, swing, "--scenario", swing, code=2)["said"]
