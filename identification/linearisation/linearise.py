"""A system of FMUs, wired by a scenario, as one linear model about a point of its run; the way in."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from fmus.errors import IdentificationError, ScenarioError
from identification.linear.model import UNIT_CIRCLE
from identification.linearisation.parts import Parts
from identification.linearisation.periodic import JoinedSystem, over_a_period
from identification.linearisation.point import OperatingPoint, checked, reached
from identification.linearisation.result import Linearised, ModelSignal
from identification.linearisation.slopes import SLOW
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.assembly.whole_arrays import elements
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuDescription, FmuKind
from orchestrator.fmi.interface import Port, Value
from orchestrator.fmi.isolation import scratch
from orchestrator.progress import Progress, silent
from orchestrator.rational import seconds, written
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import typed
from orchestrator.solvers.base import SolverSettings
from orchestrator.system import Connection, Endpoint, System, component_values

STEP = Fraction(1, 100)  # of an FMU that says none [s]


def linearise(
    source: Scenario | str | Path,
    at: float | str | Fraction | None = None,
    values: Mapping[str, Value | list[Any]] | None = None,
    progress: Progress = silent,
    case: str | None = None,
) -> Linearised:
    """A scenario's wired system, or one FMU, as a linear model about the point that its run reaches.

    What drives it are the scenario's stimuli, the outputs of components without inputs and states, and inputs that
    nothing drives; its outputs are those that the scenario records.

    Args:
        source: a scenario, a scenario file or an FMU file.
        at: an instant of the run [s]; None takes its start.
        values: component.variable -> value, over those of the scenario.
        case: of the scenario, with its values and the system that it has; None takes the first.

    Raises:
        InputError: it cannot be linearised there; the message names the component and the reason.
        FmuError: an FMU fails.
    """
    whole = source if isinstance(source, Scenario) else _loaded(Path(source))
    scenario, chosen = _case(whole, case)
    with whole.naming(values or {}), scratch(None) as folder:
        given = elements(values or {})
        instant = checked(scenario, scenario.timing.start if at is None else seconds(at, "--at"))
        assembled = assemble(scenario.system.given(given), folder, scenario.driven)
        with OpenSystem(assembled) as opened, opened.simulation(scenario.timing) as simulation:
            system = opened.system
            scenario, _ = in_units_of(system, scenario)
            own = {**chosen.values, **typed(system, given)}
            simulation.check_values(own)
            with reached(scenario, simulation, own, instant, progress) as point:
                progress(0.9, "slopes")
                files = {
                    name: FmuDescription(file, None, assembled.system.components[name].parameters)
                    for name, file in assembled.files.items()
                }
                parts = _parts(scenario.system, files, own, point)
                return _joined(whole, scenario, chosen, system, simulation, parts, point)


def _case(whole: Scenario, name: str | None) -> tuple[Scenario, Case]:
    """A case, by default the first, and the scenario with the system that it has."""
    for scenario in whole.by_system():
        for case in scenario.cases:
            if name in (None, case.name):
                return scenario, case
    known = ", ".join(case.name for case in whole.cases)
    raise ScenarioError(whole.path, f"has no case '{name}'", f"its cases are {known}")


def _loaded(path: Path) -> Scenario:
    return _alone(path) if path.suffix.lower() == ".fmu" else load_scenario(path, references=False)


def _alone(path: Path) -> Scenario:
    """The scenario of an FMU that runs by itself."""
    file = FmuDescription(path)
    told = getattr(file.description.defaultExperiment, "stepSize", None)
    period = file.interface.ports.get("sample_time")
    step = next((seconds(text) for text in (period and period.start, told) if text), STEP)
    name = re.sub(r"\W", "_", path.stem)
    spec = ComponentSpec(path, solver=SolverSettings() if file.kind is FmuKind.MODEL_EXCHANGE else None)
    timing = Timing(stop=step * 2**20, step=step)
    return Scenario(path, path.stem, "", SystemSpec({name: spec}), timing, {}, None, None, (Case("alone"),))


def _parts(
    system: SystemSpec, files: Mapping[str, FmuDescription], values: Mapping[str, Value], point: OperatingPoint
) -> Parts:
    found = Parts()
    for name, spec in system.components.items():
        own = component_values(name, values)
        found.add(name, spec, files[name], {**spec.parameters, **own}, point)
    return found


def _joined(
    whole: Scenario,
    scenario: Scenario,
    case: Case,
    system: System,
    simulation: Simulation,
    parts: Parts,
    point: OperatingPoint,
) -> Linearised:
    place, step = "system", _period(parts, scenario.timing, point)
    links = [link for link in system.connections if _in_model(system, link)]
    drives = _drives(scenario, system, parts, links)
    inner = [link for link in links if link.source.component not in parts.sources]
    inner += _inward(parts)
    shown = _shown(scenario, system, simulation, parts)
    single = len(system.parts) == 1
    ins = {_name(end, single): lines for end, lines in drives.items()}
    outs = {_name(end, single): end for end in shown}
    _require_sides(place, ins, outs)
    joint = over_a_period(parts.between, parts.at_instants, inner, ins, outs, step, place)
    if not joint.model.order:
        raise IdentificationError(place, "has no state that inputs reach and outputs show", "drive or record another")
    driving, seen = (
        tuple(_signal(name, end, system, point) for name, end in zip(names, ends, strict=True))
        for names, ends in ((ins, drives), (outs, shown))
    )
    remarks = (*_remarks(whole, case, parts, point, joint), *_left_out(scenario, system))
    where = _where(scenario, parts, point)
    return Linearised(whole.title, joint.model, driving, seen, float(point.time), where, case.name, parts.by, remarks)


def _period(parts: Parts, timing: Timing, point: OperatingPoint) -> float:
    """Over which the model goes: the sample period, or the run's step where nothing samples [s]."""
    periods = parts.periods
    if not periods:
        return float(timing.step)
    first, period = next(iter(periods.items()))
    for name, other in periods.items():
        if not np.isclose(other, period, rtol=1e-9, atol=0):
            problem = f"samples every {other:g} s, and {first} every {period:g} s"
            raise IdentificationError(name, problem, "give both one sample time by --set, or linearise a part of it")
    turns = (float(point.time) - float(timing.start)) / period
    if abs(turns - round(turns)) > 1e-6:
        nearest = float(timing.start) + round(turns) * period
        problem = f"{written(point.time)} s is no instant at which {first} samples, every {period:g} s"
        raise IdentificationError("--at", problem, f"take {nearest:.9g}")
    return period


