"""What is inside a system's FMU, as the file that travels in it: extra/org.servotwin/system.json."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import Any

from fmus.errors import FmuFileError
from fmus.json_document import json_text
from fmus.packaging.system import nested
from fmus.packaging.system.fused import FusedSystem, Wire

NAME = "extra/org.servotwin/system.json"


@dataclass(frozen=True)
class ListedPart:
    """A part: its model, its communication step [s], and when its outputs hold, in words.

    Attributes:
        folder: where it lies unpacked in the FMU of the system, where it is an FMU; else "".
    """

    name: str
    model: str
    description: str
    step: float
    outputs_hold: str
    folder: str = ""


@dataclass(frozen=True)
class SystemManifest:
    """The parts of a system in the order in which they are stepped, and the wires between them.

    Attributes:
        base_step: of which all steps are multiples [s].
    """

    name: str
    title: str
    base_step: float
    parts: tuple[ListedPart, ...]
    wires: tuple[Wire, ...]


def written(system: FusedSystem) -> bytes:
    """The file of a system."""
    folders = nested.folders(system.nested)
    parts = tuple(
        ListedPart(
            name,
            part.title,
            part.description,
            float(part.every * system.base),
            "at once" if part.instant else "from the end of its step",
            f"resources/{folders[name]}/" if name in folders else "",
        )
        for name, part in system.parts.items()
    )
    document = SystemManifest(system.name, system.description, float(system.base), parts, system.wires)
    return json_text(document, ascii_alone=False).encode()


def read(place: str, content: bytes) -> SystemManifest:
    """What such a file says; `place` is named where it is none.

    Raises:
        FmuFileError: it is damaged.
    """
    try:
        found = json.loads(content)
        return SystemManifest(
            _text(found["name"]),
            _text(found["title"]),
            _positive(found["base_step"]),
            tuple(map(_part, found["parts"])),
            tuple(map(_wire, found["wires"])),
        )
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise FmuFileError(place, f"is damaged ({type(error).__name__}: {error})", "build the FMU again") from error


def _part(given: dict[str, Any]) -> ListedPart:
    name, model, description, hold = (_text(given[key]) for key in ("name", "model", "description", "outputs_hold"))
    return ListedPart(name, model, description, _finite(given["step"]), hold, _text(given.get("folder", "")))


def _wire(given: dict[str, Any]) -> Wire:
    return Wire(_text(given["source"]), _text(given["target"]), _finite(given["factor"]), _finite(given["offset"]))


def _text(value: Any) -> str:
    if not isinstance(value, str):
        raise ValueError(f"{value!r} is no text")
    return value


def _positive(value: Any) -> float:
    if not _finite(value) > 0:
        raise ValueError(f"{value!r} is no step")
    return float(value)


def _finite(value: Any) -> float:
    if not isinstance(value, int | float) or not math.isfinite(value):
        raise ValueError(f"{value!r} is no number")
    return float(value)
