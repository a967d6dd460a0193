"""What AUTOSAR files may say in ways that cantools passes over: scalings and units of signals, kinds of base types."""

from __future__ import annotations

import re
from collections.abc import Iterator
from xml.etree import ElementTree as ET

from fmus.words import listed

SIGNED, FLOAT = ("sint", "int", "s"), ("float", "double", "f")  # how names of base types begin
UNDERSTOOD = ("LINEAR", "TEXTTABLE", "SCALE_LINEAR_AND_TEXTTABLE", "IDENTICAL")
_KIND = re.compile(r"(?:a_)?([a-z]+)")
PROPS = "{*}SW-DATA-DEF-PROPS-VARIANTS/{*}SW-DATA-DEF-PROPS-CONDITIONAL"
COEFFICIENTS = "{*}COMPU-INTERNAL-TO-PHYS/{*}COMPU-SCALES/{*}COMPU-SCALE/{*}COMPU-RATIONAL-COEFFS"


def completed(text: str) -> tuple[str, list[str]]:
    """The text of an ARXML file in a form that cantools understands, and what it does not, a line each.

    A scaling or a unit that only a signal's form on the bus has is its own; a conversion by a quotient that is linear,
    or by coefficients without a category, is linear; of a base type without an encoding its name tells the sign.
    """
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError):
        return text, []  # cantools says what is wrong
    guessed, raw = [*_encodings(root)], [*_categories(root)]
    changed = [*map(_moved, _bare(root))]
    notes = [f"base types without an encoding are taken by their names: {listed(guessed)}"] if guessed else []
    if unsaid := [name for name, category in raw if category]:
        notes.append(f"conversions that are not known, whose signals stay as they are on the bus: {listed(unsaid)}")
    return (ET.tostring(root, encoding="unicode"), notes) if guessed or raw or changed else (text, notes)


def _encodings(root: ET.Element) -> Iterator[str]:
    """The base types that are given an encoding, in words."""
    for base in root.iterfind(".//{*}SW-BASE-TYPE"):
        if base.find(".//{*}BASE-TYPE-ENCODING") is None:
            name = base.findtext("{*}SHORT-NAME") or ""
            found = _KIND.match(name.lower())
            kind = found[1] if found else ""
            made = "IEEE754" if kind in FLOAT else "2C" if kind in SIGNED else "NONE"
            _sub(base, "BASE-TYPE-ENCODING").text = made
            yield f"{name} as {'a float' if made == 'IEEE754' else 'signed' if made == '2C' else 'unsigned'}"


def _categories(root: ET.Element) -> Iterator[tuple[str, str]]:
    """Name of each conversion that is made linear, and of those that stay unknown with their category."""
    for method in root.iterfind(".//{*}COMPU-METHOD"):
        category, coefficients = method.find("{*}CATEGORY"), method.findall(COEFFICIENTS)
        said = category.text if category is not None and category.text else ""
        name = method.findtext("{*}SHORT-NAME") or ""
        if said in UNDERSTOOD and not (said == "LINEAR" and len(coefficients) > 1):
            continue
        if said != "LINEAR" and len(coefficients) == 1 and _is_linear(coefficients[0]):
            (_sub(method, "CATEGORY") if category is None else category).text = "LINEAR"
            yield name, ""
        elif coefficients or said:
            if category is not None:
                category.text = "SCALE_LINEAR"  # of the pieces of one cantools would take the last for all
            yield name, said or "none"


def _is_linear(coefficients: ET.Element) -> bool:
    """Whether a quotient of polynomials is of first order over a constant; made to have one numerator and one below."""
    above, below = (coefficients.find(f"{{*}}COMPU-{part}") for part in ("NUMERATOR", "DENOMINATOR"))
    if above is None or below is None:
        return False
    for part, count in ((above, 2), (below, 1)):
        values = part.findall("{*}V")
        if len(values) < count or any((value.text or "").strip("0. ") for value in values[count:]):
            return False
        for value in values[count:]:
            part.remove(value)
    return True


def _bare(root: ET.Element) -> Iterator[tuple[ET.Element, ET.Element]]:
    """The properties on the bus with a conversion or unit, and the system signals without, that belong together."""
    systems = dict(_named(root))
    for signal in root.iterfind(".//{*}I-SIGNAL"):
        told = signal.find(f"{{*}}NETWORK-REPRESENTATION-PROPS/{PROPS}")
        system = systems.get((signal.findtext("{*}SYSTEM-SIGNAL-REF") or "").strip())
        known = ("{*}COMPU-METHOD-REF", "{*}UNIT-REF")
        if told is None or system is None or all(told.find(key) is None for key in known):
            continue
        if all(system.find(f".//{key}") is None for key in known):
            yield told, system


def _moved(pair: tuple[ET.Element, ET.Element]) -> None:
    told, system = pair
    place = _sub(_sub(_sub(system, "PHYSICAL-PROPS"), "SW-DATA-DEF-PROPS-VARIANTS"), "SW-DATA-DEF-PROPS-CONDITIONAL")
    place.extend(part for part in told if part.tag.endswith(("}COMPU-METHOD-REF", "}UNIT-REF")))


def _named(root: ET.Element) -> Iterator[tuple[str, ET.Element]]:
    """The system signals by their paths."""
    below = [(root, "")]
    while below:
        node, path = below.pop()
        for child in node:
            name = child.findtext("{*}SHORT-NAME")
            inner = path if name is None else f"{path}/{name.strip()}"
            if child.tag.endswith("}SYSTEM-SIGNAL"):
                yield inner, child
            below.append((child, inner))


def _sub(parent: ET.Element, name: str) -> ET.Element:
    """A new element of the same namespace, of an old one its own."""
    space = parent.tag.rpartition("}")[0] + "}"
    found = parent.find(f"{space}{name}")
    return ET.SubElement(parent, f"{space}{name}") if found is None else found
