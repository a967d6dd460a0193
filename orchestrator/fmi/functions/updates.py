"""What a co-simulation FMU of FMI 3.0 calls between communication points (intermediate update)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, TypedDict


class UpdateArguments(TypedDict, total=False):
    """What instances are made with, as FMPy calls it."""

    intermediateUpdate: IntermediateUpdates
    requiredIntermediateVariables: tuple[int, ...]


@dataclass
class IntermediateUpdates:
    """Takes the calls; nothing is set in them, and no early return is asked for.

    Attributes:
        references: value references of what is asked for in them.
        take: given the time [s] and whether a step of the FMU's own is finished, when values can be got; says what is
            amiss.
        problem: the first that was amiss in a run, nothing where all went well.
    """

    references: tuple[int, ...]
    take: Callable[[float, bool], str]
    problem: str = field(default="", init=False)

    def __call__(
        self, environment: Any, time: float, wanted: bool, given: bool, finished: bool, may_return: bool, *asked: Any
    ) -> None:
        early, _ = asked
        if early:
            early[0] = False
        if given and not self.problem:
            try:
                self.problem = self.take(time, finished)
            except Exception as error:  # it would be lost in the FMU's call
                self.problem = str(error)

    def arguments(self) -> UpdateArguments:
        """What instances are made with."""
        return {"intermediateUpdate": self, "requiredIntermediateVariables": self.references}
