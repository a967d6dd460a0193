"""The system of an inverse-dynamics study, seen to have what the study names, in the units that its terms need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fmus.errors import WiringError
from fmus.units import SAME
from identification.inverse_dynamics.study import InverseDynamicsStudy
from identification.inverse_dynamics.terms import Term
from orchestrator.crossing import NamedUnit, crossing, named
from orchestrator.system import Endpoint, System, check_values, must_be, recordable

UNITS: dict[str, dict[str, str]] = {
    "m": {"inertia": "kg", "viscous": "N.s/m", "coulomb": "N", "offset": "N", "stiffness": "N/m"},
    "rad": {"inertia": "kg.m2", "viscous": "N.m.s/rad", "coulomb": "N.m", "offset": "N.m", "stiffness": "N.m/rad"},
}
"""Unit of the position -> kind of term -> the unit that its value has."""


@dataclass(frozen=True)
class Checked:
    """What a study's system says.

    Attributes:
        units: signal -> the unit that it is taken in.
        before: term -> value in the system.
        parameter_units: term -> unit of that.
        gain: force per command.
    """

    units: Mapping[str, NamedUnit]
    before: Mapping[Term, float]
    parameter_units: Mapping[Term, str]
    gain: float


def checked(study: InverseDynamicsStudy, system: System) -> Checked:
    """What the study needs of its system.

    Raises:
        WiringError: a name is not there, or in a unit that its term does not have.
    """
    axis, values = study.axis, study.system.values()
    check_values(system, values)
    position = recordable(system, axis.output, "position.output").measure
    must_be(system, axis.input, "input", "command")
    command = system.port(Endpoint.parse(axis.input)).measure
    if position.name not in UNITS:
        raise WiringError(axis.output, f"is in '{position.name}'", f"name an output in {' or '.join(UNITS)}")
    units = UNITS[position.name]
    for term, target in study.write.items():
        must_be(system, target, "parameter", f"write.{term}")
        _in(system, f"write.{term}", target, units[term.split("_")[0]])
    if axis.gain is not None:
        must_be(system, axis.gain, "parameter", "command.gain")
        if command.name:
            _in(system, "command.gain", axis.gain, f"{units['offset']}/{command.name}")
    else:
        _in(system, "command.input", axis.input, units["offset"])
    signals = {axis.position: position, axis.command: command}
    if study.loop is not None:
        signals[study.loop.reference] = position
    return Checked(
        signals,
        {term: _number(system, values, target) for term, target in study.write.items()},
        {term: system.port(Endpoint.parse(target)).measure.name for term, target in study.write.items()},
        1.0 if axis.gain is None else _number(system, values, axis.gain),
    )


def _in(system: System, key: str, name: str, unit: str) -> None:
    crossed = crossing(f"{key}.{name}", named(unit), system.port(Endpoint.parse(name)).measure)
    if crossed.conversion != SAME:
        raise WiringError(crossed.place, f"is in {crossed.target}", f"this term is in {unit}")


def _number(system: System, values: Mapping[str, object], name: str) -> float:
    """The value of a parameter: the study's, or the FMU's own."""
    given = values.get(name, system.port(Endpoint.parse(name)).start)
    if not isinstance(given, (int, float, str)):
        raise WiringError(name, "has no value", "give one in its component")
    return float(given)
