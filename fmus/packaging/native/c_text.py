"""Pieces of generated C that models and systems have alike: variables, arrays, functions, and `layout.h`."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence

from fmus.packaging.description.interface import Exposed
from fmus.packaging.native import c_code


def variable(exposed: Exposed, role: str, start: float, size: int) -> str:
    """The entry of a variable; `size` is how many values FMI 3.0 has behind its value reference."""
    name = c_code.string(exposed.name)
    return f"{{{name}, {exposed.type.upper()}, {role}, {c_code.literal(start)}, {size}}}"


def array(head: str, entries: Iterable[str]) -> str:
    """A definition, one entry a line."""
    return f"{head} = {{\n" + "".join(f"    {entry},\n" for entry in entries) + "};\n"


def function(head: str, lines: Sequence[str], arguments: Iterable[str]) -> str:
    """A definition; arguments that no line mentions are marked as unused."""
    text = re.sub('"[^"]*"', "", "\n".join(lines))  # words of messages use nothing
    silent = [f"(void){name};" for name in arguments if not re.search(rf"\b{name}\b", text)]
    body = "".join(f"    {line}\n" for line in [*silent, *lines])
    return f"{head}\n{{\n{body}}}\n"


def enumeration(values: Mapping[str, int]) -> list[str]:
    """The lines of numbers with names."""
    return ["enum {", *(f"    {name} = {value}," for name, value in values.items()), "};", ""]


def layout(head: str, name: str, token: str, defined: Iterable[str], numbers: Iterable[str]) -> str:
    """layout.h: the only file that has the token."""
    lines = [
        f"{head}#ifndef LAYOUT_H",
        "#define LAYOUT_H",
        "",
        f"#define MODEL_NAME {c_code.string(name)}",
        f"#define MODEL_TOKEN {c_code.string(token)}",
        *(f"#define {one}" for one in defined),
        "",
        *numbers,
        "#endif",
        "",
    ]
    return "\n".join(lines)
