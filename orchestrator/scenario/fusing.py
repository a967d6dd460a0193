"""A scenario's system as one FMU: what of it the FMU holds, and what stays behind."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from fmus.errors import InputError, WiringError
from fmus.modelling.model import element
from fmus.packaging import targets
from fmus.packaging.native import compiler
from fmus.packaging.system.fused import FusedPart, FusedSystem, SystemPart, Wire
from fmus.words import nearest
from orchestrator.assembly.assembly import OpenSystem, assemble, model_of
from orchestrator.engine.planning.plan import Order, Plan, make_plan
from orchestrator.fmi.file import FmuFile, FmuKind
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import scratch
from orchestrator.rational import clock
from orchestrator.scenario.nesting import Role, check_links, nested, remarks
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import by_elements
from orchestrator.settable import check_values, typed
from orchestrator.system import Endpoint, System, component_values

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
        scenario.naming(),
        scratch(None) as folder,
        OpenSystem(assemble(scenario.system, folder, scenario.driven, "native")) as opened,
    ):
        system = opened.system
        scenario = by_elements(system, scenario)
        given = opened.assembled.system.values()
        check_values(system, given)
        plan = make_plan(system, scenario.timing.step, scenario.timing.order, scenario.timing.cycles)
        check_links(file, system)
        _refuse_circles(file, system, plan)
        parts = _parts(file, scenario, opened, plan, _starts(scenario, system, given))
        fused = _fused(file, scenario, system, plan, parts, expose)
        said = (line for name, part in fused.nested.items() for line in remarks(name, opened.files[name], part))
        return Fused(fused, (*_notes(scenario, system, fused.outputs), *said))


def build(fused: Fused, folder: Path, fmi: int = 2, platforms: Sequence[str] = ("host",)) -> Path:
    """Write the FMU of a system into a folder, under the system's name; its path comes back.

    Raises:
        InputError: FMI or a platform is not offered, a model cannot be turned into C, an FMU has no library for a
            platform, or the path cannot be written.
    """
    path = folder / f"{fused.system.name}.fmu"
    for part in fused.system.nested.values():
        if path.exists() and Path(part.place).exists() and path.samefile(part.place):
            raise InputError(path, "would be replaced, and is a part of the system", "give another folder with --out")
    return targets.build_system(fused.system, path, fmi=fmi, platforms=platforms)


def _refuse(file: Path, scenario: Scenario) -> None:
    """See that a system can be fused at all."""
    if not compiler.available():
        raise InputError(file, "needs a C compiler to become one FMU", f"install one, or {_INSTEAD}")
    if scenario.can:
        raise InputError(f"{file}: can", "a bus cannot be inside an FMU", f"remove the block, or {_INSTEAD}")
    if scenario.system.buses:
        raise InputError(f"{file}: buses", "a bus cannot be inside an FMU", "remove them, or hand on the scenario")
    if scenario.timing.order is Order.ITERATED:
        problem = "iterated steps are taken back, which an FMU cannot do inside"
        raise InputError(f"{file}: run.order", problem, f"leave it out, or {_INSTEAD}")
    for name, component in scenario.system.components.items():
        place = f"{file}: components.{name}"
        if component.solver is not None:
            raise InputError(f"{place}.solver", "solvers cannot be inside an FMU", f"remove it, or {_INSTEAD}")


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


def _starts(scenario: Scenario, system: System, given: Mapping[str, Value]) -> dict[str, Value]:
    """component.variable -> value in its type: those of the components, and what stimuli begin with."""
    starts = typed(system, given)
    begin = np.array([float(scenario.timing.start)])
    for name, stimulus in scenario.stimuli.items():
        port = system.port(Endpoint.parse(name))
        brought, _ = stimulus.brought(name, port)
        first = float(brought.values(begin, name)[0])
        starts[name] = port.typed(name, first if port.real else round(first))
    return starts


def _fused(
    file: Path,
    scenario: Scenario,
    system: System,
    plan: Plan,
    parts: Mapping[str, SystemPart],
    expose: Sequence[str],
) -> FusedSystem:
    timing = scenario.timing
    ticks = clock(timing.start, plan.tick)
    if not ticks.exact(int((timing.stop - timing.start) / plan.tick) + 1):
        raise InputError(f"{file}: run", "its times are too fine to be counted in C", "give steps of fewer digits")
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
        tolerance=timing.tolerance or 0.0,
    )


def _parts(
    file: Path, scenario: Scenario, opened: OpenSystem, plan: Plan, values: Mapping[str, Value]
) -> dict[str, SystemPart]:
    """Component -> the part that it becomes, in stepping order."""
    links = opened.system.connections
    connected = {str(end) for link in links for end in (link.source, link.target)} | {*scenario.driven}
    recorded = frozenset(scenario.recorded(tuple(_outputs(opened.system))))
    found: dict[str, SystemPart] = {}
    for name in (name for group in plan.groups for name in group):
        component, own = scenario.system.components[name], component_values(name, values)
        every, instant = plan.every[name], bool(plan.instant[name])
        if component.fmu is None:
            numbers = {key: value for key, value in own.items() if not isinstance(value, str)}
            tables = {table.name: table for table in component.tables}
            found[name] = FusedPart(model_of(component), numbers, tables, every, instant)
        else:
            place = f"{file}: components.{name}"
            _refuse_exchange(place, opened.files[name])
            role = Role(place, own, _names(name, connected), _names(name, recorded), every, instant)
            found[name] = nested(opened.files[name], role)
    return found


def _names(name: str, variables: Iterable[str]) -> frozenset[str]:
    """Those of the variables that are a component's, by their names there."""
    return frozenset(component_values(name, dict.fromkeys(variables, 0)))


def _outputs(system: System) -> Iterator[str]:
    for name, part in system.parts.items():
        yield from (f"{name}.{port.name}" for port in part.interface.of("output"))


def _refuse_exchange(place: str, fmu: FmuFile) -> None:
    if fmu.kind is not FmuKind.CO_SIMULATION:
        raise InputError(place, f"{fmu.path.name} offers {fmu.kind} alone, and solvers cannot be inside", _INSTEAD)


def _identifier(stem: str) -> str:
    """A name in C and of a file, made of a file's name."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", stem)
    return plain if re.match("[A-Za-z]", plain) else f"system_{plain}"


def _shown(scenario: Scenario, system: System, parts: Mapping[str, SystemPart]) -> tuple[str, ...]:
    """Outputs that are connected or recorded, and states that are recorded."""
    outputs = [f"{name}.{output}" for name, part in parts.items() for output in part.outputs]
    states = [f"{name}.{state}" for name, part in parts.items() for state in part.states]
    recorded = scenario.recorded(tuple(outputs))
    wanted = {*recorded, *(str(link.source) for link in system.connections)}
    return tuple(name for name in dict.fromkeys([*outputs, *states]) if name in wanted)


def _exposed(parts: Mapping[str, SystemPart], expose: Sequence[str]) -> tuple[str, ...]:
    """The parameters that are shown, arrays whole."""
    known = [f"{name}.{parameter}" for name, part in parts.items() for parameter in part.parameters]
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
