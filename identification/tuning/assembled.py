"""A study's parts put together and checked: the controller's FMU, linear plants, wiring, goals in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import cast

import numpy as np

from fmus import library
from fmus.errors import IdentificationError, WiringError
from fmus.modelling.model import Model, start_values
from identification.built_system import BuiltSystem
from identification.linear.model import UNIT_CIRCLE, LinearModel
from identification.tuning.goals.goal import Goal, Over, Relative, Signal, StepTest
from identification.tuning.goals.table import MEASURES
from identification.tuning.loops.plants import PlantSet, delayed
from identification.tuning.loops.wiring import Path, Wiring
from identification.tuning.procedures.problem import Controller, Problem
from identification.tuning.sources.fmu_controller import FmuController
from identification.tuning.sources.model_controller import ModelController
from identification.tuning.sources.plants import LinearPlant
from identification.tuning.sources.system_plant import SystemPlant
from identification.tuning.study import CONTROLLER, PLANT, GoalSpec, TuningStudy
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec
from orchestrator.crossing import crossing, named, quantity
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.rational import seconds
from orchestrator.system import Connection, Endpoint, Part, System, check_values, require, wire

FOLLOWING = ("overshoot", "rise time")  # measures of a signal that follows the reference
LONGEST = 1_000_000  # samples of a response
HIDDEN = 1e-8  # singular value, of the largest, below which a mode is not reached or not seen


@dataclass(frozen=True, eq=False)
class Assembled:
    """What a study comes to before anything is sought.

    Attributes:
        built: the controller's FMU, with the study's values.
        interface: of the controller.
        units: of the controller's parameters.
    """

    problem: Problem
    built: BuiltSystem
    interface: Interface
    remarks: tuple[str, ...]


def assembled(study: TuningStudy) -> Assembled:
    """The problem of a study.

    Raises:
        InputError: something in it does not fit together; the message names the place.
    """
    every = float(sample_time(study.controller))
    plants = {name: spec.linear(f"plants.{name}", every) for name, spec in study.plants.items()}
    spec = study.procedure.sized(study.controller, {name: plant.model for name, plant in plants.items()})
    built = BuiltSystem(SystemSpec({CONTROLLER: spec}))
    with OpenSystem(built.assembled) as opened:
        check_values(opened.system, built.assembled.system.values())
        interface = opened.system.parts[CONTROLLER].interface
    typed = built.assembled.system.components[CONTROLLER].parameters
    controller = _controller(replace(spec, parameters=typed), interface)
    study.procedure.check(interface)
    first = next(iter(plants.values()))
    for name, plant in plants.items():
        _require_like(f"plants.{name}", plant, first)
    system, links = _wired(study, interface, first)
    wiring = _wiring(study, system, links, controller, first.model)
    step = controller.step({})
    models = {}
    driven = [first.model.inputs[path.target] for path in wiring.commanded]
    for name, plant in plants.items():
        place = f"plants.{name}"
        _require_step(place, plant.model, step)
        _require_in_reach(place, plant.model, wiring)
        models[name] = delayed(place, plant.model, study.delay, driven)
    drawn = {name: delayed(name, model, study.delay, driven) for name, model in _drawn(study, step).items()}
    goals = tuple(_goal(spec, study, system, wiring, first.model) for spec in study.goals)
    sets = PlantSet.of(models | drawn).parted(len(models))
    share = 1.0 if study.draws is None else study.draws.share
    problem = Problem(sets[0], controller, wiring, _test(study, step), goals, sets[1] if drawn else None, share)
    return Assembled(problem, built, interface, tuple(_remarks(plants)))


def sample_time(spec: ComponentSpec) -> Fraction:
    """Of a controller, before it is built [s]: of an FMU its `step`, or else its parameter `sample_time`.

    Raises:
        InputError: there is no such model or FMU, or it does not tell how it is sampled.
    """
    if spec.fmu is None:
        model = _model(spec)
        if model.sample_time is None:
            problem = f"model '{model.name}' is no sampled controller"
            raise IdentificationError(CONTROLLER, problem, "choose one with `update`, such as pdp")
        given = spec.parameters.get(model.sample_time, start_values(model)[model.sample_time])
        return seconds(quantity_in(given, "s", f"{CONTROLLER}.{model.sample_time}"))
    if spec.step is not None:
        return spec.step
    port = FmuDescription(spec.fmu).interface.ports.get("sample_time")
    known = spec.parameters.get("sample_time", (port.start if port is not None else None) or "")
    if known == "":
        raise IdentificationError(CONTROLLER, "does not tell how often it samples", "give its `step`")
    return seconds(float(known))


def _drawn(study: TuningStudy, step: float) -> dict[str, LinearModel]:
    """Draws of the plants that have a spread, by names of their own.

    Raises:
        IdentificationError: draws are asked for, and no plant has a spread.
    """
    if study.draws is None:
        return {}
    rng = np.random.default_rng(study.draws.seed)
    found: dict[str, LinearModel] = {}
    for name, spec in study.plants.items():
        if isinstance(spec, SystemPlant) and spec.spread.names:
            models = spec.drawn(f"plants.{name}", step, study.draws.count, rng)
            found |= {f"{name}, draw {number}": model for number, model in enumerate(models, 1)}
    if not found:
        fix = "give one a `spread`, or the folder of an output-error calibration"
        raise IdentificationError("draws", "are asked for, and no plant has a spread", fix)
    return found


def _model(spec: ComponentSpec) -> Model:
    source = spec.source
    return library.of_size(source if isinstance(source, Model) else library.find(str(source)), spec.arrays)


def _controller(spec: ComponentSpec, interface: Interface) -> Controller:
    """By its own equations where they are known, by what it answers to pulses where it is an FMU."""
    if spec.fmu is not None:
        return FmuController(CONTROLLER, spec, interface, sample_time(spec))
    return ModelController(CONTROLLER, _model(spec), spec.parameters)


def _require_like(place: str, plant: LinearPlant, first: LinearPlant) -> None:
    """See that a plant has the first one's units."""
    for name, unit in first.units.items():
        if plant.units.get(name, unit) != unit:
            problem = f"{name} is in {plant.units[name]}, and in {unit} of the first plant"
            raise IdentificationError(place, problem, "give all plants the same units")


