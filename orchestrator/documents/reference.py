"""A page about every key that a kind of YAML file may have, in Markdown, from the JSON Schema of the kind."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

Schema = Mapping[str, Any]
_REFERENCE = "#/$defs/"
_VALUE = {"number", "true or false", "text"}
_WORD = re.compile(r"(?<=[a-z])(?=[A-Z])")


def page(document: Schema) -> str:
    """The page: a section for the file, and one for each block in it, in the order in which they are met."""
    title = str(document["title"]).removeprefix("servotwin ")
    lines = [f"# Keys of a {title} file", ""]
    if "properties" in document:
        lines += _section(document, document, document.get("then", {}).get("required", ()))
    for name in _met(document):
        lines += [f"## {_heading(name)}", "", *_section(document["$defs"][name], document, _needed(name, document))]
    return "\n".join(lines)


def _needed(name: str, document: Schema) -> list[str]:
    """Keys that a block needs where the file includes no parts that may have them."""
    unless_included = document.get("then", {}).get("properties", {})
    keys = [key for key in unless_included if name in _named(document["properties"][key])]
    return [needed for key in keys for needed in unless_included[key]["required"]]


def _met(document: Schema) -> list[str]:
    """Names of the definitions that have keys, in the order in which they are met."""
    found: dict[str, None] = {}
    left = list(_named(document.get("properties", {}))) + list(_named(document.get("oneOf", [])))
    while left:
        name = left.pop(0)
        if name not in found and name in document.get("$defs", {}):
            found[name] = None
            left += _named(document["$defs"][name].get("properties", {}))
    return [name for name in found if "properties" in document["$defs"][name]]


def _named(node: Any) -> Iterator[str]:
    """Names of the definitions that a part of a schema refers to."""
    if isinstance(node, Mapping):
        if "$ref" in node:
            yield str(node["$ref"]).removeprefix(_REFERENCE)
        for inner in node.values():
            yield from _named(inner)
    elif isinstance(node, list):
        for inner in node:
            yield from _named(inner)


def _section(schema: Schema, document: Schema, more_needed: Sequence[str]) -> list[str]:
    needed = {*schema.get("required", ()), *more_needed}
    lines = [*_sentence(schema), "| key | value | default | |", "|---|---|---|---|"]
    for key, part in schema["properties"].items():
        default = "**needed**" if key in needed else _default(part)
        lines.append(f"| `{key}` | {_cell(_kind(part, document))} | {default} | {_cell(part.get('description', ''))} |")
    return [*lines, ""]


def _sentence(schema: Schema) -> list[str]:
    text = schema.get("description", "")
    return [text, ""] if text else []


def _default(part: Schema) -> str:
    value = part.get("default")
    return "" if value in (None, "") or isinstance(value, dict | list) else _cell(f"`{json.dumps(value)}`")


def _kind(part: Schema, document: Schema) -> str:
    """What a value may be, in words."""
    if "$ref" in part:
        name = str(part["$ref"]).removeprefix(_REFERENCE)
        block = document["$defs"][name]
        linked = f"[{_heading(name)}](#{_heading(name).lower().replace(' ', '-')})"
        return linked if "properties" in block else _kind(block, document)
    for several in ("anyOf", "oneOf"):
        if several in part:
            kinds = list(dict.fromkeys(_kind(one, document) for one in part[several] if one.get("type") != "null"))
            if set(kinds) >= _VALUE:
                kinds = ["value", *(kind for kind in kinds if kind not in {*_VALUE, "whole number"})]
            return " or ".join(kinds)
    if "const" in part or "enum" in part:
        return " or ".join(f"`{one}`" for one in part.get("enum", [part.get("const")]))
    if part.get("type") == "array":
        return f"list of {_kind(part.get('items', {}), document)}"
    if part.get("type") == "object":
        inner = part.get("additionalProperties")
        return f"name → {_kind(inner, document)}" if isinstance(inner, Mapping) else "keys"
    return _plain(part)


def _plain(part: Schema) -> str:
    if part.get("type") == "string":
        examples = ", ".join(f"`{one}`" for one in part.get("examples", []))
        return "file" if part.get("format") == "path" else f"text ({examples})" if examples else "text"
    words = {"number": "number", "integer": "whole number", "boolean": "true or false"}
    return words.get(str(part.get("type")), "anything") + _range(part)


def _range(part: Schema) -> str:
    signs = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
    return "".join(f" {sign} {part[key]:g}" for key, sign in signs.items() if key in part)


def _heading(name: str) -> str:
    """The name of a block in words: `SignalFileBlock` is the signal file."""
    return _WORD.sub(" ", name.removesuffix("Block")).capitalize()


def _cell(text: str) -> str:
    return text.replace("|", "\\|").replace("\n", " ")
