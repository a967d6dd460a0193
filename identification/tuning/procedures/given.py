"""The controller with the values that the study gives it: nothing is sought, its goals are judged."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from identification.linear.model import LinearModel
from identification.tuning.procedures.problem import TuningProblem
from identification.tuning.procedures.procedure import Found
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Interface
from orchestrator.progress import Progress


@dataclass(frozen=True)
class GivenProcedure:
    """What is given is taken; see `procedure.Procedure`."""

    def sized(self, controller: ComponentSpec, plants: Mapping[str, LinearModel]) -> ComponentSpec:
        """The controller as it is."""
        return controller

    def check(self, interface: Interface) -> None:
        """Nothing is sought, and so nothing can be missing."""

    def run(self, problem: TuningProblem, interface: Interface, progress: Progress) -> Found:
        """The controller's own values, judged."""
        drawn = None if problem.draws is None else problem.on(problem.draws).judged({})
        return Found(problem.judged({}), {}, drawn=drawn, share=problem.share)
