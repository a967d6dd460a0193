"""A study's parts put together and checked: the controller's FMU, linear plants, wiring, goals in numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction

import numpy as np

from fmus.errors import IdentificationError, WiringError, within
from fmus.modelling.model import start_values
from identification.built_system import BuiltSystem
from identification.linear.model import UNIT_CIRCLE, LinearModel
from identification.tuning.asked import goal, quantity_in, step_test
from identification.tuning.bench import TuningBench
from identification.tuning.loops.plants import PlantSet, alike, delayed
from identification.tuning.loops.wiring import LoopWiring, Path
from identification.tuning.procedures.problem import Controller, TuningProblem
from identification.tuning.procedures.riccati import unreached, unseen
from identification.tuning.sources.calibrated_model import CalibratedPlant
from identification.tuning.sources.fmu_controller import FmuController
from identification.tuning.sources.model_controller import ModelController
from identification.tuning.sources.plants import LinearPlant
from identification.tuning.sources.system_plant import SystemPlant
from identification.tuning.sources.varied import varied
from identification.tuning.study import CONTROLLER, PLANT, TuningStudy
from orchestrator.assembly.assembly import ComponentSpec, OpenSystem, SystemSpec, model_of
from orchestrator.assembly.wiring import wire
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.rational import seconds
from orchestrator.settable import check_values, typed
from orchestrator.system import Connection, Endpoint, Part, System, require


@dataclass(frozen=True, eq=False)
class AssembledTuning:
    """What a study comes to before anything is sought.

    Attributes:
        built: the controller's FMU, with the study's values.
        interface: of the controller.
        units: of those of the plants' inputs and outputs that have one.
        unseen: as many draws as the problem has, which nothing is fitted to; None without draws.
        between: what lies between plants that differ in one parameter, and the name of that; None where they do not.
    """

    problem: TuningProblem
    built: BuiltSystem
    interface: Interface
    remarks: tuple[str, ...]
    units: Mapping[str, str]
    unseen: PlantSet | None
    between: tuple[str, PlantSet] | None


def assembled(study: TuningStudy) -> AssembledTuning:
    """The problem of a study.

    Raises:
        InputError: something in it does not fit together; the message names the place.
    """
    every = float(sample_time(study.controller))
    plants = {name: spec.linear(f"plants.{name}", every) for name, spec in study.plants.items()}
    driven = _driven(study)
    models = {name: delayed(f"plants.{name}", plant.model, study.delay, driven) for name, plant in plants.items()}
    spec = study.procedure.sized(study.controller, models)
    built = BuiltSystem(SystemSpec({CONTROLLER: spec}))
    with OpenSystem(built.assembled) as opened:
        check_values(opened.system, built.assembled.system.values())
        interface = opened.system.parts[CONTROLLER].interface
        around = {name: _around(opened.system, name, values) for name, values in study.around.items()}
    own = built.assembled.system.components[CONTROLLER].parameters
    controller = _controller(replace(spec, parameters=own), interface)
    study.procedure.check(interface)
    first = next(iter(plants.values()))
    for name, plant in plants.items():
        _require_like(f"plants.{name}", plant, first)
    system, links = _wired(study, interface, first)
    wiring = _wiring(study, system, links, controller, first.model)
    step = controller.step({})
    for name, plant in plants.items():
        place = f"plants.{name}"
        _require_step(place, plant.model, step)
        _require_in_reach(place, plant.model, wiring)
    draws = _drawn(study, step)
    drawn = {name: delayed(name, model, study.delay, driven) for of in draws.values() for name, model in of.items()}
    around |= {name: around[plant] for plant, of in draws.items() if plant in around for name in of}
    goals = tuple(goal(asked, study.step, system, wiring, first.model) for asked in study.goals)
    taken = alike(models | drawn)
    nominal, sought, unseen = _parted(PlantSet.of(taken), len(models))
    problem = TuningProblem(
        plants=nominal,
        controller=controller,
        wiring=wiring,
        test=step_test(study.step, step),
        goals=goals,
        draws=sought,
        share=1.0 if study.draws is None else study.draws.share,
        models={name: taken[name] for name in models},
        bench=TuningBench(replace(spec, parameters=own), study, first.units, sample_time(study.controller)),
        around=around,
    )
    return AssembledTuning(
        problem, built, interface, tuple(_remarks(plants)), first.units, unseen, _between(study, step)
    )


def _driven(study: TuningStudy) -> list[str]:
    """The plants' inputs that connections drive."""
    ends = [Endpoint.parse(target, f"{source} -> {target}") for source, target in study.connections]
    return list(dict.fromkeys(end.variable for end in ends if end.component == PLANT))


