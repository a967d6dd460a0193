"""What procedures share: plants, a controller whose values are sought, goals, and the judgement of candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from identification.linear.model import LinearModel
from identification.tuning.goals.goal import Goal, StepTest, Trial
from identification.tuning.goals.table import MEASURES
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet
from identification.tuning.loops.wiring import Wiring
from orchestrator.trace import FloatArray

UNSTABLE = 10.0  # by how much an unstable loop counts as missed, above every other miss
FURTHEST = 1e3  # what a miss counts at most, and a figure that there is none of
AWAY = 1000.0  # what is added to that, for each 1 that the largest modulus is above 1


class Controller(Protocol):
    """A controller that is linear where it rests.

    Attributes:
        inputs, outputs: names of its variables.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    def step(self, values: Mapping[str, float]) -> float:
        """Its sampling time [s] with these parameters."""

    def linear(self, values: Mapping[str, float]) -> LinearModel:
        """Its matrices with these parameters."""

    def require_slopes(self, values: Mapping[str, float]) -> None:
        """See that it is as good as linear with these parameters."""


@dataclass(frozen=True, eq=False)
class Judgement:
    """What a candidate does.

    Attributes:
        values: parameter -> value of the controller.
        goals: the G goals.
        figures: (G, N) of each goal and plant, nan where the loop is unstable.
        missed: (G, N) by how much of a goal's size it is missed, not positive where it is held; see `Goal.missed`.
        radius: (N,) largest modulus of a closed-loop pole.
    """

    values: Mapping[str, float]
    goals: tuple[Goal, ...]
    figures: FloatArray
    missed: FloatArray
    radius: FloatArray

    @property
    def stable(self) -> bool:
        """Whether all loops are."""
        return bool(np.all(self.radius < 1.0))

    @property
    def hard(self) -> list[int]:
        """Numbers of the goals that have to be held."""
        return [i for i, goal in enumerate(self.goals) if goal.hard and not goal.minimised]

    @cached_property
    def most_missed(self) -> float:
        """By how much the hard goal is missed that is missed most; not positive where all are held."""
        if not self.stable:
            return UNSTABLE + AWAY * float(np.nan_to_num(self.radius, nan=1e6, posinf=1e6).max() - 1.0)
        return float(np.max(self.missed[self.hard], initial=-np.inf))

    @property
    def feasible(self) -> bool:
        """Whether all loops are stable and hold all hard goals."""
        return self.stable and self.most_missed <= 0

    @cached_property
    def objective(self) -> float:
        """Weighted sum of what is minimised, and of the squared misses of soft goals; inf for an unstable loop."""
        if not self.stable:
            return np.inf
        total = 0.0
        for goal, figures, missed in zip(self.goals, self.figures, self.missed, strict=True):
            if goal.minimised:
                counted = np.minimum(figures, FURTHEST)
                total += goal.weight * float(counted.sum() if goal.over == "sum" else counted.max())
            elif not goal.hard:
                total += goal.weight * float((np.maximum(missed, 0.0) ** 2).sum())
        return total


@dataclass(frozen=True, eq=False)
class Problem:
    """Plants, the controller, how they are wired, and what is asked."""

    plants: PlantSet
    controller: Controller
    wiring: Wiring
    test: StepTest
    goals: tuple[Goal, ...]

    def only(self, numbers: Sequence[int]) -> Problem:
        """The same for some of the plants."""
        return replace(self, plants=self.plants.only(numbers))

    def trial(self, values: Mapping[str, float]) -> Trial:
        """The loops with these parameters of the controller."""
        return Trial(Loops(self.plants, self.controller.linear(values), self.wiring), self.test)

    def judged(self, values: Mapping[str, float]) -> Judgement:
        """What these parameters do."""
        trial = self.trial(values)
        count = len(self.plants)
        figures = np.full((len(self.goals), count), np.nan)
        missed = np.full((len(self.goals), count), np.nan)
        if trial.loops.stable.all():
            for i, goal in enumerate(self.goals):
                figures[i] = MEASURES[goal.measure].figures(trial, goal)
                missed[i] = np.clip(goal.missed(figures[i]), -FURTHEST, FURTHEST)
        return Judgement(dict(values), self.goals, figures, missed, trial.loops.radius)
