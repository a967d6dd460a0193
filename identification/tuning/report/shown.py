"""The loops that a report draws: plants one by one, and all that are too many for that together."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from identification.tuning.goals.goal import LoopTrial
from identification.tuning.loops.plants import PlantSet
from identification.tuning.tuning import Tuning
from orchestrator.report.chart import Band
from orchestrator.trace import FloatArray

ALONE = 12  # plants that are drawn one by one


@dataclass(frozen=True, eq=False)
class ShownLoops:
    """Loops with the values that were found.

    Attributes:
        alone: of single plants.
        others: of further plants, and of draws that nothing was fitted to; None without any.
        word: what the others are.
        unstable: how many loops are left out since they are not stable.
    """

    alone: LoopTrial
    others: LoopTrial | None = None
    word: str = ""
    unstable: int = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Of the single plants."""
        return self.alone.loops.plants.names

    @property
    def remark(self) -> str:
        """What a caption says of the others, and of what is missing."""
        kept = "" if self.others is None else f"; {len(self.others.loops.plants):,} {self.word} together"
        return kept + (f"; {self.unstable:,} unstable loops left out" if self.unstable else "")

    def band(self, x: FloatArray, values: FloatArray) -> Band:
        """Between the lowest and the highest of the others' values (N, K) over x (K,)."""
        return Band(self.word, x, np.nanmin(values, axis=0), np.nanmax(values, axis=0))


def shown(result: Tuning) -> ShownLoops:
    """All loops of a tuning."""
    plants, draws = result.problem.plants, result.parts.unseen
    alone, more = plants.parted(ALONE)
    alone_trial = _trial(result, alone)
    if draws is None and not len(more):
        return ShownLoops(alone_trial)
    if draws is None:
        return ShownLoops(alone_trial, _trial(result, more), "other plants")
    if not len(more):
        return ShownLoops(alone_trial, _trial(result, draws), "draws")
    return ShownLoops(alone_trial, _trial(result, more.joined(draws)), "other plants and draws")


def stable(result: Tuning, every: ShownLoops) -> ShownLoops:
    """Those of the loops that are stable."""
    alone, missing = _stable(result, every.alone)
    if every.others is None:
        return replace(every, alone=alone, unstable=missing)
    others, more = _stable(result, every.others)
    kept = others if len(others.loops.plants) else None
    return replace(every, alone=alone, others=kept, unstable=missing + more)


def _trial(result: Tuning, plants: PlantSet) -> LoopTrial:
    return result.problem.on(plants).trial(result.found.best.values)


def _stable(result: Tuning, trial: LoopTrial) -> tuple[LoopTrial, int]:
    kept, plants = np.flatnonzero(trial.loops.stable), trial.loops.plants
    if len(kept) == len(plants):
        return trial, 0
    return _trial(result, plants.only(kept.tolist())), len(plants) - len(kept)
