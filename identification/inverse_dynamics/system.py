"""The system of an inverse-dynamics study, seen to have what the study names, in the units that its terms need."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fmus.errors import WiringError
from identification.inverse_dynamics.study import InverseDynamicsStudy
from identification.inverse_dynamics.terms import Term
from identification.quantities import must_be_in, number
from orchestrator.crossing import NamedUnit
from orchestrator.settable import check_values
from orchestrator.system import Endpoint, System, must_be, recordable

UNITS: dict[str, dict[str, str]] = {
    "m": {"inertia": "kg", "viscous": "N.s/m", "coulomb": "N", "offset": "N", "stiffness": "N/m"},
    "rad": {"inertia": "kg.m2", "viscous": "N.m.s/rad", "coulomb": "N.m", "offset": "N.m", "stiffness": "N.m/rad"},
}
"""Unit of the position -> kind of term -> the unit that its value has."""


@dataclass(frozen=True)
class AxisSystem:
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


def checked(study: InverseDynamicsStudy, system: System) -> AxisSystem:
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
        must_be_in(system, f"write.{term}", target, "this term", units[term.split("_")[0]])
    if axis.gain is not None:
        must_be(system, axis.gain, "parameter", "command.gain")
        if command.name:
            must_be_in(system, "command.gain", axis.gain, "this gain", f"{units['offset']}/{command.name}")
    else:
        must_be_in(system, "command.input", axis.input, "a force", units["offset"])
    signals = {axis.position: position, axis.command: command}
    if study.loop is not None:
        signals[study.loop.reference] = position
    return AxisSystem(
        signals,
        {term: number(system, values, target) for term, target in study.write.items()},
        {term: system.port(Endpoint.parse(target)).measure.name for term, target in study.write.items()},
        1.0 if axis.gain is None else number(system, values, axis.gain),
    )
