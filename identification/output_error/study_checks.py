"""Whether what a study names is there in its system, and of which kind and unit it is."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator

from fmus.errors import WiringError
from fmus.words import with_article
from identification.output_error.shooting.states import SettableState, states
from identification.output_error.start_values import UnreadStart, unread_starts
from identification.output_error.study import OutputErrorStudy
from identification.quantities import SECONDS
from orchestrator.assembly.assembly import Assembled, OpenSystem
from orchestrator.crossing import Crossing, crossing
from orchestrator.fmi.interface import Port
from orchestrator.settable import check_values
from orchestrator.system import Endpoint, System, must_be, recordable


def ports_of(study: OutputErrorStudy, system: System) -> dict[str, Port]:
    """component.variable -> what a signal or value of the traces goes to or is compared with."""
    names = (*study.run.outputs, *study.run.inputs, *study.run.initial, *study.traces.values)
    return {name: system.port(Endpoint.parse(name)) for name in names}


def checked_parts(
    study: OutputErrorStudy, assembled: Assembled
) -> tuple[dict[str, str], dict[str, Port], tuple[Crossing, ...], list[UnreadStart], list[SettableState]]:
    """Units of the parameters, what signals go to, the connections, start values that nobody gives, and the states that
    can be set, once all of the study is seen to exist."""
    delays, parameters = study.delays, study.parameters
    with OpenSystem(assembled) as opened:
        system = opened.system
        check_values(system, study.system.values())
        for name in study.outputs:
            if recordable(system, name, f"outputs.{name}").causality == "parameter":
                must_be(system, name, "output", "outputs")
        for key, names in _named_parameters(study).items():
            for name in names:
                must_be(system, name, "parameter", key)
        for parameter in parameters.parameters:
            if parameter.name not in delays:
                kind = system.port(Endpoint.parse(study.variable(parameter.name)))
                if not (kind.real or parameter.fixed):
                    problem = f"is {with_article(kind.type)}, and what is estimated is a real number"
                    raise WiringError(f"parameters.{parameter.name}", problem, "give its component a value")
                for value in filter(math.isfinite, (parameter.start, parameter.lower, parameter.upper)):
                    check_values(system, {study.variable(parameter.name): value})
        for values in study.compare.values():
            check_values(system, {study.variable(name): value for name, value in values.items() if name not in delays})
        named = [*parameters.names, *study.outputs, *study.run.initial]
        ports = {name: system.port(Endpoint.parse(study.variable(name))) for name in named if name not in delays}
        units = {name: port.unit or "1" for name, port in ports.items()}
        units |= dict.fromkeys(delays, "s")
        crossings = (*system.crossings, *_converted(study, system))
        settable = states(system, assembled.system.values())
        return units, ports_of(study, system), crossings, unread_starts(study, system), settable


def _converted(study: OutputErrorStudy, system: System) -> Iterator[Crossing]:
    """How values of lists and parameter sets got to the units of the variables."""
    used = {*map(study.variable, study.parameters.names), *study.system.values()}
    for name, (place, unit) in study.given.items():
        if name in used:
            port = SECONDS if name in study.delays else system.port(Endpoint.parse(name))
            yield crossing(f"{name} of {place}", port.meaning(unit), port.measure)


def _named_parameters(study: OutputErrorStudy) -> dict[str, list[str]]:
    """Key of the study -> the parameters of components that it names."""
    named: dict[str, Iterable[str]] = {
        "initial": study.run.initial,
        "traces.values": study.traces.values,
        "parameters": study.parameters.names,
        "truth": study.truth,
        **{f"compare.{name}": values for name, values in study.compare.items()},
    }
    return {key: [study.variable(name) for name in names if name not in study.delays] for key, names in named.items()}
