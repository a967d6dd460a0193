"""What an SSV file holds, read apart from the readers of ours."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree as ET

from fmus.parameters.ssv import SSV, Item, SetValue

_TYPES: dict[str, Callable[[str], SetValue]] = {
    "Real": float,
    "Integer": int,
    "Boolean": {"true": True, "false": False}.__getitem__,
    "Enumeration": Item,
    "String": str,
}


def read_values(path: Path) -> dict[str, SetValue]:
    """Name -> value of the parameters, in their types."""
    found = {}
    for parameter in ET.parse(path).getroot().iterfind(f"{{{SSV}}}Parameters/{{{SSV}}}Parameter"):
        [typed] = parameter
        found[parameter.attrib["name"]] = _TYPES[typed.tag.rpartition("}")[2]](typed.attrib["value"])
    return found
