"""Blocks of files as people are to write them, for commands that need no more of YAML than that."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping

_PLAIN = re.compile(r"[^\W\d](?:[\w/^*.() -]*[\w)])?")  # text that means itself without quotes
_WORDS = ("null", "true", "false", "yes", "no", "on", "off", "y", "n")  # but for these
_LONGEST_KEY = 1000  # longer ones have to be marked


def block(values: Mapping[str, object], indent: str = "") -> str:
    """Plain values in maps as YAML."""
    return "".join(_entry(_scalar(key), value, indent) for key, value in values.items())


def _entry(key: str, value: object, indent: str) -> str:
    lead = f"{indent}{key}:" if len(key) < _LONGEST_KEY else f"{indent}? {key}\n{indent}:"
    inner = isinstance(value, Mapping) and block(value, f"{indent}  ")
    return f"{lead}\n{inner}" if inner else f"{lead} {_scalar(value)}\n"


def _scalar(value: object) -> str:
    if not isinstance(value, str):
        return json.dumps(value)
    if _PLAIN.fullmatch(value) and value.lower() not in _WORDS:
        return value
    return '"' + "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08x}" for c in value) + '"'
