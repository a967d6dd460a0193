"""FMUs of a scenario as parts of one FMU: what of them can lie inside, and what is refused."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from fmus import units
from fmus.errors import InputError
from fmus.modelling.model import Number
from fmus.packaging import archive
from fmus.packaging.description.interface import Exposed
from fmus.packaging.native import compiler
from fmus.packaging.system.nested import BINARIES, START, NestedPart, NestedVariable
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.base import TROUBLE
from orchestrator.fmi.interface import Port, Value
from orchestrator.system import System

KINDS = {
    "Real": ("Real", "REAL_VALUE"),
    "Float64": ("Real", "REAL_VALUE"),
    "Integer": ("Integer", "WHOLE_VALUE"),
    "Int32": ("Integer", "WHOLE_VALUE"),
    "Boolean": ("Boolean", "TRUTH_VALUE"),
    "Enumeration": ("Integer", "ITEM_VALUE"),
}
_LONGEST = 200  # of names in a file of defaults
_INSTEAD = "export it with `servotwin ssp export`, which takes any FMU"


@dataclass(frozen=True)
class Role:
    """What an FMU is in a system.

    Attributes:
        place: of the component, for messages.
        values: variable -> value that it is given.
        connected: its variables that connections name.
        recorded: those that the scenario records.
    """

    place: str
    values: Mapping[str, Value]
    connected: frozenset[str]
    recorded: frozenset[str]
    every: int
    instant: bool


def nested(fmu: FmuFile, role: Role) -> NestedPart:
    """An FMU as a part of a system.

    Raises:
        InputError: it cannot be one; the message names the component or its variable.
    """
    if fmu.interface.sizes:
        name = next(iter(fmu.interface.sizes))
        raise InputError(f"{role.place}: {name}", "sizes of arrays cannot be set inside", f"remove it, or {_INSTEAD}")
    variables = tuple(_numbered(_variables(fmu, role)))
    kept = {variable.shown.name for variable in variables}
    return NestedPart(
        place=str(fmu.path),
        title=fmu.interface.model_name,
        description=fmu.description.description or "",
        fmi=int(fmu.interface.fmi_version[0]),
        identifier=fmu.identifier,
        token=fmu.description.guid,
        variables=variables,
        values=_values(role.values, kept),
        feed_through=_within(fmu.interface.feed_through, kept),
        every=role.every,
        instant=role.instant,
        categories=tuple(one.name for one in fmu.description.logCategories if one.name in TROUBLE),
        saves=fmu.interface.has_state,
        once=bool(fmu.offer.canBeInstantiatedOnlyOncePerProcess),
        needs_tool=bool(fmu.offer.needsExecutionTool),
        files=_files(fmu),
    )


def check_links(file: Path, system: System) -> None:
    """See that nothing but numbers goes from FMU to FMU, and none to parameters.

    Raises:
        InputError: ticks or texts do, or parameters are calculated.
    """
    for given in system.settled:
        problem = f"{given.source} -> {given.target} gives a parameter its value, which is not calculated inside"
        raise InputError(f"{file}: connections", problem, f"remove it, or {_INSTEAD}")
    for link in (*system.clocks, *system.texts):
        problem = f"{link} carries no numbers, and only those are passed on inside"
        raise InputError(f"{file}: connections", problem, f"remove it, or {_INSTEAD}")


def remarks(name: str, fmu: FmuFile, part: NestedPart) -> Iterator[str]:
    """What a user may want to know of an FMU that is packed."""
    if fmu.interface.ticks:
        yield f"{name}: its clocks tick inside of it, not by event mode as in a run"
    if part.needs_tool:
        yield f"{name}: needs another program where it runs, and so does the FMU"
    if not part.saves:
        yield f"{name}: cannot go back to a state, and so neither can the FMU"
    shown = (fmu.interface.ports[one.shown.name] for one in part.variables if one.shown.name in fmu.interface.ports)
    for unit in sorted({port.unit for port in shown if port.unit and port.measure.unit != units.parse(port.unit)}):
        yield f"{name}: its unit '{unit}' is shown by its name alone, not as it defines it"


def _variables(fmu: FmuFile, role: Role) -> Iterator[NestedVariable]:
    """What is set or read; what of it is of a type that is not passed on is refused where it is needed."""
    wanted = role.connected | role.recorded
    arrays = {port.array.name for name, port in fmu.interface.ports.items() if port.array and name in wanted}
    for port in fmu.interface.ports.values():
        given, read = port.name in role.values, port.name in wanted or (port.array and port.array.name in arrays)
        if _fits(port) and not (port.array and given and port.causality in ("output", "local")):
            kept = port.settable if port.causality == "parameter" else port.causality == "input" or read
            if kept:
                yield _variable(port, role.values.get(port.name))
            if given and port.causality in ("output", "local"):
                yield _start(port, role.values[port.name])
        elif given or port.name in role.connected:
            array = "in an array that is computed, or has no start values"
            what = array if port.array and port.type in KINDS else f"of type {port.type}"
            fix = f"leave it alone, or {_INSTEAD}"
            raise InputError(f"{role.place}: {port.name}", f"is {what}, which is not passed on inside", fix)


def _fits(port: Port) -> bool:
    name = port.array.name if port.array else port.name
    plain = len(name) <= _LONGEST and name.isprintable() and "=" not in name and name == name.strip()
    begins = port.array is None or port.array.starts is not None or port.causality not in ("parameter", "input")
    return plain and begins and port.type in KINDS


def _variable(port: Port, given: Value | None) -> NestedVariable:
    """As the system describes it: what it is given is its start value."""
    number = port.type in ("Real", "Float64")
    causality = port.causality if port.causality in ("input", "output", "parameter") else "local"
    variability = port.variability if causality == "parameter" else "continuous" if number else "discrete"
    initial = {"parameter": "exact", "input": None}.get(causality, "calculated")
    start = None if initial == "calculated" else given if given is not None else port.parsed(port.start or "0")
    return _made(port, port.name, causality, variability, initial, start)


def _start(port: Port, given: Value) -> NestedVariable:
    """What a variable that is computed begins with, which is set as a parameter is, and not shown."""
    return _made(port, port.name + START, "parameter", "fixed", "exact", given)


def _made(
    port: Port, name: str, causality: str, variability: str, initial: str | None, start: Value | None
) -> NestedVariable:
    kind, inner = KINDS[port.type]
    shown = Exposed(
        name,
        0,
        causality,
        variability,
        initial,
        kind,
        port.unit or "1",
        port.description,
        None if isinstance(start, str) else start,
        port.minimum,
        port.maximum,
    )
    size = 1 if port.array is None else 0 if port.element else math.prod(port.array.shape)
    return NestedVariable(shown, port.reference, inner, size)


def _numbered(variables: Iterable[NestedVariable]) -> Iterator[NestedVariable]:
    """With their places in the part as value references."""
    for place, variable in enumerate(variables):
        yield replace(variable, shown=replace(variable.shown, reference=place))


def _values(given: Mapping[str, Value], kept: set[str]) -> dict[str, Number]:
    """What is set, by the names of what is set."""
    named = {name + START if name + START in kept else name: value for name, value in given.items()}
    return {name: value for name, value in named.items() if name in kept and not isinstance(value, str)}


def _within(feed_through: Mapping[str, frozenset[str] | None], kept: set[str]) -> dict[str, frozenset[str] | None]:
    return {
        name: None if inputs is None else frozenset(inputs & kept)
        for name, inputs in feed_through.items()
        if name in kept
    }


def _files(fmu: FmuFile) -> dict[str, bytes]:
    """The contents of its file, with a library that was compiled from its sources for this platform."""
    files = archive.read(fmu.path)
    if compiler.host_name() in compiler.PLATFORMS:
        machine = compiler.host()
        folder = machine.folder2 if fmu.interface.fmi_version.startswith("2") else machine.name
        here = f"{BINARIES}{folder}/{fmu.identifier}{machine.suffix}"
        files.setdefault(here, (fmu.folder / here).read_bytes())
    return files
