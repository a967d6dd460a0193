"""YAML files checked against a schema; every complaint names file, line and key, and what would be right."""

from __future__ import annotations

import difflib
import io
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from functools import partial
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, ClassVar, Literal, TypeVar, Union, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    GetJsonSchemaHandler,
    StringConstraints,
    ValidationError,
)
from pydantic.json_schema import JsonSchemaValue
from pydantic_core import CoreSchema
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from fmus.errors import FmuFileError, ScenarioError, ServotwinError, TraceError, WiringError
from fmus.files import RawMap
from orchestrator.documents.docstrings import attributes, summary
from orchestrator.documents.examples import example
from orchestrator.documents.parsing import one_line, parse
from orchestrator.documents.parts import INCLUDE, PART, document_of, place_of
from orchestrator.documents.places import line_of
from orchestrator.documents.sources import plain
from orchestrator.rational import seconds
from orchestrator.ssp import is_ssp

# A key at the top that tells what a file is -> what that is, and the command that takes it.
KINDS = {
    "method": ("study", "calibrate"),
    "procedure": ("procedure", "test"),
    "sweep": ("sweep", "sweep"),
    "run": ("scenario", "run"),
}

# What pydantic misses -> that in words.
FORMS = {"model_type": "keys with values", "dict_type": "keys with values", "list_type": "a list"}

UNITS = "write a unit with its value, `20 mN.m`, and that of a recording's signal as `layout: {units: {angle: deg}}`"


class Block(BaseModel):
    """A part of a file: unknown keys are refused, values do not change.

    What its docstring says of attributes is what editors and the reference say of its keys; where it says nothing, what
    the classes of `explained_by` do, of attributes of the same name, or else the block that stands at the key.
    """

    explained_by: ClassVar[tuple[type, ...]] = ()

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """With what the docstring says of each key."""
        made = handler(core)
        schema = handler.resolve_ref_schema(made)
        schema["description"] = summary(cls)
        said = {name: text for kind in (*cls.explained_by, cls) for name, text in attributes(kind).items()}
        for name, field in cls.model_fields.items():
            if text := said.get(name) or _summary_of_block(field.annotation):
                schema["properties"][field.alias or name]["description"] = text
        return made


def _summary_of_block(annotation: Any) -> str:
    """What the docstring of the only block in a type says, "" where there is none or are several."""
    inner = (annotation, *get_args(annotation))
    blocks = {kind for kind in inner if isinstance(kind, type) and issubclass(kind, Block)}
    return summary(blocks.pop()) if len(blocks) == 1 else ""


def may_be_partial(schema: dict[str, Any]) -> None:
    """For editors: what a block needs may be said in another file that it is joined with."""
    del schema["required"]


def exact(value: Any) -> Fraction:
    """A time of a file, for validators."""
    try:
        return seconds(value)
    except WiringError as error:
        raise ValueError(f"{error.problem}; {error.fix}") from error


_TIME = r"^\s*[+-]?(\d+ ?/ ?\d+|(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?)( ?[a-zA-Zµμ]+)?\s*$"
_Text = Annotated[str, StringConstraints(pattern=_TIME), Field(examples=["10 ms", "1/300"])]
Seconds = Annotated[Fraction, BeforeValidator(exact, json_schema_input_type=float | _Text)]
"""A time as files hold it [s]: a number, or text with a unit or a quotient that is exact; 0.001, "1/300", "10 ms"."""
Time = Annotated[
    float,
    BeforeValidator(lambda value: float(exact(value)), json_schema_input_type=float | _Text),
    Field(allow_inf_nan=False),
]
"""The same where it need not be exact."""

_QUANTITY = r"^\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?(\s*[^\s0-9.]|\s+1\s*/).*$"
Quantity = Annotated[str, StringConstraints(pattern=_QUANTITY), Field(examples=["90 deg"])]
"""A number with its unit, `90 deg`."""


@dataclass(frozen=True)
class FileWithSuffix:
    """Marks a text that names a file where it ends so, and else something that is no file."""

    suffix: str


B = TypeVar("B", bound=Block)
M = TypeVar("M", bound=Block)


def load(path: Path, schema: type[B]) -> B:
    """The file's contents as `schema`.

    Raises:
        ScenarioError: no such file, no YAML, or contents that do not fit.
    """
    return _checked(path, parse(path), schema)


def load_joined(path: Path, schema: type[B]) -> tuple[B, tuple[Path, ...]]:
    """The contents of a file, joined with the parts that it includes, as `schema`; and the files of these parts.

    Raises:
        ScenarioError: as `load`, or a part cannot be included.
    """
    document, parts = document_of(path, partial(_named_files, schema))
    run = schema.model_fields.get("run")
    if is_ssp(path) and run is not None and run.is_required() and "run" not in document:
        fix = f"give it one, or run a scenario that says `include: [{path.name}]` and `run`"
        raise ScenarioError(path, "has no default experiment with a stop time", fix)
    return _checked(path, document, schema), parts


