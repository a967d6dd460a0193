"""What a class says of its attributes in its docstring: `name, other: text`, one entry after the other."""

from __future__ import annotations

import inspect
import re

_SECTION = re.compile(r"\n\n(Attributes|Raises|Args):\n")
_ENTRY = re.compile(r"^ {4}(\w[\w, ]*): ")


def summary(kind: type) -> str:
    """The docstring of a class without what it says of attributes."""
    return _SECTION.split(_text(kind))[0].strip()


def attributes(kind: type) -> dict[str, str]:
    """attribute -> what the docstring of a class says of it, on one line; that of its bases, too."""
    found: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        found |= _own_attributes(base)
    return found


def _own_attributes(kind: type) -> dict[str, str]:
    parts = _SECTION.split(_text(kind))
    sections = dict(zip(parts[1::2], parts[2::2], strict=True))
    found: dict[str, str] = {}
    names: list[str] = []
    for line in sections.get("Attributes", "").splitlines():
        if entry := _ENTRY.match(line):
            names = [name.strip() for name in entry[1].split(",")]
        text = line[entry.end() :] if entry else line
        found |= {name: f"{found.get(name, '')} {text.strip()}".strip() for name in names}
    return found


def _text(kind: type) -> str:
    return inspect.cleandoc(kind.__doc__ or "") if "__doc__" in vars(kind) else ""
