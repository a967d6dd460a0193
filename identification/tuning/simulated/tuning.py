"""A study of tuning on simulated closed loops, from its parts to values, judged."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError, WiringError
from identification.built_system import BuiltSystem
from identification.estimation.threads import single_threaded
from identification.tuning.asked import FOLLOWING, bound
from identification.tuning.goals.goal import Goal, LoopSignal
from identification.tuning.goals.table import MEASURES
from identification.tuning.outcome import TuningOutcome
from identification.tuning.simulated.plants import SimulatedLoop
from identification.tuning.simulated.problem import SimulatedProblem
from identification.tuning.simulated.search import searched
from identification.tuning.simulated.study import SimulatedStudy
from identification.tuning.study import CONTROLLER, GoalSpec
from orchestrator.assembly.assembly import OpenSystem, SystemSpec
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.settable import check_values


@dataclass(frozen=True, eq=False)
class SimulatedTuning(TuningOutcome):
    """What a study gave."""

    study: SimulatedStudy
    problem: SimulatedProblem

    @property
    def names(self) -> tuple[str, ...]:
        """Of the plants."""
        return tuple(self.problem.loops)

    @property
    def remarks(self) -> list[str]:
        """What a reader of the figures must know."""
        failed = self.problem.failures
        return [f"{len(said)} runs of {name} failed on the way, last: {said[-1]}" for name, said in failed.items()]


@single_threaded
def tune(study: SimulatedStudy, progress: Progress = silent, isolation: Isolation | None = None) -> SimulatedTuning:
    """The values that the study's search comes to, and how they do on its rigs.

    Args:
        isolation: of FMUs given as files; a run that crashes or hangs counts as one that fails.

    Raises:
        InputError: the study's parts do not fit together.
        FmuError: an FMU cannot be opened or run at all.
    """
    for number, rig in enumerate(study.rigs):
        rig.check(f"judged_on.{number}")
    built = BuiltSystem(SystemSpec({CONTROLLER: study.controller}))
    with OpenSystem(built.assembled) as opened:
        check_values(opened.system, built.assembled.system.values())
        interface = opened.system.parts[CONTROLLER].interface
    study.search.check(interface)
    problem = _problem(study, built, isolation)
    found = searched(study.search, problem, interface, progress)
    if problem.refused and not found.best.stable:
        raise problem.refused[0]
    return SimulatedTuning(study, built, interface, found, problem).on_rigs(progress, isolation)


def _problem(study: SimulatedStudy, built: BuiltSystem, isolation: Isolation | None) -> SimulatedProblem:
    goals = tuple(_goal(spec, study) for spec in study.goals)
    named = [study.reference, study.tracked, *(goal.signal.name for goal in goals if goal.signal is not None)]
    signals, values = list(dict.fromkeys(named)), built.assembled.system.components[CONTROLLER].parameters
    loops = {}
    for name, spec in study.plants.items():
        file = built.assembled.files[CONTROLLER]
        loop = SimulatedLoop(f"plants.{name}", spec, file, values, signals, isolation)
        units = {signal: loop.unit(signal, f"plants.{name}") for signal in (study.reference, study.tracked)}
        if len({unit for unit in units.values() if unit}) > 1:
            problem = f"is in {units[study.tracked]}, and {study.reference} in {units[study.reference]}"
            raise WiringError(f"plants.{name}: {study.tracked}", problem, "track a signal in the reference's unit")
        loops[name] = loop
    limit = np.inf if study.limit is None else study.limit
    return SimulatedProblem(loops, study.reference, study.tracked, study.band, limit, goals)


def _goal(spec: GoalSpec, study: SimulatedStudy) -> Goal:
    """A goal in numbers."""
    measure = MEASURES[spec.measure]
    name = spec.of or (study.command if "command" in measure.needs else study.tracked)
    if name is None:
        raise IdentificationError(spec.place, f"'{spec.measure}' is of the command", "name it by `command`")
    if spec.measure == "saturation" and study.limit is None:
        raise IdentificationError(spec.place, "asks for saturation, and there is no `limit`", "give the command's")
    if spec.measure in FOLLOWING and name != study.tracked:
        problem = f"'{name}' follows nothing"
        raise IdentificationError(f"{spec.place}.of", problem, f"'{spec.measure}' is of what is tracked")
    lower, upper = (
        bound(spec.place, key, end, measure.unit) for key, end in (("at_least", spec.lower), ("at_most", spec.upper))
    )
    signal = LoopSignal(name, "output", 0)
    return Goal(spec.measure, lower, upper, spec.weight, spec.hard, None, signal, None, spec.relative, spec.over)
