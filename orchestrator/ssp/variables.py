"""How variables and their values stand in a document: in SSP 1.0 one by one, in 2.0 by FMI 3.0's types and arrays as
wholes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from fractions import Fraction

from fmus.modelling.model import element
from fmus.parameters.ssv import ArrayValue, Item, SetValue
from fmus.words import with_article
from orchestrator.fmi.clocks.declared import Clock
from orchestrator.fmi.interface import Port, Value
from orchestrator.ssp.description import Connector
from orchestrator.ssp.names import Version
from orchestrator.system import COMPUTED

Shape = tuple[int, ...]


@dataclass(frozen=True)
class ConnectorVariable:
    """What one connector stands for.

    Attributes:
        port: the variable, of an array its first element.
        shape: of an array; () of a scalar.
    """

    name: str
    port: Port
    shape: Shape = ()


def variables(ports: Iterable[Port], version: Version) -> list[ConnectorVariable]:
    """What has a connector of its own: in 2.0 an array as a whole, in 1.0 each of its elements."""
    found: dict[str, ConnectorVariable] = {}
    for port in ports:
        whole = port.array if version is Version.TWO else None
        name = port.name if whole is None else whole.name
        found.setdefault(name, ConnectorVariable(name, port, () if whole is None else whole.shape))
    return list(found.values())


def type_name(port: Port, version: Version) -> str:
    """Name of the element for a variable's type."""
    if port.items:
        return "Enumeration"
    if version is Version.TWO:
        return port.type
    if port.real:
        return "Real"
    return port.type if port.type in ("Boolean", "String", "Binary") else "Integer"


def contradiction(connector: Connector, port: Port | None) -> str:
    """In what a connector is said to be something else than its variable is, which counts; nothing where it is not."""
    if port is None:
        return "is no variable of its FMU"
    if connector.kind in ("input", "output", "parameter", *COMPUTED) and port.causality not in (
        connector.kind,
        "structuralParameter",
    ):
        return f"is said to be {with_article(connector.kind)}, and is {with_article(port.causality)} of its FMU"
    if connector.type and _sort(connector.type) != _sort(port.type):
        return f"is said to be {with_article(connector.type)}, and is {with_article(port.type)} of its FMU"
    own = tuple(map(str, port.array.shape if port.array and port.array.name == connector.name else ()))
    if connector.sizes and connector.sizes != own:
        said, found = (f"of {' x '.join(sizes)} elements" if sizes else "a scalar" for sizes in (connector.sizes, own))
        return f"is said to be {said}, and is {found} in its FMU"
    return ""


def _sort(kind: str) -> str:
    """What types of both versions have in common."""
    if kind in ("Real", "Float32", "Float64"):
        return "real"
    return "whole" if kind in ("Integer", "Enumeration") or "Int" in kind else kind


def clock_attributes(clock: Clock) -> dict[str, str]:
    """How SSP 2.0 says when a clock ticks; where a decimal would not be exact, by counters."""
    said = {"intervalVariability": str(clock.kind)}
    lengths = {"interval": clock.interval, "shift": clock.shift or None}
    known = {name: length for name, length in lengths.items() if length is not None}
    if all(Fraction(repr(float(length))) == length for length in known.values()):
        return said | {f"{name}Decimal": repr(float(length)) for name, length in known.items()}
    resolution = math.lcm(*(length.denominator for length in known.values()))
    return said | {"resolution": str(resolution), **{f"{n}Counter": str(int(x * resolution)) for n, x in known.items()}}


def indexed(variable: str, port: Port, version: Version) -> tuple[str, str]:
    """Name of the connector of a variable, and the indices in it that a connection is restricted to; "" without."""
    place = element(variable) if version is Version.TWO and port.array is not None else None
    return (variable, "") if place is None else (place[0], " ".join(map(str, place[1])))


def set_value(port: Port, name: str, value: Value, version: Version) -> SetValue | ArrayValue:
    """A value of a scalar as a parameter set has it."""
    typed = port.typed(name, value)
    if port.items:
        return Item(next(item for item, number in port.items.items() if number == typed))
    own = type_name(port, version)
    return typed if own in ("Real", "Integer", "Boolean", "String") else ArrayValue(own, (typed,))


def set_values(
    given: Mapping[str, Value], ports: Mapping[str, Port], version: Version
) -> tuple[dict[str, SetValue | ArrayValue], list[str]]:
    """Name -> what a parameter set has of these values, and the arrays that are given in part and whose other elements
    nothing tells: those stand element by element, as in 1.0."""
    found: dict[str, SetValue | ArrayValue] = {}
    torn: dict[str, None] = {}
    for name, value in given.items():
        port = ports[name]
        whole = port.array if version is Version.TWO else None
        if whole is None or whole.name in found:
            if whole is None:
                found[name] = set_value(port, name, value, version)
            continue
        values = _elements(whole.name, whole.shape, given, ports)
        if values is None:
            torn[whole.name] = None
            found[name] = set_value(port, name, value, version)
        else:
            found[whole.name] = ArrayValue(type_name(port, version), values, whole.shape)
    return found, list(torn)


def _elements(
    array: str, shape: Shape, given: Mapping[str, Value], ports: Mapping[str, Port]
) -> tuple[SetValue, ...] | None:
    """All elements of an array, row by row: given, or as the FMU starts; None where neither tells one."""
    own = [port for port in ports.values() if port.array is not None and port.array.name == array]
    if len(own) != math.prod(shape):
        return None
    values: list[SetValue] = []
    for port in own:
        start = given.get(port.name, None if port.start is None else port.parsed(port.start))
        if start is None:
            return None
        value = set_value(port, port.name, start, Version.ONE)
        values.append(value if not isinstance(value, ArrayValue) else value.values[0])
    return tuple(values)
