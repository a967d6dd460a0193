"""A scenario's system as one FMU: what of it the FMU holds, and what stays behind."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from fmus.errors import InputError, WiringError
from fmus.modelling.model import Number, element
from fmus.packaging import targets
from fmus.packaging.native import compiler
from fmus.packaging.system.fused import FusedPart, FusedSystem, Wire
from fmus.words import nearest
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, assemble, model_of
from orchestrator.engine.plan import Order, Plan, make_plan
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import scratch
from orchestrator.rational import clock
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.settable import check_values, typed
from orchestrator.system import Endpoint, System

_INSTEAD = "export it with `servotwin ssp export`, which takes any FMU"


@dataclass(frozen=True)
class Fused:
    """A system to be built, and what a run of the scenario does otherwise, a line each."""

    system: FusedSystem
    notes: tuple[str, ...]


def fuse(file: Path, expose: Sequence[str] = ()) -> Fused:
    """The system of a scenario for its FMU, with the scenario's values as defaults.

    Args:
        expose: names of parameters, component.parameter, or patterns of them with * and ?; none shows all.

    Raises:
        InputError: the scenario does not fit, or has parts that cannot be in the FMU; a name matches nothing.
    """
    scenario = load_scenario(file, references=False)
    _refuse(file, scenario)
    with (
        scratch(None) as folder,
        OpenSystem(assemble(scenario.system, folder, scenario.driven, "native")) as opened,
    ):
        system = opened.system
        given = opened.assembled.system.values()
        check_values(system, given)
        plan = make_plan(system, scenario.timing.step, scenario.timing.order, scenario.timing.cycles)
        _refuse_circles(file, system, plan)
        fused = _fused(file, scenario, system, plan, _starts(scenario, system, given), expose)
        return Fused(fused, _notes(scenario, system, fused.outputs))


def build(fused: Fused, folder: Path, fmi: int = 2, platforms: Sequence[str] = ("host",)) -> Path:
    """Write the FMU of a system into a folder, under the system's name; its path comes back.

    Raises:
        InputError: FMI or a platform is not offered, a model cannot be turned into C, or the path cannot be written.
    """
    return targets.build_system(fused.system, folder / f"{fused.system.name}.fmu", fmi=fmi, platforms=platforms)


def _refuse(file: Path, scenario: Scenario) -> None:
    """See that a system can be fused at all.

    Raises:
        InputError: it cannot; the message says which component, and what to do.
    """
    if not compiler.available():
        raise InputError(file, "needs a C compiler to become one FMU", f"install one, or {_INSTEAD}")
    for block in ("can", "buses"):
        if scenario.can if block == "can" else scenario.system.buses:
            raise InputError(f"{file}: {block}", "a bus cannot be inside an FMU", f"remove the block, or {_INSTEAD}")
    if scenario.timing.order is Order.ITERATED:
        problem = "iterated steps are taken back, which an FMU cannot do inside"
        raise InputError(f"{file}: run.order", problem, f"leave it out, or {_INSTEAD}")
    for name, component in scenario.system.components.items():
        place = f"{file}: components.{name}"
        if component.fmu is not None:
            raise InputError(place, f"{component.fmu.name} is an FMU, and only models can be fused", _INSTEAD)
        if component.solver is not None:
            raise InputError(f"{place}.solver", "solvers cannot be fused", f"remove it, or {_INSTEAD}")


def _refuse_circles(file: Path, system: System, plan: Plan) -> None:
    own = {link.source.component for link in system.connections if link.source.component == link.target.component}
    for group in plan.groups:
        if len(group) > 1 or (group[0] in own and plan.instant[group[0]]):
            names = ", ".join(group)
            raise InputError(
                f"{file}: connections",
                f"direct feed-through runs in a circle through {names}, which cannot be iterated in an FMU",
                f"set `feed_through: none` for one of them, or {_INSTEAD}",
            )


def _starts(scenario: Scenario, system: System, given: Mapping[str, Value]) -> dict[str, Number]:
    """component.variable -> value in its type: those of the components, and what stimuli begin with."""
    starts = {name: value for name, value in typed(system, given).items() if not isinstance(value, str)}
    begin = np.array([float(scenario.timing.start)])
    for name, stimulus in scenario.stimuli.items():
        port = system.port(Endpoint.parse(name))
        brought, _ = stimulus.brought(name, port)
        first = float(brought.values(begin, name)[0])
        value = port.typed(name, first if port.real else round(first))
        starts |= {} if isinstance(value, str) else {name: value}
    return starts


def _fused(
    file: Path, scenario: Scenario, system: System, plan: Plan, values: Mapping[str, Number], expose: Sequence[str]
) -> FusedSystem:
    timing, components = scenario.timing, scenario.system.components
    ticks = clock(timing.start, plan.tick)
    if not ticks.exact(int((timing.stop - timing.start) / plan.tick) + 1):
        raise InputError(f"{file}: run", "its times are too fine to be counted in C", "give steps of fewer digits")
    parts = {name: _part(name, components[name], plan, values) for group in plan.groups for name in group}
    wires = (Wire(str(link.source), str(link.target), link.factor, link.offset) for link in system.connections)
    return FusedSystem(
        name=_identifier(file.stem),
        description=scenario.title,
        parts=parts,
        wires=tuple(wires),
        base=plan.tick,
        start=timing.start,
        stop=timing.stop,
        step=timing.step,
        outputs=_shown(scenario, system, parts),
        parameters=_exposed(parts, expose),
        finite=timing.finite,
    )


def _part(name: str, component: ComponentSpec, plan: Plan, values: Mapping[str, Number]) -> FusedPart:
    start = f"{name}."
    own = {key.removeprefix(start): value for key, value in values.items() if key.startswith(start)}
    tables = {table.name: table for table in component.tables}
    return FusedPart(model_of(component), own, tables, plan.every[name], bool(plan.instant[name]))


def _identifier(stem: str) -> str:
    """A name in C and of a file, made of a file's name."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", stem)
    return plain if re.match("[A-Za-z]", plain) else f"system_{plain}"


