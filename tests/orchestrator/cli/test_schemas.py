"""JSON Schemas for editors: what the command prints is committed, fits every shipped file, and tells what is wrong."""

from __future__ import annotations

import copy
import json
import shutil
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from ruamel.yaml import YAML

from fmus.errors import ScenarioError
from identification.study import load_study
from orchestrator.batch.procedure import ProcedureBlock
from orchestrator.batch.sweep.points.schema import load_sweep
from orchestrator.cli.tables import SCHEMAS
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import load, load_joined
from tests.support.commands import servotwin

ROOT = Path(__file__).parents[3]
SHIPPED = sorted((ROOT / "scenarios").rglob("*.yaml"))
REFERENCE = "# yaml-language-server: $schema="
WRONG: list[tuple[str, tuple[str | int, ...], Any]] = [  # a file, a place in it, and what must not be there
    ("butterfly/sine.yaml", ("run", "step"), "often"),
    ("butterfly/sine.yaml", ("run", "step"), "1/3 s2"),
    ("butterfly/sine.yaml", ("run", "step"), [1]),
    ("butterfly/sine.yaml", ("run", "order"), "newton"),
    ("butterfly/sine.yaml", ("run", "stpo"), 1),
    ("butterfly/sine.yaml", ("title",), None),
    ("butterfly/bus/rig.yaml", ("can", "send"), {"signal": 3}),
    ("butterfly/bus/rig.yaml", ("can", "every"), {"Command": "now"}),
    ("butterfly/calibration.yaml", ("method",), "guess"),
    ("butterfly/calibration.yaml", ("windows", "length"), "long"),
    ("butterfly/calibration.yaml", ("weight",), "heavy"),
    ("flexible_link/subspace.yaml", ("windows",), {"length": 1}),
    ("flexible_link/subspace.yaml", ("block",), 1),
    ("butterfly/bus/procedure.yaml", ("procedure", 0, "run"), []),
    ("flexible_arm/control/pdpc.yaml", ("matrix", "axes", "payload"), []),
    ("butterfly/sweep.yaml", ("design", "by"), "chance"),
    ("butterfly/sweep.yaml", ("design", "samples"), 0),
    ("butterfly/sweep.yaml", ("vary", "hand.inertia", "mean"), 1),
    ("flexible_arm/control/pdpc.yaml", ("matrix", "also", 0, "were"), {"payload": "0 g"}),
]
RIGHT: list[tuple[str, tuple[str | int, ...], Any]] = [
    ("butterfly/sine.yaml", ("run", "step"), "1/500"),
    ("butterfly/sine.yaml", ("run", "step"), "2e-3"),
    ("butterfly/sine.yaml", ("run", "start"), 0),
    ("butterfly/bus/rig.yaml", ("can", "send"), {"a": "motor.torque", "b": {"source": "hand.angle", "safe": 0}}),
    ("butterfly/bus/rig.yaml", ("can", "every"), {"State": "1/200"}),
    ("butterfly/calibration.yaml", ("windows", "length"), "4"),
    ("butterfly/calibration.yaml", ("outputs", "hand.angle", "delay"), "1/500"),
    ("butterfly/calibration.yaml", ("outputs", "hand.angle", "delay"), 0.002),
    ("butterfly/sweep.yaml", ("design",), {"by": "latin-hypercube", "samples": 20, "seed": 1}),
    ("butterfly/sweep.yaml", ("vary", "hand.inertia"), ["3 g.m2", 0.0031]),
    ("butterfly/sine.yaml", ("matrix",), {"axes": {"drive.amplitude": [0.01, "20 mV"]}}),
]


def contents(file: Path) -> dict[str, Any]:
    document: dict[str, Any] = YAML(typ="safe", pure=True).load(file.read_text(encoding="utf-8"))
    return document


def committed(kind: str) -> Path:
    return ROOT / "scenarios" / "schema" / f"{kind}.json"


def kind_of(file: Path) -> str:
    """The kind that the first line of a file names."""
    first = file.read_text(encoding="utf-8").splitlines()[0]
    assert first.startswith(REFERENCE), f"{file}: begin it with {REFERENCE}"
    schema = (file.parent / first.removeprefix(REFERENCE)).resolve()
    assert schema in map(committed, SCHEMAS), f"{file}: {schema} is no schema"
    return schema.stem


@pytest.mark.parametrize("kind", SCHEMAS)
def test_no_key_is_left_unexplained(kind: str) -> None:
    document = json.loads(committed(kind).read_text())
    blocks = {kind: document, **document.get("$defs", {})}
    assert [
        f"{name}.{key}"
        for name, block in blocks.items()
        for key, said in block.get("properties", {}).items()
        if not said.get("description", "").strip()
    ] == []