def sample_time(spec: ComponentSpec) -> Fraction:
    """Of a controller, before it is built [s]: of an FMU its `step`, or else its parameter `sample_time`.

    Raises:
        InputError: there is no such model or FMU, or it does not tell how it is sampled.
    """
    if spec.fmu is None:
        model = model_of(spec)
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


def _around(system: System, plant: str, values: Mapping[str, Value]) -> dict[str, float]:
    """Values that the controller has around a plant, checked as any others."""
    given = {f"{CONTROLLER}.{name}": value for name, value in values.items()}
    with within(f"plants.{plant}"):
        found = typed(system, given)
        check_values(system, found)
    return {name: float(found[f"{CONTROLLER}.{name}"]) for name in values}


def _drawn(study: TuningStudy, step: float) -> dict[str, dict[str, LinearModel]]:
    """Plant -> draws of it, where it has a spread, by names of their own: every second one is for the search."""
    if study.draws is None:
        return {}
    rng = np.random.default_rng(study.draws.seed)
    found: dict[str, dict[str, LinearModel]] = {}
    for name, spec in study.plants.items():
        if isinstance(spec, SystemPlant | CalibratedPlant) and spec.uncertain:
            models = spec.drawn(f"plants.{name}", step, 2 * study.draws.count, rng)
            found[name] = {f"{name}, draw {number}": model for number, model in enumerate(models, 1)}
    if not found:
        fix = (
            "give one a `spread`, or the folder of an output-error study, or of a subspace study that refines its model"
        )
        raise IdentificationError("draws", "are asked for, and no plant has a spread", fix)
    return found


def _between(study: TuningStudy, step: float) -> tuple[str, PlantSet] | None:
    found, driven = None if study.around else varied(study.plants, step), _driven(study)
    if found is None:
        return None
    models = {
        f"{value:g}": delayed("plants", model, study.delay, driven)
        for value, model in zip(found.values, found.models, strict=True)
    }
    return found.name, PlantSet.of(alike(models))


def _parted(plants: PlantSet, first: int) -> tuple[PlantSet, PlantSet | None, PlantSet | None]:
    """The plants themselves, the draws that a search sees, and those that it does not."""
    nominal, drawn = plants.parted(first)
    if not len(drawn):
        return nominal, None, None
    return nominal, drawn.only(range(0, len(drawn), 2)), drawn.only(range(1, len(drawn), 2))


def _controller(spec: ComponentSpec, interface: Interface) -> Controller:
    """By its own equations where they are known, by what it answers to pulses where it is an FMU."""
    if spec.fmu is not None:
        return FmuController(CONTROLLER, spec, interface, sample_time(spec))
    return ModelController(CONTROLLER, model_of(spec), spec.parameters)


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


def _require_in_reach(place: str, model: LinearModel, wiring: LoopWiring) -> None:
    """See that the controller reaches and sees all modes that do not fade by themselves."""
    driven, seen = {path.target for path in wiring.commanded}, {path.source for path in wiring.measured}
    for poles, lacking, fix in (
        (unreached(model.a, model.b[:, sorted(driven)]), "controllable from its commands", "connect another command"),
        (unseen(model.a, model.c[sorted(seen)]), "seen in what is measured", "measure another output"),
    ):
        for pole in poles[np.abs(poles) > 1 / UNIT_CIRCLE]:
            problem = f"has the pole {pole:.6g}, which does not fade and is not {lacking}"
            raise IdentificationError(place, problem, f"{fix}, or leave the mode out")


def _remarks(plants: Mapping[str, LinearPlant]) -> list[str]:
    """What a reader must know of the plants."""
    found: list[str] = []
    for name, plant in plants.items():
        found += plant.remarks
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
) -> LoopWiring:
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
    return LoopWiring(tuple(measured), tuple(commanded), *numbers, sizes)
