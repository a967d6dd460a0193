"""Claims held against the figures of a campaign: each is a set of inequalities, and none is forced."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from fmus.errors import ScenarioError
from identification.experiments.experiments import Experiments
from identification.experiments.reduction import ReductionExample
from identification.experiments.schema import ClaimBlock, ClaimOutcome, InequalityBlock
from identification.experiments.set_result import SetResult, mean


@dataclass(frozen=True)
class Inequality:
    """One inequality: the largest of what should be less (times its factor) and the smallest of what should be more."""

    KEYS = ("text", "less", "than", "held")

    block: InequalityBlock
    less: float
    than: float

    @property
    def held(self) -> bool:
        return self.less < self.than

    @property
    def text(self) -> str:
        """It in words, with the figures."""
        factor = f"{self.block.times:g} x " if self.block.times != 1 else ""
        sign = "<" if self.held else "not <"
        return f"{factor}{_side(self.block.less, self.less)} {sign} {_side(self.block.than, self.than)}"


@dataclass(frozen=True)
class ClaimJudgement:
    """A claim and how its inequalities came out."""

    KEYS: ClassVar[tuple[str, ...]] = ("statement", "outcome", "stated", "reason", "comparisons")

    claim: ClaimBlock
    comparisons: tuple[Inequality, ...]

    @property
    def statement(self) -> str:
        return self.claim.statement

    @property
    def stated(self) -> ClaimOutcome:
        """How the study states that it comes out."""
        return self.claim.outcome

    @property
    def count(self) -> int:
        """Inequalities that hold."""
        return sum(comparison.held for comparison in self.comparisons)

    @property
    def outcome(self) -> ClaimOutcome:
        """Held when all of them hold, not borne out when none does."""
        if self.count == len(self.comparisons):
            return "held"
        return "held in part" if self.count else "not borne out"

    @property
    def as_stated(self) -> bool:
        """Whether the study states this outcome."""
        return self.outcome == self.stated

    @property
    def reason(self) -> str:
        """Why it did not hold, where it did not."""
        return "" if self.outcome == "held" else self.claim.reason


@dataclass(frozen=True)
class JudgedClaim(ClaimJudgement):
    """A claim under the study's preparation, and under the other one where there is one."""

    KEYS = (*ClaimJudgement.KEYS, "compared")

    compared: ClaimJudgement | None


def judge(experiments: Experiments) -> list[ClaimJudgement]:
    """All claims of the study.

    Raises:
        ScenarioError: a claim names a figure that there is not.
    """
    known = figures(experiments)
    return [
        ClaimJudgement(claim, tuple(_compared(block, known, f"claims[{i}]") for block in claim.holds))
        for i, claim in enumerate(experiments.study.claims)
    ]


def verdicts(experiments: Experiments) -> list[JudgedClaim]:
    """All claims of the study, as `judge`."""
    own = judge(experiments)
    others = judge(experiments.compared) if experiments.compared else itertools.repeat(None)
    return [JudgedClaim(one.claim, one.comparisons, other) for one, other in zip(own, others, strict=False)]


def unexpected(claims: Sequence[JudgedClaim]) -> list[str]:
    """A sentence about each claim that comes out otherwise than the study states."""
    return [
        f"'{own.statement}' is {own.outcome}, where the study states '{own.stated}'"
        for own in claims
        if not own.as_stated
    ]


def figures(experiments: Experiments) -> dict[str, float]:
    """All figures that claims can speak of; inf for an unstable loop.

    Of a data set's chosen model, after its label: `.dmv` and `.sfv` (delta-bar), `.dmv.position` and so on (delta of an
    output), `.orders` (how many stable ones), `.mode1` and so on (relative distance from the physical frequency).
    Of an example, after its name: `.initial.dmv`, `.mrm.sfv` and so on, for each stage, and
    `.mrm.rigid`: how many states of a reduced one are of rigid modes.
    """
    found: dict[str, float] = {}
    for label, result in experiments.results.items():
        found |= {f"{label}.{name}": value for name, value in _of_set(result, experiments.study.outputs)}
    for name, reduction in experiments.reductions.items():
        payload = experiments.study.sets[experiments.example(name).data].payload
        flexible = experiments.physical[payload][0].frequency
        found |= {f"{name}.{stage}": value for stage, value in _of_reduction(reduction, flexible)}
    return found


def _of_set(result: SetResult, outputs: Sequence[str]) -> Iterator[tuple[str, float]]:
    errors = result.chosen.errors
    yield "dmv", mean(errors.dmv)
    yield "sfv", mean(errors.sfv)
    yield "orders", float(len(result.stable))
    for i, name in enumerate(outputs):
        yield f"dmv.{name}", float(errors.dmv[i])
        yield f"sfv.{name}", math.inf if errors.sfv is None else float(errors.sfv[i])
    for number, distance in enumerate(result.frequencies, start=1):
        yield f"mode{number}", distance


def _of_reduction(reduction: ReductionExample, flexible: float) -> Iterator[tuple[str, float]]:
    """Args: flexible: lowest frequency of a flexible mode [Hz]; what is below half of it is rigid motion."""
    ranking = reduction.ranking
    rigid = {
        label: mode.size
        for label, mode in zip(ranking.labels, ranking.modes, strict=True)
        if not mode.paired or mode.frequency < 0.5 * flexible
    }
    for stage in reduction.stages:
        if stage.kept:
            yield f"{stage.name}.rigid", float(sum(rigid.get(label, 0) for label in stage.kept))
        yield f"{stage.name}.dmv", mean(stage.errors.dmv)
        yield f"{stage.name}.sfv", mean(stage.errors.sfv)


def _compared(block: InequalityBlock, known: Mapping[str, float], place: str) -> Inequality:
    def value(name: str | float) -> float:
        if not isinstance(name, str):
            return name
        if name not in known:
            raise ScenarioError(place, f"there is no figure '{name}'", "write, for example, O_dat2.dmv or Ac3.mrm.dmv")
        return known[name]

    less, than = (np.array([value(name) for name in names]) for names in (block.less, block.than))
    return Inequality(block, float(less.max()) * block.times, float(than.min()))


def _side(names: list[str | float], value: float) -> str:
    """The names and the figure that counts."""
    words = [name if isinstance(name, str) else f"{name:g}" for name in names]
    if len(words) > 1:
        return f"({', '.join(words)}) = {value:.3g}"
    return f"{words[0]} = {value:.3g}" if isinstance(names[0], str) else words[0]
