"""YAML from outside: whatever it holds, it fits its schema or is refused in one line with file, line, key and fix."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated, Literal

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from pydantic import BeforeValidator, Field
from ruamel.yaml import YAML

from fmus.errors import ScenarioError
from orchestrator.documents.parsing import LARGEST
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import Block, load

SCENARIO = Path(__file__).parents[2] / "scenarios" / "butterfly" / "sine.yaml"


class Wheel(Block):
    radius: float = Field(gt=0)
    spokes: int = 0


class Petrol(Block):
    by: Literal["petrol"]
    cylinders: int = 4


class Current(Block):
    by: Literal["current"]
    cells: int


def _of_radius(value: object) -> object:
    return {"radius": value} if isinstance(value, float) else value


class Car(Block):
    title: str
    wheels: dict[str, Wheel] = {}
    spare: Wheel | None = None
    names: list[str] = []
    notes: list[Wheel] = []
    lamp: int | str | Wheel | None = None
    values: dict[str, float | int | bool | str] = {}
    driven: Annotated[Petrol | Current, Field(discriminator="by")] | None = None
    rims: dict[str, Annotated[Wheel, BeforeValidator(_of_radius)]] = {}


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "car.yaml"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return path


def complaint(folder: Path, text: str | bytes) -> str:
    """The refusal without the file's name, which it must begin with."""
    path = write(folder, text)
    with pytest.raises(ScenarioError) as refused:
        load(path, Car)
    message = str(refused.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message.removeprefix(str(path))


def test_a_file_that_fits_is_its_contents(tmp_path: Path) -> None:
    text = """
        title: one
        wheels: {left: {radius: 1.5, spokes: 3}, Right: {radius: 2}}
        names: [a, "1"]
        values: {a: 1, b: 1.0, c: true, d: text, e: 1e-3, f: "2"}
    """
    car = load(write(tmp_path, text), Car)
    assert car.wheels == {"left": Wheel(radius=1.5, spokes=3), "Right": Wheel(radius=2)}
    assert car.values == {"a": 1, "b": 1.0, "c": True, "d": "text", "e": 1e-3, "f": "2"}
    assert isinstance(car.values["a"], int)
    assert car.values["c"] is True


BAD = [
    ("title: a\nradius: 1\n", ":2: radius: unknown key; it belongs under `spare`"),
    ("title: a\nspare: {radius: 1, names: [b]}\n", ":2: spare.names: unknown key; it belongs beside `spare`"),
    (
        "title: a\nwheels: {left: {radius: 1, spare: 2}}\n",
        ":2: wheels.left.spare: unknown key; it belongs beside `wheels`",
    ),
    ("title: a\nlamp: {radius: -1}\n", ":2: lamp.radius: input should be greater than 0"),
    ("titel: a\n", ":1: titel: unknown key; did you mean 'title'?"),
    ("title: a\nwheels:\n  left:\n    radios: 1\n", ":4: wheels.left.radios: unknown key; did you mean 'radius'?"),
    ("title: a\nwheels:\n  Left:\n    radios: 1\n", ":4: wheels.Left.radios: unknown key; did you mean 'radius'?"),
    ("title: a\nspare: {radius: 1, zzz: 2}\n", ":2: spare.zzz: unknown key; known are radius, spokes"),
    ("title: a\ndriven: {by: petrol, cells: 3}\n", ":2: driven.cells: unknown key; known are by, cylinders"),
    ("title: a\ndriven: {by: current, cels: 3}\n", ":2: driven.cels: unknown key; did you mean 'cells'?"),
    ("title: a\nrims: {left: {size: 3}}\n", ":2: rims.left.size: unknown key; known are radius, spokes"),
    ("title: a\nnotes:\n- {radius: 1}\n- {radius: 1, spoke: 1}\n", ":4: notes.1.spoke: unknown key; did you mean"),
    ("names: []\n", ":1: title: is missing; write `title: A motor swings a pendulum`"),
    ("title: a\nspare:\n  spokes: 3\n", ":2: spare.radius: is missing; write `radius: 1.0`"),
    ("title: a\nspare: {radius: 1, unit: m}\n", ":2: spare.unit: unknown key; write a unit with its value, `20 mN.m`"),
    ("title: a\nspare:\n  radius: -1\n", ":3: spare.radius: input should be greater than 0"),
    ("title: a\nspare: {radius: .nan}\n", ":2: spare.radius: input should be a finite number"),
    ("title: a\nspare: {radius: .inf}\n", ":2: spare.radius: input should be a finite number"),
    ("title: a\nvalues: {x: .nan}\n", ":2: values.x: input should be a finite number"),
    ("title: a\nvalues: {x: [1]}\n", ":2: values.x: input should be a valid number"),
    ("title: 3\n", ":1: title: input should be a valid string"),
    ("title: a\nnames: b\n", ":2: names: should be a list; such as `names: [...]`"),
    ("title: a\ntitle: b\n", ':2: is not YAML (found duplicate key "title" with value "b" '),
    ("title: a\n\tnames: []\n", ":2: is not YAML (found character '\\t' that cannot start any token); mend the line"),
    ("title: [a\n", ":2: is not YAML"),
    ("title: &a b\nnames: [*a]\n", ":2: uses a YAML alias (*name); write the values out"),
    ("title: !!python/object/apply:os.system [x]\n", ":1: uses the YAML tag tag:yaml.org,2002:python/object/"),
    ("title: !include /etc/hostname\n", ":1: uses the YAML tag !include"),
    ("names: !!set {a, b}\n", ":1: uses the YAML tag tag:yaml.org,2002:set"),
    ("title: a\nnames: [2024-05-01]\n", ":2: holds the date 2024-05-01; put it in quotes"),
    ("title: a\nnames: [2001-99-99]\n", ":2: holds the date 2001-99-99; put it in quotes"),
    ("title: " + "9" * 5000, ":1: holds a number of 5000 digits; write a smaller one"),
    ("title: 0x" + "f" * 5000, ":1: holds a number of 5002 digits; write a smaller one"),
    ("- a\n- b\n", ": holds no keys; start with `title:`"),
    ("", ": holds no keys; start with `title:`"),
    ("text\n", ": holds no keys; start with `title:`"),
    ("title: a\n---\ntitle: b\n", ":2: is not YAML"),
    ("title: a\x00\n", ": is not YAML"),
    (b"title: \xff\xfe\n", ": cannot be read"),
    ("title: " + "[" * 3000 + "]" * 3000, ":1: is nested more than 50 levels deep; flatten it"),
    ("title: " + "{a: " * 3000 + "1" + "}" * 3000, ":1: is nested more than 50 levels deep; flatten it"),
    ("title: " + "[" * 40 + "]" * 40, ":1: title: input should be a valid string"),
    ("? [a, b]\n: 1\n", ":1: title: is missing; write `title: A motor swings a pendulum`"),
    ("%YAML 9.9\n---\ntitle: a\n", ":1: is not YAML"),
]


@pytest.mark.parametrize(("text", "line"), BAD, ids=range(len(BAD)))
def test_what_does_not_fit_is_refused_with_line_key_and_fix(tmp_path: Path, text: str | bytes, line: str) -> None:
    message = complaint(tmp_path, text)
    assert message == line or (line in message and len(message) < 300)


def test_an_unknown_key_is_named_before_the_required_one_it_stands_for(tmp_path: Path) -> None:
    assert (
        complaint(tmp_path, "spare: {radus: 1}\ntitle: a\n") == ":1: spare.radus: unknown key; did you mean 'radius'?"
    )


def test_aliases_do_not_multiply(tmp_path: Path) -> None:
    lines = ["a0: &a0 [x, x, x, x, x, x, x, x, x]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 10)]
    assert "uses a YAML alias" in complaint(tmp_path, "\n".join(lines))


def test_missing_files_folders_and_huge_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match="no such file; check the path"):
        load(tmp_path / "missing.yaml", Car)
    with pytest.raises(ScenarioError, match="is a folder, not a file; check the path"):
        load(tmp_path, Car)
    assert "is larger than 4 MiB" in complaint(tmp_path, "title: " + "a" * LARGEST)


FUZZ = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def fits_or_is_refused(path: Path, schema: type[Block]) -> None:
    try:
        load(path, schema)
    except ScenarioError as error:
        assert str(error).startswith(str(path))
        assert "\n" not in str(error)


FRAGMENTS = st.sampled_from(
    [
        "\t",
        "  ",
        "\n",
        ": ",
        "- ",
        "[",
        "]",
        "{",
        "}",
        "*a",
        "&a ",
        "!!python/object:a ",
        "!!binary ",
        "<<: ",
        "? ",
        "|",
        ">",
        "'",
        '"',
        "#",
        "%",
        "@",
        "`",
        "\x85",
        "\u2028",
        "\ufeff",
        "😀",
        ".nan",
        ".inf",
        "1e999",
        "9" * 400,
        "0o9",
        "~",
        "2001-01-01",
        "12:30:45",
        "---\n",
        "...\n",
        "run:",
        "title:",
        "components:",
        "-> ",
        "true",
        "null",
    ]
)


@pytest.mark.slow
@FUZZ
@given(data=st.data())
def test_a_scenario_with_anything_inserted_fits_or_is_refused(tmp_path: Path, data: st.DataObject) -> None:
    text = SCENARIO.read_text()
    for _ in range(data.draw(st.integers(1, 5))):
        at, cut = data.draw(st.integers(0, len(text))), data.draw(st.integers(0, 10))
        text = text[:at] + data.draw(st.one_of(FRAGMENTS, st.text(max_size=5))) + text[at + cut :]
    fits_or_is_refused(write(tmp_path, text.encode(errors="surrogatepass")), ScenarioBlock)


@FUZZ
@given(st.binary(max_size=200))
@example(b"\xef\xbb\xbftitle: a")
@example(b"a: !!int x")
@example(b"a: 1_000:60:60")
def test_any_bytes_fit_or_are_refused(tmp_path: Path, content: bytes) -> None:
    fits_or_is_refused(write(tmp_path, content), ScenarioBlock)


LEAVES = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=8))
TREES = st.recursive(
    LEAVES, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3)
)
KEYS = st.sampled_from(["title", "components", "connections", "run", "record", "cases", "expect", "stimuli", "stopp"])


@pytest.mark.slow
@FUZZ
@given(st.dictionaries(KEYS, TREES, max_size=5))
def test_any_tree_of_values_fits_or_is_refused_with_a_line(tmp_path: Path, tree: dict[str, object]) -> None:
    yaml = YAML(typ="safe", pure=True)
    path = tmp_path / "tree.yaml"
    with path.open("w", encoding="utf-8") as file:
        yaml.dump(tree, file)
    try:
        load(path, ScenarioBlock)
    except ScenarioError as error:
        assert re.match(rf"{re.escape(str(path))}(:\d+)?: ", str(error))
        assert "\n" not in str(error)
