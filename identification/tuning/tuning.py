"""A study of tuning from its parts to values, judged."""

from __future__ import annotations

from dataclasses import dataclass, replace

from identification.estimation.threads import single_threaded
from identification.method import CalibratedFmu
from identification.tuning.assembled import AssembledTuning, assembled
from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from identification.tuning.procedures.procedure import Found
from identification.tuning.study import CONTROLLER, TuningStudy
from orchestrator.fmi.interface import Interface
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.scenario.run import ScenarioResult
from orchestrator.system import dotted_values


@dataclass(frozen=True, eq=False)
class Tuning:
    """What a study gave.

    Attributes:
        unseen: what the values do with draws that they were not fitted to, where there are draws.
        rigs: how the controller did in the scenarios on which the study has it judged.
    """

    study: TuningStudy
    parts: AssembledTuning
    found: Found
    unseen: CandidateJudgement | None
    rigs: tuple[ScenarioResult, ...] = ()

    @property
    def problem(self) -> TuningProblem:
        """Plants, controller and goals."""
        return self.parts.problem

    @property
    def names(self) -> tuple[str, ...]:
        """Of the plants."""
        return self.problem.plants.names

    @property
    def interface(self) -> Interface:
        """Of the controller."""
        return self.parts.interface

    @property
    def remarks(self) -> list[str]:
        """What a reader of the figures must know."""
        return [*self.parts.remarks, *self.found.remarks]

    @property
    def values(self) -> dict[str, float]:
        """controller.parameter -> value that was found."""
        return dotted_values(CONTROLLER, self.found.best.values)

    @property
    def controller(self) -> CalibratedFmu:
        """The controller's FMU with the study's values and those that were found."""
        return self.parts.built.calibrated(self.values)[CONTROLLER]


@single_threaded
def tune(study: TuningStudy, progress: Progress = silent, isolation: Isolation | None = None) -> Tuning:
    """The values that a study's procedure comes to, and how they do on the study's rigs.

    Args:
        isolation: of FMUs given as files on the rigs; a case in which one crashes or hangs has failed.

    Raises:
        InputError: the study's parts do not fit together.
        FmuError: FMUs fail, but for a case on a rig, which has then failed.
    """
    for number, rig in enumerate(study.rigs):
        rig.check(f"judged_on.{number}")
    parts = assembled(study)
    found = study.procedure.run(parts.problem, parts.interface, progress)
    parts.problem.require_slopes(found.best.values)
    unseen = None if parts.unseen is None else parts.problem.on(parts.unseen).judged(found.best.values)
    result = Tuning(study, parts, found, unseen)
    return replace(
        result, rigs=tuple(rig.judged(result.controller, found.best.values, progress, isolation) for rig in study.rigs)
    )