def _require_step(place: str, model: LinearModel, step: float) -> None:
    if not np.isclose(model.step, step, rtol=1e-6, atol=0):
        raise IdentificationError(
            place,
            f"is sampled every {model.step:.6g} s, and the controller every {step:.6g} s",
            f"set the controller's `sample_time` to {model.step:.6g}, or identify the plant at the controller's",
        )


def _require_in_reach(place: str, model: LinearModel, wiring: Wiring) -> None:
    """See that the controller reaches and sees all modes that do not fade by themselves (the test of Popov, Belevitch
    and Hautus)."""
    driven, seen = {path.target for path in wiring.commanded}, {path.source for path in wiring.measured}
    b, c = model.b[:, sorted(driven)], model.c[sorted(seen)]
    for pole in model.eigenvalues[np.abs(model.eigenvalues) > 1 / UNIT_CIRCLE]:
        shifted = pole * np.eye(model.order) - model.a
        for matrix, problem, fix in (
            (np.hstack([shifted, b]), "is not controllable from", "connect another command, or leave the mode out"),
            (np.vstack([shifted, c]), "is not seen in", "measure another output, or leave the mode out"),
        ):
            values = np.linalg.svd(matrix, compute_uv=False)
            if values[-1] <= HIDDEN * values[0]:
                where = "its commands" if "from" in problem else "what is measured"
                raise IdentificationError(
                    place, f"has the pole {pole:.6g}, which does not fade and {problem} {where}", fix
                )


def _remarks(plants: Mapping[str, LinearPlant]) -> list[str]:
    """What a reader must know of the plants."""
    found = []
    for name, plant in plants.items():
        if not plant.model.stable:
            away = float(np.abs(plant.model.eigenvalues).max())
            found.append(f"plant {name} is unstable by itself (largest modulus of a pole {away:.7g})")
    return found


def _wired(study: TuningStudy, interface: Interface, first: LinearPlant) -> tuple[System, tuple[Connection, ...]]:
    """The system of the controller and a plant, checked as any other."""
    units = first.units
    ports = {name: _port(name, "input", units) for name in first.model.inputs}
    ports |= {name: _port(name, "output", units) for name in first.model.outputs}
    feed_through = dict.fromkeys(first.model.outputs, frozenset[str]())
    plant = Interface(PLANT, "2.0", ports, feed_through)
    system = wire({CONTROLLER: Part(interface), PLANT: Part(plant)}, study.connections, [study.reference])
    for link in system.connections:
        if link.source.component == link.target.component:
            raise WiringError(
                f"{link.source} -> {link.target}", "joins a component to itself", "join plant and controller"
            )
    return system, system.connections


def _port(name: str, causality: str, units: Mapping[str, str]) -> Port:
    return Port(name, 0, "Real", causality, units.get(name), "0" if causality == "input" else None)


def _wiring(
    study: TuningStudy, system: System, links: Sequence[Connection], controller: Controller, plant: LinearModel
) -> Wiring:
    reference, tracked = Endpoint.parse(study.reference, "reference"), Endpoint.parse(study.tracked, "tracked")
    require(system, reference, "input", "can be the reference", "reference")
    require(system, tracked, "output", "can be tracked", "tracked")
    for key, end, wanted in (("reference", reference, CONTROLLER), ("tracked", tracked, PLANT)):
        if end.component != wanted:
            raise WiringError(key, f"'{end}' belongs to the {end.component}", f"name one of the {wanted}")
    measured: list[Path] = []
    commanded: list[Path] = []
    for link in links:
        source, target = (
            (controller.outputs, plant.inputs) if link.target.component == PLANT else (plant.outputs, controller.inputs)
        )
        path = Path(
            str(link.source) + " -> " + str(link.target),
            source.index(link.source.variable),
            target.index(link.target.variable),
            link.factor,
        )
        (commanded if link.target.component == PLANT else measured).append(path)
    if not (measured and commanded):
        missing = "controller -> plant" if measured else "plant -> controller"
        raise WiringError("connections", "make no loop", f"connect {missing}, too")
    sizes = len(controller.inputs), len(controller.outputs), len(plant.inputs), len(plant.outputs)
    numbers = controller.inputs.index(reference.variable), plant.outputs.index(tracked.variable)
    return Wiring(tuple(measured), tuple(commanded), *numbers, sizes)


