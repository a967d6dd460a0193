"""The contract of a measure: a figure of every loop, and what a study asks of it.

A leaf file of this room has a table `MEASURES` of its family; `table` joins them. A new measure is an entry there: a
function from a trial and a goal to one figure a loop, inf where there is no such figure, its unit, and in `needs` which
keys of a goal it takes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, Protocol

import numpy as np

from identification.tuning.loops.loops import Loops, Response
from identification.tuning.loops.wiring import Path
from orchestrator.trace import FloatArray

Need = Literal["opened", "signal", "command", "noise"]
Relative = Literal["reference", "peak"]
Over = Literal["sum", "worst"]


@dataclass(frozen=True)
class LoopSignal:
    """A signal of a loop: an output of the plant, or what the controller gives to an input of it."""

    name: str
    side: Literal["input", "output"]
    number: int

    def of(self, response: Response) -> FloatArray:
        """(N, K) in a response."""
        return np.asarray((response.outputs if self.side == "output" else response.inputs)[:, :, self.number])


@dataclass(frozen=True)
class Goal:
    """What is asked: a measure within bounds, or as small as can be.

    Attributes:
        measure: its name in the table.
        lower, upper: in the measure's unit; None where there is none.
        weight: of the objective, or of a missed soft bound, each in its own bound's size.
        hard: whether its bounds have to be held.
        opened: where the loop is opened for it; None takes the loop's own place.
        signal: of which signal it is.
        disturbed: number of the plant's input to which a step is added instead of one of the reference.
        relative: by what it is divided.
        over: how plants come together in an objective.
    """

    measure: str
    lower: float | None = None
    upper: float | None = None
    weight: float = 1.0
    hard: bool = True
    opened: Path | None = None
    signal: LoopSignal | None = None
    disturbed: int | None = None
    relative: Relative | None = None
    over: Over = "sum"

    @property
    def minimised(self) -> bool:
        """Whether it has no bounds and is part of the objective."""
        return self.lower is None and self.upper is None

    @property
    def size(self) -> float:
        """By what a miss is divided, so that those of different units compare."""
        return max(abs(self.lower or 0.0), abs(self.upper or 0.0)) or 1.0

    def missed(self, figures: FloatArray) -> FloatArray:
        """(N,) by how much of its size figures (N,) miss the nearer bound; negative where they hold it."""
        below = -np.inf if self.lower is None else (self.lower - figures) / self.size
        above = -np.inf if self.upper is None else (figures - self.upper) / self.size
        return np.maximum(below, above) + np.zeros_like(figures)


@dataclass(frozen=True)
class StepTest:
    """How responses are made: a step of the reference, or of a disturbance, over some samples.

    Attributes:
        height: of the reference [its unit].
        disturbance: of what is added to an input of the plant [its unit].
        samples: how many.
        limit: of the command [its unit], inf where it has none.
        band: around the end, of the height, within which a response has settled.
    """

    height: float
    samples: int
    disturbance: float = 1.0
    limit: float = np.inf
    band: float = 0.02


class Moves(Protocol):
    """What measures of responses look at: N loops' answers to one step."""

    test: StepTest

    @property
    def band(self) -> float:
        """Within which of its end a response has settled [unit of the reference]."""

    def time(self, goal: Goal) -> FloatArray:
        """(K,) [s], from the step on."""

    def signal(self, goal: Goal) -> FloatArray:
        """(N, K) the goal's signal."""

    def tracked(self, goal: Goal) -> FloatArray:
        """(N, K) what is tracked."""

    def target(self, goal: Goal) -> float:
        """Where the goal's signal is to be."""

    def aim(self, goal: Goal) -> float:
        """Where what is tracked is to be."""


class LoopTrial:
    """The loops of one candidate, and their responses where a measure asks for them."""

    def __init__(self, loops: Loops, test: StepTest) -> None:
        self.loops, self.test = loops, test
        self._disturbed: dict[int, Response] = {}

    @cached_property
    def followed(self) -> Response:
        """The answer to a step of the reference."""
        return self.loops.reference_step(self.test.height, self.test.samples)

    @property
    def band(self) -> float:
        """Within which of its end a response has settled [unit of the reference]."""
        return self.test.band * abs(self.test.height)

    def time(self, goal: Goal) -> FloatArray:
        """(K,) [s], from the step on."""
        return self.response(goal.disturbed).time

    def tracked(self, goal: Goal) -> FloatArray:
        """(N, K) what is tracked."""
        return np.asarray(self.response(goal.disturbed).outputs[:, :, self.loops.wiring.tracked])

    def aim(self, goal: Goal) -> float:
        """Where what is tracked is to be: at the reference, or after a disturbance at 0."""
        return self.test.height if goal.disturbed is None else 0.0

    def signal(self, goal: Goal) -> FloatArray:
        """(N, K) the goal's signal."""
        assert goal.signal is not None
        return goal.signal.of(self.response(goal.disturbed))

    def target(self, goal: Goal) -> float:
        """Where the goal's signal is to be: at the reference where it is tracked, at 0 otherwise."""
        signal = goal.signal
        followed = signal is not None and signal.side == "output" and signal.number == self.loops.wiring.tracked
        return self.test.height if followed and goal.disturbed is None else 0.0

    def response(self, disturbed: int | None) -> Response:
        """The answer to a step of the reference, or of a disturbance at an input of the plants."""
        if disturbed is None:
            return self.followed
        if disturbed not in self._disturbed:
            height, samples = self.test.disturbance, self.test.samples
            self._disturbed[disturbed] = self.loops.disturbance_step(disturbed, height, samples)
        return self._disturbed[disturbed]


@dataclass(frozen=True)
class Measure:
    """A figure of each loop.

    Attributes:
        unit: "" where it depends on the signal's.
        figures: (trial, goal) -> (N,); those of responses take any `Moves` for a trial.
        needs: of the keys of a goal those that it takes.
        words: what it is.
    """

    unit: str
    figures: Callable[[Any, Goal], FloatArray]
    needs: frozenset[Need]
    words: str
