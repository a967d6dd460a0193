"""terminalsAndIcons.xml of FMI 3.0: the ports of a model as terminals, and how FMU and terminals are drawn.

FMI 2.0 knows an icon only; there the same document lies where tools keep what is their own.
"""

from __future__ import annotations

from importlib.resources import files as shipped
from xml.etree import ElementTree as ET

from fmus import units
from fmus.errors import ModelError
from fmus.modelling.ports import KINDS, PhysicalPort
from fmus.packaging.description import xml
from fmus.packaging.description.interface import DescribedInterface

FOLDER = "terminalsAndIcons"
NAME = "terminalsAndIcons.xml"
FMI2 = f"extra/org.servotwin/{NAME}"
RULE = "plug"
_COLOURS = {"rotational": (90, 90, 90), "translational": (0, 127, 0), "electrical": (0, 0, 200)}
_EDGE, _HALF, _APART = 100, 10, 40  # of the coordinate system, which goes from -100 to 100


def files(interface: DescribedInterface, fmi: int, bus: ET.Element | None = None) -> dict[str, bytes]:
    """Terminals and icons by their names in the archive.

    Args:
        bus: a further terminal, with FMI 3.0.

    Raises:
        ModelError: a variable of a port has the unit of another quantity.
    """
    _check(interface)
    own = "sampled" if _sampled(interface) else "continuous"
    document = xml.document(_document(interface.ports, bus if fmi == 3 else None, drawn=fmi == 3))
    if fmi == 2:
        return {"model.png": _picture(f"{own}.png")} | ({FMI2: document} if interface.ports else {})
    pictures = {"icon": own} | {one.kind: one.kind for one in interface.ports}
    drawn = {f"{name}.{form}": f"{shown}.{form}" for name, shown in pictures.items() for form in ("png", "svg")}
    return {f"{FOLDER}/{NAME}": document} | {f"{FOLDER}/{name}": _picture(file) for name, file in drawn.items()}


def _picture(name: str) -> bytes:
    return (shipped(__package__) / "pictures" / name).read_bytes()


def _check(interface: DescribedInterface) -> None:
    for one in interface.ports:
        for (quantity, unit), name in zip(KINDS[one.kind], one.members.values(), strict=True):
            own, wanted = units.parse(interface.by_name[name].unit), units.parse(unit)
            if own is None or wanted is None or not own.fits(wanted):
                problem = f"{name} is its {quantity} and has the unit '{interface.by_name[name].unit}'"
                raise ModelError(f"model {interface.name}: port {one.name}", problem, f"give it one of {unit}")


def _sampled(interface: DescribedInterface) -> bool:
    outputs = [variable for variable in interface.variables if variable.causality == "output"]
    return all(variable.variability == "discrete" for variable in outputs)


def _document(ports: tuple[PhysicalPort, ...], bus: ET.Element | None, drawn: bool) -> ET.Element:
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    if drawn:
        ET.SubElement(ET.SubElement(root, "GraphicalRepresentation"), "Icon", _box(0, 0, _EDGE))
    if not ports and bus is None:
        return root
    terminals = ET.SubElement(root, "Terminals")
    for one in ports:
        terminal = _terminal(terminals, one)
        if drawn:
            beside = [other.name for other in ports if other.outward == one.outward]
            up = _APART * ((len(beside) - 1) / 2 - beside.index(one.name))
            colour = " ".join(map(str, _COLOURS[one.kind]))
            said = {"defaultConnectionColor": colour, "defaultConnectionStrokeSize": "2", "iconBaseName": one.kind}
            box = _box(_EDGE if one.outward else -_EDGE, up, _HALF)
            ET.SubElement(terminal, "TerminalGraphicalRepresentation", said | box)
    terminals.extend([] if bus is None else [bus])
    return root


def _terminal(parent: ET.Element, port: PhysicalPort) -> ET.Element:
    """A terminal of its kind; no standard names such kinds, and those of a tool begin with its name."""
    kind = f"_servotwin_{port.kind}"
    terminal = ET.SubElement(parent, "Terminal", name=port.name, matchingRule=RULE, terminalKind=kind)
    for member, variable in port.members.items():
        flow = "outflow" if port.outward else "inflow"
        said = {"variableName": variable, "memberName": member}
        said["variableKind"] = flow if variable == port.flow else "signal"
        ET.SubElement(terminal, "TerminalMemberVariable", said)
    return terminal


def _box(x: float, y: float, half: float) -> dict[str, str]:
    """Corners of a square about a point."""
    return {"x1": f"{x - half:g}", "y1": f"{y - half:g}", "x2": f"{x + half:g}", "y2": f"{y + half:g}"}
