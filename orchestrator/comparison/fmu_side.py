"""Two FMUs compared: run alone or in the place of a component, and what they say of themselves differently."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from fmus import library
from fmus.errors import InputError
from orchestrator.assembly.assembly import SystemSpec, open_system
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Port
from orchestrator.rational import seconds
from orchestrator.trace import Trace

STEPS = 1000  # of a run whose step nobody says


def alone(file: Path, stop: float | None, step: float | None) -> tuple[Trace, tuple[str, ...]]:
    """What an FMU gives whose inputs keep their start values, and notes on how it ran.

    Args:
        stop, step: None takes those of its default experiment, else 1 s and a thousandth of the whole [s].
    """
    given = FmuDescription(file).description.defaultExperiment
    until = stop or _positive(getattr(given, "stopTime", None)) or 1.0
    every = step or _positive(getattr(given, "stepSize", None)) or until / STEPS
    with open_system({"fmu": file}) as system:
        inputs = [port.name for port in system.system.parts["fmu"].interface.of("input")]
        result = system.run(max(round(until / every), 1) * seconds(every, "step"), every)
    notes = [f"ran alone from 0 to {until:g} s, with a step of {every:g} s"]
    notes += [f"its inputs keep their start values: {', '.join(inputs)}; drive them with --scenario"] if inputs else []
    return result.trace, (*notes, *([result.ended] if result.ended else []))


def with_component(system: SystemSpec, file: Path, name: str | None) -> SystemSpec:
    """The system with an FMU in the place of a component, by default of the one that it is a version of.

    Raises:
        InputError: there is no such component, or not exactly one that fits.
    """
    known = ", ".join(system.components)
    if name is not None and name not in system.components:
        raise InputError("--component", f"there is no '{name}'", f"choose one of {known}")
    fits = [name] if name else list(_versions(system, FmuDescription(file).interface.model_name))
    if len(fits) != 1:
        raise InputError(file, "is a version of no component, or of several", f"choose by --component one of {known}")
    one = system.components[fits[0]]
    if one.tables:
        raise InputError(file, f"takes the place of {fits[0]}, which plays back tables", "build them into the FMU")
    changed = replace(one, source=file)
    return replace(system, components={**system.components, fits[0]: changed})


def _versions(system: SystemSpec, model: str) -> Iterator[str]:
    """Components that are made of a model with this name."""
    for name, component in system.components.items():
        if component.fmu is not None:
            found = FmuDescription(component.fmu).interface.model_name
        else:
            found = getattr(component.source, "name", "") or library.find(str(component.source)).name
        if found == model:
            yield name


def differences(one: Path, other: Path) -> list[str]:
    """What two FMUs say of their variables differently, a line each; what is hidden in them is not seen here."""
    a, b = (FmuDescription(file).interface.ports for file in (one, other))
    lines = [f"only {one} has {name} ({a[name].causality})" for name in a if name not in b]
    lines += [f"only {other} has {name} ({b[name].causality})" for name in b if name not in a]
    for name in a:
        if name in b:
            lines += [f"{name}: {line}" for line in _differently(a[name], b[name])]
    return lines


def _differently(one: Port, other: Port) -> Iterator[str]:
    for word in ("causality", "type", "unit", "start", "minimum", "maximum"):
        a, b = getattr(one, word), getattr(other, word)
        if a != b and not (word == "start" and _same_number(a, b)):
            yield f"{word} {a if a is not None else 'none'} and {b if b is not None else 'none'}"


def _same_number(one: str | None, other: str | None) -> bool:
    try:
        return one is not None and other is not None and float(one) == float(other)
    except ValueError:
        return False


def _positive(text: str | None) -> float | None:
    """A time that an FMU says, where it is one."""
    try:
        value = float(text or 0)
    except ValueError:
        return None
    return value if 0 < value < 1e6 else None
