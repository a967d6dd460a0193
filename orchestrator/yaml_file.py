"""YAML files checked against a schema; every complaint names file, line and key, and what would be right."""

from __future__ import annotations

import difflib
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent

from fmus.errors import ScenarioError

LARGEST = 4 << 20


class Block(BaseModel):
    """A part of a file: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


B = TypeVar("B", bound=Block)


def load(path: Path, schema: type[B]) -> B:
    """The file's contents as `schema`.

    Raises:
        ScenarioError: no such file, no YAML, or contents that do not fit.
    """
    document = _parse(path)
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        raise _complaint(path, document, schema, error) from None


def _parse(path: Path) -> Any:
    if not path.is_file():
        raise ScenarioError(path, "no such file", "check the path")
    if path.stat().st_size > LARGEST:
        raise ScenarioError(path, "is larger than 4 MiB", "move data into a trace file")
    try:
        text = path.read_text(encoding="utf-8")
        if any(isinstance(event, AliasEvent) for event in YAML(pure=True).parse(text)):
            raise ScenarioError(path, "uses YAML aliases (*name)", "write the values out")
        document = YAML(pure=True).load(text)
    except (YAMLError, UnicodeDecodeError, RecursionError) as error:
        mark = getattr(error, "problem_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise ScenarioError(place, f"is not YAML ({problem})", "mend the line") from error
    if not isinstance(document, CommentedMap):
        raise ScenarioError(path, "holds no keys", "start with `title:`")
    return document


def _complaint(path: Path, document: Any, schema: type[Block], error: ValidationError) -> ScenarioError:
    first = error.errors(include_url=False)[0]
    keys = [key for key in first["loc"] if not (isinstance(key, str) and ("[" in key or key[:1].isupper()))]
    place = f"{path}:{_line(document, keys)}: {'.'.join(map(str, keys))}"
    if first["type"] == "extra_forbidden":
        known = _known_keys(schema, keys[:-1])
        near = difflib.get_close_matches(str(keys[-1]), known, n=1)
        return ScenarioError(place, "unknown key", f"did you mean '{near[0]}'?" if near
                             else f"known are {', '.join(known)}" if known else "remove it")  # fmt: skip
    message = first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, ")
    return ScenarioError(place, message[0].lower() + message[1:])


def _line(document: Any, keys: list[Any]) -> int:
    """Line (from 1) of the deepest of these keys that the file has."""
    node, line = document, 1
    for key in keys:
        if isinstance(node, CommentedMap) and key in node:
            line = node.lc.key(key)[0] + 1
        elif isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node):
            line = node.lc.item(key)[0] + 1
        else:
            break
        node = node[key]
    return line


def _known_keys(schema: type[Block], keys: list[Any]) -> list[str]:
    """Keys of the block that a path of keys leads to; none where the path leaves plain blocks."""
    block: Any = schema
    for key in keys:
        if isinstance(key, str) and isinstance(block, type) and issubclass(block, Block) and key in block.model_fields:
            block = block.model_fields[key].annotation
        for inner in getattr(block, "__args__", ()):
            if isinstance(inner, type) and issubclass(inner, Block):
                block = inner
    return list(block.model_fields) if isinstance(block, type) and issubclass(block, Block) else []
