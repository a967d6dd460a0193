"""The contract of a procedure: from a problem to a controller's values.

A new one is a file of this room with a frozen class that keeps `Procedure`, and a block in `schema` whose `by` names it
and whose `procedure()` gives it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from identification.linear.model import LinearModel
from identification.tuning.procedures.problem import CandidateJudgement, TuningProblem
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Interface
from orchestrator.progress import Progress
from orchestrator.trace import FloatArray

HELD = 1e-6  # of its size, by which a goal that binds may be missed for rounding
NEAR = 1e-2  # of its size, within which a goal that is held binds


@dataclass(frozen=True, eq=False)
class Descent:
    """Where one start of a search led."""

    start: Mapping[str, float]
    found: CandidateJudgement
    evaluations: int


@dataclass(frozen=True, eq=False)
class Trade:
    """What a hard goal costs.

    Attributes:
        goal: its number.
        asked: (K,) bounds of it, rising, the study's own in the middle.
        best: the K optima under these.
    """

    goal: int
    asked: FloatArray
    best: tuple[CandidateJudgement, ...]


@dataclass(frozen=True, eq=False)
class Found:
    """What a procedure came to.

    Attributes:
        best: the candidate that is taken; where none holds all hard goals the one that misses least.
        starts: parameter -> where its search began, of those that were searched.
        descents: one a start, of a search.
        agreeing: how many starts led to what is taken.
        remarks: what a reader must know.
        drawn: what the values do to the hard goals with all draws of the problem, where there are some.
        share: of these that has to hold the hard goals.
        figures: what else the procedure has found out, in words -> a figure.
        trades: of the goals that bind, where a search has found them.
    """

    best: CandidateJudgement
    starts: Mapping[str, float]
    descents: tuple[Descent, ...] = ()
    agreeing: int = 1
    remarks: tuple[str, ...] = ()
    drawn: CandidateJudgement | None = None
    share: float = 1.0
    figures: Mapping[str, float] = field(default_factory=dict)
    trades: tuple[Trade, ...] = ()

    @property
    def feasible(self) -> bool:
        """Whether all loops are stable and hold all hard goals, but for rounding, and enough of the draws do."""
        return self.best.most_missed <= HELD and (self.drawn is None or held_share(self.drawn) >= self.share)

    @property
    def binding(self) -> tuple[tuple[int, int], ...]:
        """(goal, plant) of hard goals at their bounds, or of those missed most; goal -1 is an unstable loop."""
        best = self.best
        if not best.stable:
            return tuple((-1, int(i)) for i in np.flatnonzero(~(best.radius < 1.0)))
        most = max(best.most_missed, 0.0)
        return tuple((i, int(j)) for i in best.hard for j in np.flatnonzero(best.missed[i] >= most - NEAR))


def held_share(drawn: CandidateJudgement) -> float:
    """The share of loops that are stable and hold all hard goals, but for rounding."""
    return float(np.mean(drawn.misses <= HELD))


class Procedure(Protocol):
    """A way to find a controller's values."""

    def sized(self, controller: ComponentSpec, plants: Mapping[str, LinearModel]) -> ComponentSpec:
        """The controller as it fits these plants, before it is built: with arrays of the right size."""

    def check(self, interface: Interface) -> None:
        """See that the controller has what is sought.

        Raises:
            InputError: it has not.
        """

    def run(self, problem: TuningProblem, interface: Interface, progress: Progress) -> Found:
        """The values that it comes to, judged."""
