"""YAML files checked against a schema; every complaint names file, line and key, and what would be right."""

from __future__ import annotations

import difflib
import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, StringConstraints, ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, NodeEvent, ScalarEvent
from ruamel.yaml.parser import RoundTripParser

from fmus.errors import FmuFileError, ScenarioError, ServotwinError, TraceError, WiringError
from fmus.files import absence
from orchestrator.rational import seconds

LARGEST = 4 << 20
LONGEST_NUMBER = 100  # digits
DEEPEST = 50  # lists and maps inside each other
_LONG_NUMBER = re.compile(r"[-+]?0?[xob]?[0-9a-fA-F_]+")
_DATE = re.compile(r"\d{4}-\d\d?-\d\d?")


# A key at the top that tells what a file is -> what that is, and the command that takes it.
KINDS = {"method": ("study", "calibrate"), "procedure": ("procedure", "test"), "run": ("scenario", "run")}


class Block(BaseModel):
    """A part of a file: unknown keys are refused, values do not change."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def exact(value: Any) -> Fraction:
    """A time of a file, for validators."""
    try:
        return seconds(value)
    except WiringError as error:
        raise ValueError(error.problem) from error


_TIME = r"^\s*[+-]?(\d+\s?/\s?\d+|(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)\s*$"
_Text = Annotated[str, StringConstraints(pattern=_TIME)]
Seconds = Annotated[Fraction, BeforeValidator(exact, json_schema_input_type=float | _Text)]
"""A time as files hold it [s]: a number, or text where a quotient is exact; 0.001, "1/300"."""

Quantity = Annotated[str, StringConstraints(pattern=r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?\s*[^\s0-9.].*$")]
"""A number with its unit, `90 deg`."""

B = TypeVar("B", bound=Block)
M = TypeVar("M", bound=Block)


def load(path: Path, schema: type[B]) -> B:
    """The file's contents as `schema`.

    Raises:
        ScenarioError: no such file, no YAML, or contents that do not fit.
    """
    return _checked(path, _parse(path), schema)


def load_as(path: Path, mark: type[M], choose: Callable[[M], type[B]]) -> B:
    """The file's contents as the schema that a part of them chooses.

    Args:
        mark: schema of that part.

    Raises:
        ScenarioError: as `load`, or what `choose` raises.
    """
    document = _parse(path)
    return _checked(path, document, choose(_checked(path, document, mark)))


def _checked(path: Path, document: Any, schema: type[B]) -> B:
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        raise _other_kind(path, document, schema) or _complaint(path, document, schema, error) from None


def _other_kind(path: Path, document: Any, schema: type[Block]) -> ScenarioError | None:
    """The complaint about a file that is sound, perhaps, but given to the wrong command."""
    mark = next((mark for mark in KINDS if mark in document), None)
    if mark is None or mark in schema.model_fields:
        return None
    kind, command = KINDS[mark]
    return ScenarioError(path, f"is a {kind}", f"give it to `servotwin {command}`")


def keys(path: Path) -> list[str]:
    """The keys at the top of a YAML file.

    Raises:
        ScenarioError: no such file, or no YAML.
    """
    return [str(key) for key in _parse(path)]


def contents(path: Path) -> Any:
    """The maps, lists and values of a YAML file, whatever they are.

    Raises:
        ScenarioError: no such file, or no YAML.
    """
    return _parse(path)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Errors about what a file asks for name the file; those about traces and FMUs name their own."""
    try:
        yield
    except (TraceError, FmuFileError):
        raise
    except ServotwinError as error:
        if error.place.startswith(str(path)):
            raise
        raise error.within(path) from error


def _parse(path: Path) -> Any:
    if not path.is_file():
        raise ScenarioError(path, absence(path), "check the path")
    if path.stat().st_size > LARGEST:
        raise ScenarioError(path, "is larger than 4 MiB", "move data into a trace file")
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        fix = "`servotwin info` tells what it is" if path.suffix not in (".yaml", ".yml") else "save it as UTF-8 text"
        raise ScenarioError(path, f"cannot be read ({error})", fix) from error
    try:
        yaml = YAML(pure=True)  # libyaml is faster, but does not keep the line of each key
        yaml.Parser = _CarefulParser
        document = yaml.load(text)
    except ScenarioError as error:
        raise ScenarioError(f"{path}{error.place}", error.problem, error.fix) from None
    except Exception as error:  # besides its own, the parser lets errors of int, datetime and the stack through
        mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
        place = f"{path}:{mark.line + 1}" if mark else str(path)
        problem = getattr(error, "problem", None) or str(error) or type(error).__name__
        raise ScenarioError(place, f"is not YAML ({_one_line(problem)})", "mend the line") from error
    if not isinstance(document, CommentedMap):
        raise ScenarioError(path, "holds no keys", "start with `title:`")
    return document