def _test(study: TuningStudy, step: float) -> StepTest:
    samples = round(study.step.duration / step) + 1
    if not 2 <= samples <= LONGEST:
        raise IdentificationError("step.duration", f"is {samples} samples", f"give 2 to {LONGEST:,}")
    if study.step.height == 0:
        raise IdentificationError("step.height", "is 0", "give the reference a step")
    limit = np.inf if study.step.limit is None else study.step.limit
    return StepTest(study.step.height, samples, study.step.disturbance, limit, study.step.band)


def _goal(spec: GoalSpec, study: TuningStudy, system: System, wiring: Wiring, plant: LinearModel) -> Goal:
    """A goal in numbers."""
    measure, place = MEASURES[spec.measure], spec.place
    signal = None if spec.of is None else _signal(f"{place}.of", spec.of, system, plant)
    if signal is None and "command" in measure.needs:
        command = wiring.commanded[0].target
        signal = Signal(f"{PLANT}.{plant.inputs[command]}", "input", command)
    if signal is None and "signal" in measure.needs:
        signal = Signal(study.tracked, "output", wiring.tracked)
    if spec.measure == "saturation" and study.step.limit is None:
        raise IdentificationError(
            place, "asks for saturation, and `step` has no `limit`", "give it the command's limit"
        )
    if spec.measure in FOLLOWING and (signal is None or signal.side != "output" or signal.number != wiring.tracked):
        raise IdentificationError(
            f"{place}.of", f"'{spec.of}' follows nothing", f"'{spec.measure}' is of what is tracked"
        )
    if signal is not None and "noise" in measure.needs and signal.side != "output":
        raise IdentificationError(f"{place}.of", f"'{spec.of}' is no output of the plant", "name one that is measured")
    disturbed = None
    if spec.disturbed is not None:
        at = _signal(f"{place}.disturbed", spec.disturbed, system, plant)
        if at.side != "input":
            raise IdentificationError(f"{place}.disturbed", f"'{spec.disturbed}' is no input of the plant", "name one")
        disturbed = at.number
    unit = measure.unit
    lower, upper = (_bound(place, key, end, unit) for key, end in (("at_least", spec.lower), ("at_most", spec.upper)))
    if lower is not None and upper is not None and lower > upper:
        raise IdentificationError(place, f"asks for at least {lower:g} and at most {upper:g}", "swap them")
    return Goal(
        spec.measure,
        lower,
        upper,
        spec.weight,
        spec.hard,
        _opened(f"{place}.opened", spec.opened, wiring),
        signal,
        disturbed,
        cast("Relative | None", spec.relative),
        cast("Over", spec.over),
    )


def _signal(place: str, name: str, system: System, plant: LinearModel) -> Signal:
    end = Endpoint.parse(name, place)
    system.port(end, place)
    if end.component == PLANT and end.variable in plant.outputs:
        return Signal(name, "output", plant.outputs.index(end.variable))
    if end.component == PLANT:
        return Signal(name, "input", plant.inputs.index(end.variable))
    for link in system.connections:
        if link.source == end:
            return Signal(name, "input", plant.inputs.index(link.target.variable))
    raise IdentificationError(place, f"'{name}' is no signal of the loop", "name an output or input of the plant")


def _opened(place: str, line: str | None, wiring: Wiring) -> Path | None:
    if line is None:
        return None
    wanted = " ".join(line.split())
    found = next((path for path in wiring.paths if path.name == wanted), None)
    if found is None:
        raise IdentificationError(
            place, f"'{line}' is none of the connections", f"there are {'; '.join(p.name for p in wiring.paths)}"
        )
    return found


def _bound(place: str, key: str, given: float | str | None, unit: str) -> float | None:
    """A bound in the measure's unit."""
    return None if given is None else quantity_in(given, unit, f"{place}.{key}")


def quantity_in(given: Value, unit: str, place: str) -> float:
    """A number, or what a text like `10 dB` means in a unit.

    Raises:
        InputError: it is neither, or in a unit of another quantity.
    """
    if not isinstance(given, str):
        return float(given)
    found = quantity(given)
    if found is None:
        raise IdentificationError(place, f"cannot be '{given}'", "give a number")
    number, name = found
    if name == unit:
        return number
    if not unit or named(name).unit is None or named(unit).unit is None:
        raise IdentificationError(place, f"cannot be in {name}", f"give it in {unit or 'the unit of its signal'}")
    return crossing(place, named(name), named(unit)).conversion(number)
