"""What is asked of a noisy scenario, judged by what its noise allows: over runs that differ by their seeds alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from orchestrator.fmi.interface import Port
from orchestrator.measures import band, chance_of_fewer, membership, share_interval
from orchestrator.scenario.expectations.base import Condition, Draws, ExpectationScope, Judgement, Times, Tube
from orchestrator.scenario.expectations.quantities import Dimension, Share
from orchestrator.scenario.expectations.reference import Against
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block

MOST_SEEDS = 10_000
NO_DRAWS = "there are no draws: noise is drawn again in plain runs only"


class BandBlock(Block):
    """A band of runs with other noise, in which the reference must lie.

    Attributes:
        seeds: how many runs, besides the one that is recorded.
        vary: components whose seeds differ from run to run; by default all that are given one.
        quantiles: of all at each instant, between which the band lies before it is widened to hold whole signals.
        failure: chance of failing although nothing has changed; by default that of being the farthest out of all.
    """

    seeds: int = Field(ge=5, le=MOST_SEEDS)
    vary: list[str] | None = Field(None, min_length=1)
    quantiles: tuple[Share, Share] = (0.05, 0.95)
    failure: Share | None = Field(None, gt=0, lt=1)

    @model_validator(mode="after")
    def _can_fail(self) -> Self:
        low, high = self.quantiles
        if not 0 <= low < 0.5 < high <= 1:
            raise ValueError("`quantiles` must lie on both sides of 0.5")
        if self.failure is not None and self.allowed < 1:
            needed = int(np.ceil(1 / self.failure - 1e-9)) - 1
            raise ValueError(f"cannot fail: a `failure` of {self.failure:g} needs {needed} `seeds`")
        return self

    @property
    def allowed(self) -> int:
        """The rank from outside, 1 for the farthest, up to which a reference fails."""
        return 1 if self.failure is None else int(self.failure * (self.seeds + 1) + 1e-9)

    @property
    def chance(self) -> float:
        """Of failing although nothing has changed [1]."""
        return self.allowed / (self.seeds + 1)


@dataclass(frozen=True)
class InBand(Against):
    """The reference is one more of the runs that differ by their noise alone, as far as its rank among them tells."""

    block: BandBlock

    def __str__(self) -> str:
        low, high = self.block.quantiles
        return (
            f"has {self.reference.name} in the band of {self.block.seeds} seeds ({100 * low:g} to {100 * high:g} %), "
            f"which fails by chance with {self.block.chance:.2g}"
        )

    @property
    def draws(self) -> Draws:
        return Draws(self.block.seeds, tuple(self.block.vary or ()))

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        if self.reference.trace is None:
            return super().judged(time, values, hold, draws)
        if len(draws) < self.block.seeds:
            return Judgement(False, NO_DRAWS)
        samples = [next(iter(trace.signals.values())) for trace in draws[: self.block.seeds]]
        if any(len(one) != len(time) for one in samples):
            return Judgement(False, "a draw ended early")
        found = membership(self.reference.at(time, hold), np.array(samples), *self.block.quantiles)
        margin = found.chance - (self.block.allowed + 1) / (self.block.seeds + 1)
        text = (
            f"farthest out at {time[found.at]:.6g} s, {found.score:.3g} half widths (draws {found.median_score:.3g}); "
            f"share of all as far out {found.chance:.3g}"
        )
        return Judgement(margin > -1e-12, text, found.chance, margin, Dimension.SHARE)

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube | None:
        samples = [next(iter(trace.signals.values())) for trace in draws[: self.block.seeds]]
        if self.reference.trace is None or len(samples) < self.block.seeds or any(len(y) != len(time) for y in samples):
            return None
        return band(self.reference.at(time, hold), np.array(samples), *self.block.quantiles, self.block.allowed)

    def compared(self, time: FloatArray, values: FloatArray, hold: bool) -> Judgement:
        return Judgement(False, NO_DRAWS)


@dataclass(frozen=True)
class Often(Condition):
    """A condition holds of a share of the runs that differ by their noise alone.

    Attributes:
        wanted: the runs, besides the one that is recorded, which counts as well.
        share: of all in which it must hold [1].
    """

    condition: Condition
    wanted: Draws
    share: float

    def __str__(self) -> str:
        return f"{self.condition} in {100 * self.share:g} % of {self.wanted.count + 1} runs with other noise"

    @property
    def draws(self) -> Draws:
        return self.wanted

    @property
    def files(self) -> tuple[Path, ...]:
        return self.condition.files

    @property
    def accepted(self) -> bool:
        return self.condition.accepted

    @property
    def needed(self) -> int:
        """Runs of which it must hold."""
        return int(np.ceil(self.share * (self.wanted.count + 1) - 1e-9))

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return replace(self, condition=self.condition.brought(place, port, wiring))

    def check_covered(self, place: str, instants: FloatArray, asked: Times) -> None:
        self.condition.check_covered(place, instants, asked)

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        if len(draws) < self.wanted.count:
            return Judgement(False, NO_DRAWS)
        runs = [(time, values), *((trace.time, *trace.signals.values()) for trace in draws[: self.wanted.count])]
        held = sum(self._held(stamps, samples, hold) for stamps, samples in runs)
        low, high = share_interval(held, len(runs))
        chance = chance_of_fewer(self.needed, len(runs), held / len(runs))
        share = held / len(runs)
        text = (
            f"held in {held} of {len(runs)} runs, so in {100 * low:.3g} to {100 * high:.3g} % of all such (95 % sure); "
            f"were it as found, other seeds would fail with {chance:.2g}; share {share:.4g}"
        )
        return Judgement(held >= self.needed, text, share, (held - self.needed) / len(runs), Dimension.SHARE)

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube | None:
        return self.condition.tube(time, hold)

    def _held(self, time: FloatArray, values: FloatArray, hold: bool) -> bool:
        if not np.all(np.isfinite(values)):
            return False
        return self.condition.judged(time, values, hold, ()).held