class _CarefulParser(RoundTripParser):
    """Refuses on the way what `_refuse_exotic` does; places lack the file."""

    depth = 0

    def get_event(self) -> Any:
        event = super().get_event()
        self.depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        _refuse_exotic(event, self.depth)
        return event


def _refuse_exotic(event: Any, depth: int) -> None:
    """Aliases and nesting can make a small file a long job, and tags name types that a scenario has no use for."""
    place = f":{event.start_mark.line + 1}"
    if depth > DEEPEST:
        raise ScenarioError(place, f"is nested more than {DEEPEST} levels deep", "flatten it")
    if isinstance(event, AliasEvent):
        raise ScenarioError(place, "uses a YAML alias (*name)", "write the values out")
    tag = getattr(event, "tag", None) if isinstance(event, NodeEvent) else None
    if tag is not None:
        raise ScenarioError(place, f"uses the YAML tag {_one_line(tag)}", "leave the tag out")
    if not isinstance(event, ScalarEvent) or event.style is not None:
        return
    if len(event.value) > LONGEST_NUMBER and _LONG_NUMBER.fullmatch(event.value):
        raise ScenarioError(place, f"holds a number of {len(event.value)} digits", "write a smaller one")
    if _DATE.match(event.value):
        raise ScenarioError(place, f"holds the date {_one_line(event.value)}", "put it in quotes")


def _one_line(text: object) -> str:
    return " ".join(str(text).split())[:200]


def _complaint(path: Path, document: Any, schema: type[Block], error: ValidationError) -> ScenarioError:
    """The one thing to mend first: an unknown key, since it often is a required one misspelt, else the first; of what
    may be one thing or another the place that lies deepest."""
    found = error.errors(include_url=False, include_context=False)
    places = [_keys_in_file(document, problem["loc"], problem["type"]) for problem in found]
    beside = [number for number, keys in enumerate(places) if keys[: len(places[0])] == places[0]]
    deepest = max(beside, key=lambda number: len(places[number]))
    number = next((n for n, problem in enumerate(found) if problem["type"] == "extra_forbidden"), deepest)
    first, keys = found[number], places[number]
    place = f"{path}:{_line(document, keys)}: {'.'.join(map(_one_line, keys))}"
    if first["type"] == "extra_forbidden":
        fields = _fields(schema, keys[:-1])
        known = list(fields)
        if below := [name for name, kind in fields.items() if _has(kind, keys[-1])]:
            return ScenarioError(place, "unknown key", f"it belongs under `{below[0]}`")
        near = difflib.get_close_matches(str(keys[-1]), known, n=1)
        return ScenarioError(
            place,
            "unknown key",
            f"did you mean '{near[0]}'?" if near else f"known are {', '.join(known)}" if known else "remove it",
        )
    message = _one_line(first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, "))
    return ScenarioError(place, message[:1].lower() + message[1:])


def _keys_in_file(document: Any, location: Sequence[Any], kind: str) -> list[Any]:
    """Of pydantic's location the keys that the file has, and a missing one; the rest are names of its types."""
    node, keys = document, []
    for key in location:
        if (isinstance(node, CommentedMap) and key in node) or (
            isinstance(node, CommentedSeq) and isinstance(key, int) and key < len(node)
        ):
            node = node[key]
            keys.append(key)
    return [*keys, location[-1]] if kind == "missing" else keys


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


def _fields(schema: type[Block], keys: list[Any]) -> dict[str, Any]:
    """Keys and types of the block that a path of keys leads to; none where the path leaves plain blocks."""
    block: Any = schema
    for key in keys:
        if isinstance(key, str) and _is_block(block) and key in block.model_fields:
            block = block.model_fields[key].annotation
        for inner in getattr(block, "__args__", ()):
            if _is_block(inner):
                block = inner
    return {name: field.annotation for name, field in block.model_fields.items()} if _is_block(block) else {}


def _has(kind: Any, key: Any) -> bool:
    """Whether a value of this type, or one that may be left out, is a block with that key."""
    blocks = kind.__args__ if isinstance(kind, UnionType) else (kind,)
    return any(_is_block(block) and key in block.model_fields for block in blocks)


def _is_block(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Block)
