"""What messages say to write at a key is what may stand there."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pkgutil import walk_packages

import pytest
from pydantic import TypeAdapter
from ruamel.yaml import YAML

import identification
import orchestrator
from orchestrator.documents.examples import example
from orchestrator.yaml_file import Block

UNTOLD = {"families", "sets", "pieces", "of", "plants"}  # whose values no example of their types fits


def blocks(base: type[Block] = Block) -> Iterator[type[Block]]:
    for block in base.__subclasses__():
        yield block
        yield from blocks(block)


def test_an_example_of_each_key_that_is_needed_is_taken_there() -> None:
    for package in (orchestrator, identification):
        for module in walk_packages(package.__path__, f"{package.__name__}."):
            if module.name.endswith(("schema", "blocks")):
                import_module(module.name)
    needed = [
        (field.alias or name, field.annotation)
        for block in set(blocks())
        for name, field in block.model_fields.items()
        if field.is_required() and block.__module__.startswith(("orchestrator", "identification"))
    ]
    assert len(needed) > 150
    for key, kind in needed:
        if key not in UNTOLD:
            value = YAML(typ="safe").load(example(key, kind))[key]
            TypeAdapter(kind).validate_python(value)


@pytest.mark.parametrize(
    ("key", "kind", "told"),
    [
        ("radius", float, "radius: 1.0"),
        ("names", list[str], "names: [...]"),
        ("gains", dict[str, float], "gains: {name: 1.0}"),
        ("bounds", tuple[float, float], "bounds: [1.0, 1.0]"),
        ("inputs", list[str], "inputs: [...]"),
        ("inputs", dict[str, dict[str, str]], "inputs: {motor.voltage: {signal: voltage}}"),
        ("count", int | None, "count: 1"),
    ],
)
def test_an_example_follows_from_the_name_of_a_key_or_from_its_type(key: str, kind: type, told: str) -> None:
    assert example(key, kind) == told
