"""documentation/index.html of a system's FMU: its parts, how they are wired, and its variables."""

from __future__ import annotations

from html import escape

from fmus.packaging.description import documentation
from fmus.packaging.system.fused import SystemPart, Wire
from fmus.packaging.system.interface import SystemInterface


def page(interface: SystemInterface) -> bytes:
    """The page; it needs nothing from the network."""
    system = interface.system
    stepped = [_stepped(name, part, float(part.every * system.base)) for name, part in system.parts.items()]
    wires = [(wire.source, wire.target, _scale(wire)) for wire in system.wires]
    parts = [
        f"<h1>{escape(system.name)}</h1><p>{escape(system.description)}</p>",
        f"<p>Steps are multiples of {float(system.base):.12g} s.</p>",
        "<h2>Parts, in the order in which they are stepped</h2>",
        documentation.table(("Part", "Model", "Step [s]", "Outputs hold", "Meaning"), stepped),
        "<h2>Wires</h2>",
        documentation.table(("From", "To", "Conversion"), wires),
        "<h2>Variables</h2>",
        documentation.variables(interface),
    ]
    return documentation.document(system.name, parts)


def _stepped(name: str, part: SystemPart, step: float) -> tuple[str, ...]:
    hold = "at once" if part.instant else "from the end of its step"
    return name, part.title, f"{step:.12g}", hold, part.description


def _scale(wire: Wire) -> str:
    if (wire.factor, wire.offset) == (1.0, 0.0):
        return ""
    return f"{wire.factor!r} * value + {wire.offset!r}"