def joined(path: Path, schema: type[Block]) -> tuple[RawMap, list[tuple[Any, Any]]]:
    """The document of a file, joined with the parts that it includes, in plain maps and lists; and where it names
    files, pairs of a map or list in it and a key of that.

    Raises:
        ScenarioError: as `load_joined`.
    """
    document, _ = document_of(path, partial(_named_files, schema))
    made: RawMap = plain(document)
    return made, list(_named_files(schema, made))


def text_of(document: RawMap) -> bytes:
    """A document as YAML."""
    yaml, made = YAML(), io.BytesIO()
    yaml.width = 1 << 20  # no line of text is broken
    yaml.dump(document, made)
    return made.getvalue()


def load_as(path: Path, mark: type[M], choose: Callable[[M], type[B]]) -> B:
    """The file's contents, joined with the parts that it includes, as the schema that a key of the file chooses.

    Args:
        mark: schema of that part.

    Raises:
        ScenarioError: as `load`, or what `choose` raises.
    """
    document = parse(path)
    schema = choose(_checked(path, document, mark))
    return load_joined(path, schema)[0] if INCLUDE in document else _checked(path, document, schema)


def _checked(path: Path, document: Any, schema: type[B]) -> B:
    try:
        return schema.model_validate(document)
    except ValidationError as error:
        raise _other_kind(path, document, schema) or _complaint(path, document, schema, error) from None


def _other_kind(path: Path, document: Any, schema: type[Block]) -> ScenarioError | None:
    """The complaint about a file that is sound, perhaps, but given to the wrong command."""
    if PART in document:
        return ScenarioError(path, "is a part of scenarios", "name it under `include` of one")
    mark = next((mark for mark in KINDS if mark in document), None)
    if mark is None or mark in schema.model_fields:
        return None
    kind, command = KINDS[mark]
    return ScenarioError(path, f"is a {kind}", f"give it to `servotwin {command}`")


def keys(path: Path) -> list[str]:
    """The keys at the top of a YAML file, joined with the parts that it includes.

    Raises:
        ScenarioError: no such file, no YAML, or a part cannot be included.
    """
    return list(map(str, _read(path)))


def _read(path: Path) -> CommentedMap:
    """The document of a file, joined with its parts."""
    return document_of(path, lambda document: iter(()))[0]


