"""Lists of parameters in CSV files: what they say, and at which line one is refused."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import InputError, ScenarioError
from orchestrator.scenario.parameter_list import read
from orchestrator.scenario.parameter_sets import values_of
from orchestrator.scenario.run import run_scenario

SCENARIO = """
title: A swing
components:
  hand: {model: pendulum, parameters: {angle_start: 0.5}}
parameters: list.csv
run: {stop: 0.2, step: 0.01}
record: [hand.angle]
"""


def written(folder: Path, text: str) -> Path:
    file = folder / "list.csv"
    file.write_text(text, encoding="utf-8")
    return file


def test_rows_have_values_units_and_bounds_in_any_order_of_columns(tmp_path: Path) -> None:
    text = "\ufeffUnit;name;max;value\n# a remark\n\nkg.cm2;hand.inertia;50;40\n;hand.gravity;;9.81\n1;hand.x;;2\n"
    one, other, plain = read(written(tmp_path, text))
    assert (one.name, one.value, one.low, one.high, one.unit) == ("hand.inertia", 40.0, None, 50.0, "kg.cm2")
    assert one.place.endswith("list.csv:4")
    assert [one.written(40.0), other.written(9.81)] == ["40.0 kg.cm2", 9.81]
    assert plain.unit == ""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "list.csv: is empty"),
        ("name\nhand.x\n", "list.csv:1: has no column 'value'"),
        (
            "name,value,lower\nhand.x,1,0\n",
            "list.csv:1: column 'lower' is unknown; there are name, value, unit, min, max",
        ),
        ("name,value,value\nhand.x,1,0\n", "list.csv:1: column 'value' stands twice"),
        ("name,value\nhand.x\n", "list.csv:2: has 1 cells for 2 columns"),
        ("name,value\n,1\n", "list.csv:2: has no name"),
        ("name,value\nhand.x,\n", "list.csv:2: value: is empty"),
        ("name;value\nhand.x;1,5\n", "list.csv:2: value: '1,5' is no number"),
        ("name,value\nhand.x,inf\n", "list.csv:2: value: 'inf' is no number"),
        ("name,value,min\nhand.x,1,nan\n", "list.csv:2: min: 'nan' is no number"),
        ("name,value,min,max\nhand.x,1,2,3\n", "list.csv:2: hand.x of 1 is outside of its bounds, 2 to 3"),
        ("name,value,unit\nhand.x,1,2 kg\n", "list.csv:2: unit: '2 kg' is no unit"),
        ("name,value\nhand.x,1\nhand.x,2\n", "list.csv:3: hand.x stands at .*list.csv:2, too"),
        ('name,value\n"hand.x,1\n', "list.csv: is no CSV file in UTF-8"),
    ],
)
def test_what_is_no_list_is_refused_at_its_line(tmp_path: Path, text: str, said: str) -> None:
    with pytest.raises(ScenarioError, match=said):
        read(written(tmp_path, text))


@pytest.mark.parametrize("content", [b"\xff\xfe\x00name", b"name,value\n\x00,1\n", b"\x80"])
def test_bytes_that_are_no_text_are_refused_in_a_line(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "list.csv").write_bytes(content)
    with pytest.raises(InputError):
        read(tmp_path / "list.csv")


@given(
    header=st.sampled_from([b"", b"name,value,unit\n"]),
    content=st.one_of(st.binary(max_size=60), st.text("nameval,;\t\n\"'#u.1e-\x00\x10é", max_size=60).map(str.encode)),
)
def test_whatever_stands_in_a_file_is_a_list_or_refused(
    tmp_path_factory: pytest.TempPathFactory, header: bytes, content: bytes
) -> None:
    file = tmp_path_factory.mktemp("any") / "list.csv"
    file.write_bytes(header + content)
    try:
        rows = read(file)
    except InputError as error:
        assert str(error).isprintable()
    else:
        assert len({row.name for row in rows}) == len(rows)


@given(value=st.floats(allow_nan=False, allow_infinity=False), unit=st.sampled_from(["", "kg", "N.m"]))
def test_a_number_comes_back_to_the_last_bit(tmp_path_factory: pytest.TempPathFactory, value: float, unit: str) -> None:
    [one] = read(written(tmp_path_factory.mktemp("list"), f"name,value,unit\na.b,{value!r},{unit}\n"))
    assert (one.value, one.unit) == (value, unit)


def test_a_list_gives_a_scenario_its_values_in_their_units(tmp_path: Path) -> None:
    written(tmp_path, "name,value,unit\nhand.angle_start,40,deg\n")
    (tmp_path / "swing.yaml").write_text(SCENARIO)
    [case] = run_scenario(tmp_path / "swing.yaml").cases
    assert case.trace["hand.angle"][0] == pytest.approx(0.6981317007977318)


def test_a_value_of_no_component_is_refused(tmp_path: Path) -> None:
    file = written(tmp_path, "name,value\nhnd.x,1\n")
    with pytest.raises(InputError, match=r"list\.csv:2: hnd\.x: no component 'hnd'; did you mean 'hand'\?"):
        values_of([file], ["hand"])