def complaints(file: Path, document: Any) -> list[str]:
    validator = jsonschema.Draft202012Validator(json.loads(committed(kind_of(file)).read_text()))
    return [error.message for error in validator.iter_errors(document)]


def changed(name: str, place: tuple[str | int, ...], value: Any) -> tuple[Path, dict[str, Any]]:
    """A shipped file, and its contents with another value at a place."""
    file = ROOT / "scenarios" / name
    document = copy.deepcopy(contents(file))
    inner: Any = document
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    return file, document


def _write(document: dict[str, Any], shipped: Path, file: Path) -> None:
    """A changed copy of a shipped file, with the parts that it includes beside it."""
    parts = [shipped.parent / name for name in document.get("include", [])]
    for part in parts:
        shutil.copy(part, file.parent)
    file.write_text(json.dumps(document | ({"include": [part.name for part in parts]} if parts else {})))


def read(kind: str, file: Path) -> object:
    """The file as the commands read it."""
    if kind == "study":
        return load_study(file)
    if kind == "sweep":
        return load_sweep(file)
    return load_joined(file, ScenarioBlock) if kind == "scenario" else load(file, ProcedureBlock)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SCHEMAS)
def test_the_committed_schemas_are_what_the_command_prints(kind: str) -> None:
    """Where they are not: servotwin schema KIND --out scenarios/schema/KIND.json."""
    document = json.loads(committed(kind).read_text())
    jsonschema.Draft202012Validator.check_schema(document)
    assert json.loads(servotwin("schema", kind).stdout) == document
    assert json.loads(servotwin("schema", kind, "--json").stdout) == document


def test_a_schema_goes_into_a_file(tmp_path: Path) -> None:
    answer = servotwin("schema", "study", "--out", tmp_path / "new" / "study.json")
    assert answer.exit_code == 0, answer.stderr
    assert (tmp_path / "new" / "study.json").read_text() == committed("study").read_text()


def test_an_unknown_kind_is_refused_with_those_there_are() -> None:
    answer = servotwin("schema", "poem")
    assert answer.exit_code == 2 and "choose scenario or part or procedure or sweep or study or design" in answer.stderr


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: str(file.relative_to(ROOT / "scenarios")))
def test_every_shipped_file_names_its_schema_and_fits_it(file: Path) -> None:
    keys = contents(file).keys()
    marks = {"method": "study", "procedure": "procedure", "part": "part", "sweep": "sweep"}
    assert kind_of(file) == next((kind for mark, kind in marks.items() if mark in keys), "scenario")
    assert complaints(file, contents(file)) == []


@pytest.mark.parametrize(("name", "place", "value"), WRONG)
def test_what_is_wrong_is_so_for_the_editor_and_for_the_command(
    name: str, place: tuple[str | int, ...], value: Any, tmp_path: Path
) -> None:
    file, document = changed(name, place, value)
    assert complaints(file, document)
    _write(document, file, tmp_path / "wrong.yaml")
    with pytest.raises(ScenarioError):
        read(kind_of(file), tmp_path / "wrong.yaml")


@pytest.mark.parametrize(("name", "place", "value"), RIGHT)
def test_what_is_right_is_so_for_the_editor_and_for_the_command(
    name: str, place: tuple[str | int, ...], value: Any, tmp_path: Path
) -> None:
    file, document = changed(name, place, value)
    assert complaints(file, document) == []
    _write(document, file, tmp_path / "right.yaml")
    read(kind_of(file), tmp_path / "right.yaml")


def keys_of(document: dict[str, Any]) -> dict[tuple[str, str], str]:
    """(block, key) -> what the schema says of it."""
    blocks = {"file": document, **document.get("$defs", {})}
    return {
        (name, key): part.get("description", "")
        for name, block in blocks.items()
        for key, part in block.get("properties", {}).items()
    }


@pytest.mark.parametrize("kind", ["scenario", "procedure", "study", "sweep"])
def test_the_committed_page_has_every_key_and_is_what_the_command_prints(kind: str) -> None:
    """Where it is not: servotwin schema KIND --markdown --out docs/reference/KIND.md."""
    page = (ROOT / "docs" / "reference" / f"{kind}.md").read_text()
    assert servotwin("schema", kind, "--markdown").stdout == page
    for _, key in keys_of(json.loads(committed(kind).read_text())):
        assert f"| `{key}` |" in page
