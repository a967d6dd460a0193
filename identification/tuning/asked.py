"""What a study asks, in numbers: its goals with their signals and bounds, and the steps that responses answer to."""

from __future__ import annotations

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.tuning.goals.goal import Goal, LoopSignal, StepTest
from identification.tuning.goals.table import MEASURES
from identification.tuning.loops.wiring import LoopWiring, Path
from identification.tuning.study import PLANT, GoalSpec, StepSpec
from orchestrator.crossing import crossing, named, quantity
from orchestrator.fmi.interface import Value
from orchestrator.system import Endpoint, System

FOLLOWING = ("overshoot", "rise time")  # measures of a signal that follows the reference
LONGEST = 1_000_000  # samples of a response


def step_test(spec: StepSpec, step: float) -> StepTest:
    """The steps, for loops that are sampled every `step` [s].

    Raises:
        IdentificationError: it is none, too short or too long.
    """
    samples = round(spec.duration / step) + 1
    if not 2 <= samples <= LONGEST:
        raise IdentificationError("step.duration", f"is {samples} samples", f"give 2 to {LONGEST:,}")
    if spec.height == 0:
        raise IdentificationError("step.height", "is 0", "give the reference a step")
    limit = np.inf if spec.limit is None else spec.limit
    return StepTest(spec.height, samples, spec.disturbance, limit, spec.band)


def goal(spec: GoalSpec, step: StepSpec, system: System, wiring: LoopWiring, plant: LinearModel) -> Goal:
    """A goal in numbers.

    Raises:
        InputError: it names what is not there, or a bound in a unit of another quantity.
    """
    measure, place = MEASURES[spec.measure], spec.place
    signal = None if spec.of is None else _signal(f"{place}.of", spec.of, system, plant)
    if signal is None and "command" in measure.needs:
        command = wiring.commanded[0].target
        signal = LoopSignal(f"{PLANT}.{plant.inputs[command]}", "input", command)
    if signal is None and "signal" in measure.needs:
        signal = LoopSignal(f"{PLANT}.{plant.outputs[wiring.tracked]}", "output", wiring.tracked)
    if spec.measure == "saturation" and step.limit is None:
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
    lower, upper = (bound(place, key, end, unit) for key, end in (("at_least", spec.lower), ("at_most", spec.upper)))
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
        spec.relative,
        spec.over,
    )


def _signal(place: str, name: str, system: System, plant: LinearModel) -> LoopSignal:
    end = Endpoint.parse(name, place)
    system.port(end, place)
    if end.component == PLANT and end.variable in plant.outputs:
        return LoopSignal(name, "output", plant.outputs.index(end.variable))
    if end.component == PLANT:
        return LoopSignal(name, "input", plant.inputs.index(end.variable))
    for link in system.connections:
        if link.source == end:
            return LoopSignal(name, "input", plant.inputs.index(link.target.variable))
    raise IdentificationError(place, f"'{name}' is no signal of the loop", "name an output or input of the plant")


def _opened(place: str, line: str | None, wiring: LoopWiring) -> Path | None:
    if line is None:
        return None
    wanted = " ".join(line.split())
    found = next((path for path in wiring.paths if path.name == wanted), None)
    if found is None:
        raise IdentificationError(
            place, f"'{line}' is none of the connections", f"there are {'; '.join(p.name for p in wiring.paths)}"
        )
    return found


def bound(place: str, key: str, given: float | str | None, unit: str) -> float | None:
    """A bound in the measure's unit.

    Raises:
        InputError: it is in a unit of another quantity.
    """
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
