"""What procedures share: plants, a controller whose values are sought, goals, and the judgement of candidates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from identification.linear.model import LinearModel
from identification.tuning.goals.goal import Goal, LoopTrial, StepTest
from identification.tuning.goals.table import MEASURES
from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet
from identification.tuning.loops.wiring import LoopWiring
from orchestrator.trace import FloatArray

UNSTABLE = 10.0  # by how much an unstable loop counts as missed, above every other miss
FURTHEST = 1e3  # what a miss counts at most, and a figure that there is none of
AWAY = 1000.0  # what is added to that, for each 1 that the largest modulus is above 1


class Controller(Protocol):
    """A controller that is linear where it rests.

    Attributes:
        inputs, outputs: names of its variables.
    """

    @property
    def inputs(self) -> tuple[str, ...]: ...

    @property
    def outputs(self) -> tuple[str, ...]: ...

    def step(self, values: Mapping[str, float]) -> float:
        """Its sampling time [s] with these parameters."""

    def linear(self, values: Mapping[str, float]) -> LinearModel:
        """Its matrices with these parameters."""

    def require_slopes(self, values: Mapping[str, float]) -> None:
        """See that it is as good as linear with these parameters."""


class StepBench(Protocol):
    """The controller's FMU around that of a linear plant."""

    def followed(self, plant: LinearModel, values: Mapping[str, float], height: float, samples: int) -> FloatArray:
        """(K,) what is tracked after a step of the reference, in a run of both FMUs."""


@dataclass(frozen=True, eq=False)
class CandidateJudgement:
    """What a candidate does.

    Attributes:
        values: parameter -> value of the controller.
        goals: the G goals.
        figures: (G, N) of each goal and plant, nan where the loop is unstable.
        missed: (G, N) by how much of a goal's size it is missed, not positive where it is held; see `Goal.missed`.
        radius: (N,) largest modulus of a closed-loop pole.
        counted: how many of the plants, from the first on, make the objective; the others only have to hold goals.
    """

    values: Mapping[str, float]
    goals: tuple[Goal, ...]
    figures: FloatArray
    missed: FloatArray
    radius: FloatArray
    counted: int

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
        return float(np.max(self.misses, initial=-np.inf))

    @property
    def misses(self) -> FloatArray:
        """(N,) by how much each loop misses the hard goal that it misses most; `FURTHEST` where it is unstable."""
        worst = self.missed[self.hard].max(axis=0, initial=-FURTHEST)
        return np.where(self.radius < 1.0, worst, FURTHEST)

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
        columns = slice(0, self.counted)
        for goal, figures, missed in zip(self.goals, self.figures[:, columns], self.missed[:, columns], strict=True):
            if goal.minimised:
                counted = np.minimum(figures, FURTHEST)
                total += goal.weight * float(counted.sum() if goal.over == "sum" else counted.max())
            elif not goal.hard:
                total += goal.weight * float((np.maximum(missed, 0.0) ** 2).sum())
        return total


@dataclass(frozen=True, eq=False)
class TuningProblem:
    """Plants, the controller, how they are wired, and what is asked.

    Attributes:
        draws: of plants with a spread; a `share` of them has to hold all hard goals.
        counted: how many of the plants make the objective; None for all.
        models: the plants one by one, of their own orders.
        bench: where the controller's FMU runs around one of them.
        around: plant -> values that the controller has around it, whatever is sought; those of draws, too.
        held: values of the controller that are found already, below those that are sought.
    """

    plants: PlantSet
    controller: Controller
    wiring: LoopWiring
    test: StepTest
    goals: tuple[Goal, ...]
    draws: PlantSet | None = None
    share: float = 1.0
    counted: int | None = None
    models: Mapping[str, LinearModel] = field(default_factory=dict)
    bench: StepBench | None = None
    around: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    held: Mapping[str, float] = field(default_factory=dict)

    def with_draws(self, numbers: Sequence[int]) -> TuningProblem:
        """The same with some of the draws beside the plants, which have to hold hard goals, too."""
        assert self.draws is not None
        return replace(self, plants=self.plants.joined(self.draws.only(numbers)), counted=len(self.plants))

    def on(self, plants: PlantSet) -> TuningProblem:
        """The same for other plants alone."""
        return replace(self, plants=plants, draws=None, counted=None)

    def trial(self, values: Mapping[str, float]) -> LoopTrial:
        """The loops with these parameters of the controller."""
        return LoopTrial(Loops(self.plants, self._controllers(values), self.wiring), self.test)

    def require_slopes(self, values: Mapping[str, float]) -> None:
        """See that the controller is as good as linear with these parameters, around every plant.

        Raises:
            InputError: it is not.
        """
        for own in dict.fromkeys(self._owned):
            self.controller.require_slopes({**self.held, **values, **dict(own)})

    @property
    def _owned(self) -> list[tuple[tuple[str, float], ...]]:
        """What values the controller has of its own around each plant; what it has around all where there are none."""
        return [tuple(self.around.get(name, {}).items()) for name in self.plants.names] or [()]

    def _controllers(self, values: Mapping[str, float]) -> ControllerSet:
        """One where it is the same around all plants."""
        sought = {**self.held, **values}
        models = {own: self.controller.linear({**sought, **dict(own)}) for own in dict.fromkeys(self._owned)}
        kept = models.values() if len(models) == 1 else [models[own] for own in self._owned]
        return ControllerSet.of(list(kept))

    def judged(self, values: Mapping[str, float]) -> CandidateJudgement:
        """What these parameters do; of loops that are not stable there are no figures."""
        trial = self.trial(values)
        radius, count = trial.loops.radius, len(self.plants)
        figures, missed = (np.full((len(self.goals), count), np.nan) for _ in range(2))
        stable = [int(i) for i in np.flatnonzero(trial.loops.stable)]
        if len(stable) < count:
            trial = replace(self, plants=self.plants.only(stable)).trial(values)
        for i, goal in enumerate(self.goals if stable else ()):
            found = MEASURES[goal.measure].figures(trial, goal)
            figures[i, stable] = found
            missed[i, stable] = np.clip(goal.missed(found), -FURTHEST, FURTHEST)
        counted = count if self.counted is None else self.counted
        return CandidateJudgement(dict(values), self.goals, figures, missed, radius, counted)