def contents(path: Path) -> Any:
    """The maps, lists and values of a YAML file, whatever they are.

    Raises:
        ScenarioError: no such file, or no YAML.
    """
    return parse(path)


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Errors about what a file asks for name the file, and the line there or in its part; those about traces and FMUs
    name their own."""
    try:
        yield
    except (TraceError, FmuFileError):
        raise
    except ServotwinError as error:
        if error.place.startswith(str(path)):
            raise
        raise _placed(error, path) from error


def _placed(error: ServotwinError, path: Path) -> ServotwinError:
    if re.match(r"--set: |.*:\d+: ", error.place):  # it has a place of its own
        return error.within(path)
    try:
        stands = line_of(_read(path), path, error.place)
    except ServotwinError:
        stands = None  # another file is there by now
    if stands is None:
        return error.within(path)
    placed = error.within(f"{stands.file}:{stands.line}")
    return placed if stands.file == path else placed.within(path)


def _complaint(path: Path, document: Any, schema: type[Block], error: ValidationError) -> ScenarioError:
    """The one thing to mend first: an unknown key, since it often is a required one misspelt, else the first; of what
    may be one thing or another the place that lies deepest."""
    found = error.errors(include_url=False, include_context=False)
    places = [_keys_in_file(document, problem["loc"], problem["type"]) for problem in found]
    beside = [number for number, keys in enumerate(places) if keys[: len(places[0])] == places[0]]
    deepest = max(beside, key=lambda number: len(places[number]))
    number = next((n for n, problem in enumerate(found) if problem["type"] == "extra_forbidden"), deepest)
    first, keys = found[number], places[number]
    stands = place_of(document, path, keys)
    place = ": ".join([f"{stands.file}:{stands.line}", ".".join(map(one_line, keys))][: 1 + bool(keys)])
    if first["type"] == "extra_forbidden":
        return ScenarioError(place, "unknown key", _instead_of(schema, document, keys))
    if first["type"] == "missing":
        needed = _fields(schema, document, keys[:-1]).get(keys[-1])
        return ScenarioError(place, "is missing", f"write `{example(keys[-1], needed)}`")
    if first["type"] in FORMS and keys:
        kinds = [kind for block in _blocks(*_under(schema, document, keys[:-1])) for kind in _inner(block, keys[-1])]
        fix = f"such as `{one_line(example(keys[-1], kinds[0]))}`" if kinds else ""
        return ScenarioError(place, f"should be {FORMS[first['type']]}", fix)
    message = one_line(first["msg"].removeprefix("Value error, ").removeprefix("Assertion failed, "))
    return ScenarioError(place, message[:1].lower() + message[1:])


def _instead_of(schema: type[Block], document: Any, keys: Sequence[Any]) -> str:
    """What to do about an unknown key."""
    fields = _fields(schema, document, keys[:-1])
    known = [name for name in fields if name != keys[-1]]
    if below := [name for name, kind in fields.items() if _has(kind, keys[-1])]:
        return f"it belongs under `{below[0]}`"
    if above := [keys[at] for at in range(len(keys) - 1) if keys[-1] in _fields(schema, document, keys[:at])]:
        return f"it belongs beside `{above[-1]}`"
    near = difflib.get_close_matches(str(keys[-1]), known, n=1)
    if near:
        return f"did you mean '{near[0]}'?"
    if keys[-1] in ("unit", "units"):
        return UNITS
    return f"known are {', '.join(known)}" if known else "remove it"


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


def _fields(schema: type[Block], document: Any, keys: Sequence[Any]) -> dict[str, type[Any] | None]:
    """Keys and types of the block that a path of keys leads to; none where the path leaves plain blocks."""
    kinds, node = _under(schema, document, keys)
    return {name: kind for block in _blocks(kinds, node) for name, kind in _keys(block).items()}


def _under(schema: type[Block], document: Any, keys: Sequence[Any]) -> tuple[list[Any], Any]:
    """What a path of keys leads to: the types that it may have, and the value."""
    kinds, node = [schema], document
    for key in keys:
        kinds = [inner for block in _blocks(kinds, node) for inner in _inner(block, key)]
        node = node[key]
    return kinds, node


def _blocks(kinds: Iterable[Any], node: Any) -> list[Any]:
    """Of what a value may be the blocks, and maps and lists of them; of blocks that say of which kind they are, its."""
    options = [option for kind in kinds for option in _options(kind)]
    return [kind for kind in options if not _is_block(kind) or _may_be(kind, node)] or options


def _options(kind: Any) -> list[Any]:
    """What a value of this type is: one of a union's."""
    if get_origin(kind) is Annotated:
        return _options(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return [option for inner in get_args(kind) for option in _options(inner)]
    return [kind]


def _may_be(block: type[Block], node: Any) -> bool:
    """Whether a map has, of all keys that say of which kind it is, this block's values."""
    kinds = {name: get_args(kind) for name, kind in _keys(block).items() if get_origin(kind) is Literal}
    return isinstance(node, Mapping) and all(node.get(name) in kinds[name] for name in kinds if name in node)


def _inner(kind: Any, key: Any) -> list[Any]:
    """What is under a key of a map, a list or a block."""
    if _is_block(kind):
        return [_keys(kind)[key]] if key in _keys(kind) else []
    return list(get_args(kind)[-1:]) if get_origin(kind) else []


def _keys(block: Any) -> dict[str, type[Any] | None]:
    """Its keys and their types."""
    fields = block.model_fields.items() if _is_block(block) else ()
    return {field.alias or name: field.annotation for name, field in fields}


def _has(kind: Any, key: Any) -> bool:
    """Whether a value of this type, or one that may be left out, is a block with that key."""
    return any(key in _keys(option) for option in _options(kind))


def _is_block(kind: Any) -> bool:
    return isinstance(kind, type) and issubclass(kind, Block)


def _named_files(schema: type[Block], document: Any) -> Iterator[tuple[Any, Any]]:
    """The places of a document, pairs of a map or list and a key of it, that name files: paths, in the schema."""
    found = {(id(holder), key): (holder, key) for holder, key in _files_of(schema, {"": document}, "")}
    yield from found.values()


def _files_of(kind: Any, holder: Any, key: Any) -> Iterator[tuple[Any, Any]]:
    """Those of the value of a map or list under this key, which is of this type."""
    value, origin, arguments = holder[key], get_origin(kind), get_args(kind)
    if isinstance(value, str):
        suffixes = [mark.suffix for mark in arguments[1:] if isinstance(mark, FileWithSuffix)]
        if kind is Path or any(map(value.endswith, suffixes)):
            yield holder, key
    if origin in (Union, UnionType, Annotated):
        for argument in arguments:
            yield from _files_of(argument, holder, key)
    elif isinstance(value, Mapping) and _is_block(kind):
        for name, field in kind.model_fields.items():
            if (under := field.alias or name) in value:
                yield from _files_of(field.annotation, value, under)
    elif isinstance(value, Mapping) and origin is dict:
        for inner in value:
            yield from _files_of(arguments[1], value, inner)
    elif isinstance(value, list) and origin is list:
        for number in range(len(value)):
            yield from _files_of(arguments[0], value, number)
