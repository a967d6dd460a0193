"""A matrix is all combinations of its axes, each a case with a name; what fits nothing, or is too much, is refused."""

from __future__ import annotations

import json
import math
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import ScenarioError
from orchestrator.scenario.scenario import Case
from orchestrator.scenario.schema import combinations, load_scenario

AXES = {
    "set-point": {"1 V": {"set": {"hand.torque": 1}}, "3 V": {"set": {"hand.torque": 3}}},
    "payload": {
        "light": {"use": ["light"]},
        "heavy": {"use": ["light", "heavy"], "expect": [{"signal": "hand.angle", "below": 9}]},
    },
}
SETS = {"light": {"hand.inertia": 1, "hand.added_mass": 0}, "heavy": {"hand.inertia": "2 kg.m2"}}


def cases(folder: Path, made: dict[str, Any], **more: Any) -> list[Case]:
    document = {
        "title": "t",
        "components": {"hand": {"model": "pendulum"}},
        "run": {"stop": 1, "step": 0.1},
        "sets": SETS,
        "matrix": made,
        **more,
    }
    (folder / "matrix.yaml").write_text(json.dumps(document))
    return list(load_scenario(folder / "matrix.yaml").cases)


def refusal(folder: Path, made: dict[str, Any], **more: Any) -> str:
    with pytest.raises(ScenarioError) as refused:
        cases(folder, made, **more)
    return str(refused.value)


def test_every_combination_is_a_case_with_the_values_of_its_levels(tmp_path: Path) -> None:
    made = cases(tmp_path, {"axes": AXES})
    assert [case.name for case in made] == ["1 V, light", "1 V, heavy", "3 V, light", "3 V, heavy"]
    assert made[3].values == {"hand.torque": 3, "hand.inertia": "2 kg.m2", "hand.added_mass": 0}
    assert [len(case.expected) for case in made] == [0, 1, 0, 1]


def test_an_axis_may_be_a_variable_with_its_values(tmp_path: Path) -> None:
    made = cases(tmp_path, {"axes": {"hand.inertia": [1, "400 g.cm2"], "hand.added_mass": [0, 0.5]}})
    assert [case.name for case in made] == ["1, 0", "1, 0.5", "400 g.cm2, 0", "400 g.cm2, 0.5"]
    assert made[2].values == {"hand.inertia": "400 g.cm2", "hand.added_mass": 0}


def test_names_combinations_left_out_and_what_goes_for_some(tmp_path: Path) -> None:
    also = [
        {"where": {"payload": "heavy"}, "set": {"hand.torque": 5}},
        {"where": {"set-point": ["1 V", "3 V"]}, "expect": [{"signal": "hand.angle", "above": -9}]},
    ]
    exclude = [{"set-point": "3 V", "payload": "light"}]
    made = cases(
        tmp_path,
        {"name": "{set-point} ({payload})", "axes": AXES, "exclude": exclude, "also": also},
        cases=[{"name": "besides", "use": ["light"]}],
    )
    assert [case.name for case in made] == ["1 V (light)", "1 V (heavy)", "3 V (heavy)", "besides"]
    assert [case.values.get("hand.torque") for case in made] == [1, 5, 5, None]
    assert [len(case.expected) for case in made] == [1, 2, 2, 0]
    assert made[3].values["hand.inertia"] == 1


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"name": "{set-point}"}, "`name` lacks {payload}"),
        ({"name": "{set-point} {paylod}"}, "there is no axis 'paylod'; did you mean 'payload'?"),
        ({"exclude": [{"payload": "hevy"}]}, "there is no level of payload 'hevy'; did you mean 'heavy'?"),
        ({"exclude": [{"payload": ["light", "heavy"]}]}, "the matrix has no cases"),
        (
            {"exclude": [{"payload": "light"}], "also": [{"where": {"payload": "light"}, "set": {}}]},
            "no case of the matrix fits",
        ),
        ({"axes": AXES | {"more": {"a": {"set": {"hand.torque": 2}}}}}, "two axes of the matrix set hand.torque"),
        ({"axes": AXES | {"more": {"a": {"use": ["hevy"]}}}}, "there is no set 'hevy'; did you mean 'heavy'?"),
        ({"axes": {"payload": {}}}, "matrix.axes.payload"),
        ({"axis": {}}, "matrix.axis: unknown key; did you mean 'axes'?"),
    ],
)
def test_what_fits_nothing_is_refused(change: dict[str, Any], told: str, tmp_path: Path) -> None:
    assert told in refusal(tmp_path, {"axes": AXES} | change)


def test_two_cases_of_one_name_are_refused_with_it(tmp_path: Path) -> None:
    assert "two cases have one name, 1 V, light" in refusal(tmp_path, {"axes": AXES}, cases=[{"name": "1 V, light"}])


def test_a_matrix_of_a_million_cases_is_refused_with_the_count_before_it_is_made(tmp_path: Path) -> None:
    hundred = list(range(100))
    axes = {"hand.inertia": hundred, "hand.added_mass": hundred, "hand.torque": hundred}
    assert "the matrix has 1,000,000 cases (100 x 100 x 100), more than 10,000" in refusal(tmp_path, {"axes": axes})


@given(st.lists(st.integers(1, 4), min_size=1, max_size=4), st.data())
def test_what_is_excluded_is_gone_and_all_else_is_there_once(sizes: list[int], data: st.DataObject) -> None:
    axes = {f"a{n}": [f"l{level}" for level in range(size)] for n, size in enumerate(sizes)}
    every = [dict(zip(axes, levels, strict=True)) for levels in product(*axes.values())]
    gone = data.draw(st.lists(st.sampled_from(every), max_size=len(every) - 1))
    left = combinations.combinations(axes, [{axis: [level] for axis, level in one.items()} for one in gone])
    assert left == [one for one in every if one not in gone] and len(every) == math.prod(sizes)
