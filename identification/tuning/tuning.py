"""A study of tuning from its parts to values, judged."""

from __future__ import annotations

from dataclasses import dataclass

from identification.estimation.threads import single_threaded
from identification.tuning.assembled import AssembledTuning, assembled
from identification.tuning.outcome import TuningOutcome
from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from identification.tuning.study import TuningStudy
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Tuning(TuningOutcome):
    """What a study gave.

    Attributes:
        unseen: what the values do with draws that they were not fitted to, where there are draws.
    """

    study: TuningStudy
    parts: AssembledTuning
    unseen: CandidateJudgement | None

    @property
    def problem(self) -> TuningProblem:
        """Plants, controller and goals."""
        return self.parts.problem

    @property
    def names(self) -> tuple[str, ...]:
        """Of the plants."""
        return self.problem.plants.names

    @property
    def remarks(self) -> list[str]:
        """What a reader of the figures must know."""
        return [*self.parts.remarks, *self.found.remarks]


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
    return Tuning(study, parts.built, parts.interface, found, parts, unseen).on_rigs(progress, isolation)
