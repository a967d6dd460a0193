"""What may be written at a key of a file, by example, for messages about what is missing or of another form."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel

KNOWN = {
    "title": "A motor swings a pendulum",
    "method": "output-error",
    "components": "{motor: {model: dc_motor}}",
    "connections": "[motor.torque -> hand.torque]",
    "controller": "{model: pd}",
    "run": "{stop: 10, step: 0.001}",
    "stop": "10",
    "traces": '{files: "*.csv"}',
    "inputs": "{motor.voltage: {signal: voltage}}",
    "outputs": "{hand.angle: {signal: angle}}",
    "signal": "angle",
    "signals": "[motor.speed]",
    "name": "first",
    "file": "recording.csv",
    "scenario": "scenario.yaml",
    "database": "rig.dbc",
    "source": "motor.speed",
    "tolerance": "1.0e-6",
    "relative_tolerance": "1.0e-6",
    "step": "0.001",
    "length": "0.8",
    "windows": "{length: 0.8}",
}
"""Key -> a value of it, where that tells more than its type."""

BLOCKS = {"ComponentBlock": "{model: dc_motor}", "StimulusBlock": "{constant: 0.0}", "LayoutBlock": "{time: t}"}
"""The same of blocks that need no key more than another."""

PLAIN: dict[Any, str] = {bool: "true", int: "1", float: "1.0", Fraction: "0.001", str: "...", Path: "file.csv"}
DEEPEST = 3  # blocks inside each other that are spelled out


def example(key: object, kind: Any) -> str:
    """A line of YAML with a value of this type at the key."""
    value, known = _value(kind, 0), KNOWN.get(str(key), "")
    fits = known and get_origin(kind) is not Literal and _form(known) == _form(value)
    return f"{key}: {known if fits else value}"


def _form(value: str) -> tuple[str, bool]:
    """Whether YAML is a map, a list or neither, and whether it holds maps."""
    return value[:1] if value[:1] in "{[" else "", "{" in value[1:]


def _value(kind: Any, depth: int) -> str:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin in (Annotated, Union, UnionType):
        return _value(next(one for one in arguments if one is not NoneType), depth)
    if origin is Literal:
        return str(arguments[0])
    if origin is dict:
        key = "name" if arguments[0] is str else _value(arguments[0], depth)
        return f"{{{key}: {_value(arguments[1], depth)}}}"
    if origin in (list, tuple):
        return f"[{', '.join(_value(one, depth) for one in arguments if one is not Ellipsis)}]"
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        return _block(kind, depth + 1)
    return PLAIN.get(kind, "...")


def _block(kind: type[BaseModel], depth: int) -> str:
    """What a block needs."""
    fields = {name: field for name, field in kind.model_fields.items() if field.is_required()}
    if depth > DEEPEST or not fields:
        return BLOCKS.get(kind.__name__, "{...}")
    return f"{{{', '.join(example(field.alias or name, field.annotation) for name, field in fields.items())}}}"