def _in_model(system: System, link: Connection) -> bool:
    return all(system.port(end).real for end in (link.source, link.target))


def _drives(
    scenario: Scenario, system: System, parts: Parts, links: Sequence[Connection]
) -> dict[Endpoint, list[Connection]]:
    """What drives the system from outside -> what that is connected to: stimuli, sources, inputs left to themselves."""
    stimulated = [end for end in map(Endpoint.parse, scenario.driven) if _is(system.port(end), "input")]
    found = {end: [Connection(end, end)] for end in stimulated}
    for link in links:
        if link.source.component in parts.sources:
            found.setdefault(link.source, []).append(link)
    driven = {link.target for link in system.connections}
    for name, part in system.parts.items():
        for port in part.interface.of("input"):
            end = Endpoint(name, port.name)
            if port.real and end not in driven:
                found.setdefault(end, [Connection(end, end)])
    return found


def _inward(parts: Parts) -> list[Connection]:
    """What those that sample take from their own states in continuous time."""
    both = parts.between.keys() & parts.at_instants.keys()
    return [
        Connection(Endpoint(name, state), Endpoint(name, state))
        for name in sorted(both)
        for state in parts.between[name].states
    ]


def _shown(scenario: Scenario, system: System, simulation: Simulation, parts: Parts) -> list[Endpoint]:
    """The outputs of the model."""
    ends = [Endpoint.parse(name) for name in scenario.recorded(simulation.outputs)]
    return [end for end in ends if _is(system.port(end), "output") and end.component not in parts.sources]


def _left_out(scenario: Scenario, system: System) -> list[str]:
    """What a reader might look for in the model, and why it is not there."""
    recorded = [Endpoint.parse(name) for name in scenario.record or ()]
    others = [str(end) for end in recorded if not _is(system.port(end), "output")]
    found = [f"recorded, but no real output, and so not in the model: {', '.join(others)}"] if others else []
    held = [name for name in scenario.driven if not _is(system.port(Endpoint.parse(name)), "input")]
    found += [f"driven, but no real input, and so as it is at the point: {', '.join(held)}"] if held else []
    cut = [f"{link.source} -> {link.target}" for link in system.connections if not _in_model(system, link)]
    return [*found, *([f"of no real numbers, and so as it is at the point: {', '.join(cut)}"] if cut else [])]


def _is(port: Port, causality: str) -> bool:
    return port.causality == causality and port.real


def _require_sides(place: str, ins: Mapping[str, object], outs: Mapping[str, object]) -> None:
    if not ins:
        raise IdentificationError(place, "is driven by nothing", "leave an input open, or drive it by a stimulus")
    if not outs:
        raise IdentificationError(place, "shows no real output", "record one")
    both = sorted(ins.keys() & outs.keys())
    if both:
        raise IdentificationError(place, f"has an input and an output '{both[0]}'", "rename a component")


def _name(end: Endpoint, single: bool) -> str:
    """An identifier: the variable's name where there is one component, else the component's before it."""
    return re.sub(r"\W+", "_", end.variable if single else f"{end.component}_{end.variable}").strip("_")


def _signal(name: str, end: Endpoint, system: System, point: OperatingPoint) -> ModelSignal:
    unit = system.port(end).unit or ""
    return ModelSignal(name, str(end), unit, point.after[str(end)])


def _where(scenario: Scenario, parts: Parts, point: OperatingPoint) -> str:
    """The point in words."""
    rests = all(part.moving <= SLOW for part in parts.between.values())
    name = "the start of the run" if point.time == scenario.timing.start else "a point of the run"
    return f"{name}, {written(point.time)} s, where it {'rests' if rests else 'moves'}"


def _remarks(whole: Scenario, case: Case, parts: Parts, point: OperatingPoint, joint: JoinedSystem) -> list[str]:
    moving = {name: part.moving for name, part in parts.between.items() if part.moving > SLOW}
    found = []
    if len(whole.cases) > 1:
        which = "the first, " if case == whole.cases[0] else ""
        found.append(f"of {len(whole.cases)} cases it is {which}{case.name}")
    if moving:
        name = max(moving, key=moving.__getitem__)
        found.append(
            f"{name} does not rest at {float(point.time):g} s (a state changes by {moving[name]:.3g} a second): the "
            "model tells small departures from the motion there"
        )
    if joint.hidden:
        found.append(f"left out is what no input reaches or no output shows: states, {joint.hidden}")
    outside = [value for value in joint.whole if abs(value) > UNIT_CIRCLE]
    lost = len(outside) - int(np.count_nonzero(np.abs(joint.model.eigenvalues) > UNIT_CIRCLE))
    if lost > 0:
        found.append(f"{lost} of the states that are left out are unstable")
    if not joint.model.stable:
        found.append(
            f"the model is unstable: its largest pole has the modulus {np.abs(joint.model.eigenvalues).max():.7g}"
        )
    return found
