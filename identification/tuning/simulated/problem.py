"""Candidates judged on simulated closed loops."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fmus.errors import FmuError, ParametersRefused
from identification.tuning.goals.goal import Goal
from identification.tuning.goals.responses import MEASURES
from identification.tuning.procedures.problem import FURTHEST, CandidateJudgement
from identification.tuning.simulated.moves import Move
from identification.tuning.simulated.plants import SimulatedLoop
from orchestrator.engine import RunFailed

FAILED = 2.0  # in place of a modulus, of a loop whose run failed at once; less where it came further


@dataclass(frozen=True, eq=False)
class SimulatedProblem:
    """Closed loops, and what is asked of them.

    Attributes:
        failures: what was said of runs that failed, by the plant's name.
        refused: what FMUs have said that did not take their parameters.
    """

    loops: Mapping[str, SimulatedLoop]
    reference: str
    tracked: str
    band: float
    limit: float
    goals: tuple[Goal, ...]
    failures: dict[str, list[str]] = field(default_factory=dict)
    refused: list[ParametersRefused] = field(default_factory=list)

    def judged(self, values: Mapping[str, float]) -> CandidateJudgement:
        """What these parameters do; a loop whose run fails counts as unstable, and there are no figures of it."""
        count = len(self.loops)
        figures, missed = (np.full((len(self.goals), count), np.nan) for _ in range(2))
        radius = np.zeros(count)
        for j, name in enumerate(self.loops):
            try:
                trace = self.loops[name].run(values)
            except FmuError as error:
                if isinstance(error, ParametersRefused):
                    self.refused.append(error.within(f"plants.{name}"))
                self.failures.setdefault(name, []).append(str(error))
                radius[j] = FAILED - _share(error, self.loops[name].duration)
                continue
            move = Move(f"plants.{name}", trace, self.reference, self.tracked, self.band, self.limit)
            for i, goal in enumerate(self.goals):
                figures[i, j] = found = MEASURES[goal.measure].figures(move, goal)[0]
                missed[i, j] = np.clip(goal.missed(np.array([found]))[0], -FURTHEST, FURTHEST)
        return CandidateJudgement(dict(values), self.goals, figures, missed, radius, count)


def _share(error: FmuError, duration: float) -> float:
    """How far of a run that failed, below 1."""
    if not isinstance(error, RunFailed):
        return 0.0
    return min((error.result.account.reached - error.result.account.start) / duration, 0.99)
