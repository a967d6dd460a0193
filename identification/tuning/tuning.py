"""A study of tuning from its parts to values, judged."""

from __future__ import annotations

from dataclasses import dataclass

from identification.estimation.threads import single_threaded
from identification.tuning.assembled import Assembled, assembled
from identification.tuning.procedures.problem import Problem
from identification.tuning.procedures.procedure import Found
from identification.tuning.study import TuningStudy
from orchestrator.progress import Progress, silent


@dataclass(frozen=True, eq=False)
class Tuning:
    """What a study gave."""

    study: TuningStudy
    parts: Assembled
    found: Found

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
    return Tuning(study, parts, found)
