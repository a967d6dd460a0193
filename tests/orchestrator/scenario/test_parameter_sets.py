"""Parameter sets give a scenario its values, below what its cases and the command line set."""

from __future__ import annotations

from pathlib import Path

import pytest

from fmus.errors import FmuFileError, InputError, ServotwinError
from fmus.files import sha256
from fmus.parameters.ssv import parameter_set
from orchestrator.scenario.results import document_of
from orchestrator.scenario.run import ScenarioResult, run_scenario

SCENARIO = """
title: A swing
components:
  hand: {model: pendulum, parameters: {angle_start: 0.5, added_mass: 0.1}}
  model: {model: state_space, parameters: {A: [[0, 1], [-4, 0]], B: [[0], [1]], C: [[1, 0]]}}
parameters: PARAMETERS
run: {stop: 0.2, step: 0.01}
record: [hand.angle, hand.added_length, model.x_1]
cases:
  - {name: as given}
  - {name: set, set: {hand.added_length: 0.3}}
"""
VALUES = {"hand.added_length": 10.4, "hand.angle_start": 40.0}
UNITS = {"hand.added_length": "cm", "hand.angle_start": "deg"}


def ran(folder: Path, parameters: str = "set.ssv", **overrides: float) -> ScenarioResult:
    (folder / "set.ssv").write_bytes(parameter_set("calibrated", VALUES, UNITS))
    (folder / "later.ssv").write_bytes(parameter_set("later", {"hand.angle_start": 0.25, "model.x_start[1]": 2.0}))
    (folder / "swing.yaml").write_text(SCENARIO.replace("PARAMETERS", parameters))
    return run_scenario(folder / "swing.yaml", {name.replace("__", "."): one for name, one in overrides.items()})


def test_a_set_gives_values_in_its_own_units_over_those_of_components(tmp_path: Path) -> None:
    first, second = ran(tmp_path).cases
    assert first.trace["hand.angle"][0] == pytest.approx(0.6981317007977318)
    assert first.trace["hand.added_length"][0] == pytest.approx(0.104)
    assert second.trace["hand.added_length"][0] == 0.3
    assert ran(tmp_path, hand__angle_start=0.1).cases[0].trace["hand.angle"][0] == 0.1


def test_of_several_sets_the_later_one_counts(tmp_path: Path) -> None:
    trace = ran(tmp_path, "[set.ssv, later.ssv]").cases[0].trace
    assert (trace["hand.angle"][0], trace["model.x_1"][0]) == (0.25, 2.0)
    assert trace["hand.added_length"][0] == pytest.approx(0.104)


def test_the_manifest_names_the_sets_by_their_hashes(tmp_path: Path) -> None:
    document = document_of(ran(tmp_path), {}, tmp_path)
    digest = sha256(tmp_path / "set.ssv")
    assert document["recordings"] == [{"read_for": "parameters", "file": "set.ssv", "sha256": digest}]


def test_a_value_that_does_not_fit_is_named_by_where_it_stands_and_no_other_place_of_it_is(tmp_path: Path) -> None:
    """A list, sets of the scenario, the command line; what a case sets over a set is the case's."""
    (tmp_path / "list.csv").write_text("name,value\nhand.angle_start,1\nhand.added_mass,-1\n")
    with pytest.raises(
        InputError, match=r"swing\.yaml: .*list\.csv:3: case as given: hand\.added_mass: is -1, outside its bounds"
    ):
        ran(tmp_path, "list.csv")
    with pytest.raises(
        InputError, match=r"swing\.yaml: --set: case as given: hand\.added_mass: is -2, outside its bounds"
    ):
        ran(tmp_path, "list.csv", hand__added_mass=-2)
    sets = SCENARIO + "sets:\n  heavy: {hand.added_mass: -3}\n"
    for case, line in (("{name: a, use: [heavy]}", 13), ("{name: a, set: {hand.added_mass: -3}}", 10)):
        (tmp_path / "swing.yaml").write_text(sets.replace("{name: as given}", case).replace("PARAMETERS", "list.csv"))
        (tmp_path / "list.csv").write_text("name,value\nhand.added_length,1\n")
        with pytest.raises(
            InputError, match=rf"swing\.yaml:{line}: case a: hand\.added_mass: is -3, outside its bounds"
        ):
            run_scenario(tmp_path / "swing.yaml")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, "other.ssv: no such file"),
        (b"<a/>", "is not an SSV parameter set"),
        (b"nothing", "is not XML"),
        (parameter_set("s", {"hnd.added_mass": 1.0}), "other.ssv:4: hnd.added_mass: no component 'hnd'; did you mean"),
        (parameter_set("s", {"added_mass": 1.0}), "no component 'added_mass'"),
        (
            parameter_set("s", {"hand.added_mas": 1.0}),
            "other.ssv:4: case as given: hand.added_mas: no variable 'added_mas'",
        ),
        (
            parameter_set("s", {"hand.added_mass": 1.0}, {"hand.added_mass": "m"}),
            "other.ssv:4: case as given: hand.added_mass: m does not fit kg",
        ),
        (
            parameter_set("s", {"hand.added_mass": -1.0}),
            "other.ssv:4: case as given: hand.added_mass: is -1, outside its bounds",
        ),
        (parameter_set("s", {"hand.added_mass": float("nan")}), "'nan' is no Real"),
        (parameter_set("s", {}, {}).replace(b"</ssv:ParameterSet>", b""), "is not XML"),
    ],
)
def test_a_set_that_does_not_fit_is_refused_by_its_name(tmp_path: Path, content: bytes | None, problem: str) -> None:
    if content is not None:
        (tmp_path / "other.ssv").write_bytes(content)
    with pytest.raises(ServotwinError) as refused:
        ran(tmp_path, "other.ssv")
    assert problem in str(refused.value) and isinstance(refused.value, InputError)


def test_a_unit_that_a_set_defines_otherwise_than_usual_is_refused(tmp_path: Path) -> None:
    text = parameter_set("s", {"hand.added_mass": 1.0}, {"hand.added_mass": "kg"})
    (tmp_path / "odd.ssv").write_bytes(text.replace(b'kg="1"', b'kg="1" factor="0.5"'))
    with pytest.raises(FmuFileError, match="unit kg: is another one than is usual by this name"):
        ran(tmp_path, "odd.ssv")
