"""A study of tuning from its parts to values, judged."""

from __future__ import annotations

from dataclasses import dataclass

from identification.estimation.threads import single_threaded
from identification.tuning.assembled import Assembled, assembled
from identification.tuning.procedures.problem import Judgement, Problem
from identification.tuning.procedures.procedure import Found
from identification.tuning.study import TuningStudy
from orchestrator.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Tuning:
    """What a study gave.

    Attributes:
        unseen: what the values do with draws that they were not fitted to, where there are draws.
    """

    study: TuningStudy
    parts: Assembled
    found: Found
    unseen: Judgement | None

    @property
    def problem(self) -> Problem:
        """Plants, controller and goals."""
        return self.parts.problem

    @property
    def remarks(self) -> list[str]:
        """What a reader of the figures must know."""
        return [*self.parts.remarks, *self.found.remarks]


@single_threaded
def tune(study: TuningStudy, progress: Progress = silent) -> Tuning:
    """The values that a study's procedure comes to.

    Raises:
        InputError: the study's parts do not fit together.
    """
    parts = assembled(study)
    found = study.procedure.run(parts.problem, parts.interface, progress)
    parts.problem.controller.require_slopes(found.best.values)
    unseen = None if parts.unseen is None else parts.problem.on(parts.unseen).judged(found.best.values)
    return Tuning(study, parts, found, unseen)