def _shown(scenario: Scenario, system: System, parts: Mapping[str, FusedPart]) -> tuple[str, ...]:
    """Outputs that are connected or recorded, and states that are recorded."""
    outputs = [f"{name}.{variable.name}" for name, part in parts.items() for variable in part.model.of("output")]
    states = [f"{name}.{state.name}" for name, part in parts.items() for state in part.model.states]
    recorded = scenario.recorded(tuple(outputs))
    wanted = {*recorded, *(str(link.source) for link in system.connections)}
    return tuple(name for name in dict.fromkeys([*outputs, *states]) if name in wanted)


def _exposed(parts: Mapping[str, FusedPart], expose: Sequence[str]) -> tuple[str, ...]:
    """The parameters that are shown, arrays whole.

    Raises:
        WiringError: a name or pattern matches none.
    """
    known = [f"{name}.{variable.name}" for name, part in parts.items() for variable in part.model.of("parameter")]
    if not expose:
        return tuple(known)
    whole = {name: (element(name) or (name,))[0] for name in known}  # of an element its array
    chosen = set[str]()
    for asked in expose:
        pattern = asked.replace("[", "[[]")
        found = {whole[name] for name in known if fnmatchcase(name, pattern) or fnmatchcase(whole[name], pattern)}
        if not found:
            raise WiringError("--expose", f"'{asked}' is no parameter of a component", nearest(asked, known))
        chosen |= found
    return tuple(name for name in known if whole[name] in chosen)


def _notes(scenario: Scenario, system: System, shown: Iterable[str]) -> tuple[str, ...]:
    """What stays behind."""
    varying = [name for name in scenario.driven if scenario.stimuli[name].varies]
    notes = [f"{name} is an input: what drives it in the scenario stays behind" for name in varying]
    own = scenario.system.values().items()
    if any(case.system is not None or not case.values.items() <= own for case in scenario.cases):
        notes.append("values and components that cases have of their own stay behind")
    inputs = {str(link.target) for link in system.connections}
    there = {*shown, *scenario.driven}
    for name in scenario.recorded(()):
        end = Endpoint.parse(name)
        if name not in there and system.port(end).causality != "parameter":
            what = "is driven by another signal" if name in inputs else "is no output"
            notes.append(f"{name} is recorded in the scenario and {what}: it is not shown")
    return tuple(notes)
