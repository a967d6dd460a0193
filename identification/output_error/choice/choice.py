"""How a choice among candidates came out: each one's fit, how they rank, what failed, and what a reader has to know."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from identification.output_error.choice.ranking import LEVEL, TELLING, CandidateRanking

FEW = 10  # independent samples for each unknown, below which criteria say little


@dataclass(frozen=True)
class FittedCandidate:
    """A candidate that was fitted.

    Attributes:
        values: name -> estimate [its unit].
        std: name -> standard deviation of the estimated ones; infinite where not determined.
        units: of these.
        unknowns: parameters and start values that were fitted.
        fitted, unseen: median FIT; nan where nothing moves, None where no trace was held out.
        unsettled: why the search has not converged; nothing where it has.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    units: Mapping[str, str]
    unknowns: int
    fitted: float
    unseen: float | None
    unsettled: str


@dataclass(frozen=True)
class Choice:
    """Candidates, the chosen one first.

    Attributes:
        outcomes: of those that were fitted.
        failed: name -> why it could not be fitted or judged.
        signals: of the recordings, by which they are compared.
        left: those that were not reached before it was stopped.
    """

    ranking: CandidateRanking
    outcomes: Mapping[str, FittedCandidate]
    failed: Mapping[str, str]
    signals: tuple[str, ...]
    left: tuple[str, ...] = ()

    @property
    def chosen(self) -> str:
        """The name of the one that is written."""
        return self.ranking.chosen

    @property
    def doubts(self) -> tuple[str, ...]:
        """What a reader of the choice has to know, one sentence each."""
        return tuple(self._doubts())

    def _doubts(self) -> Iterator[str]:
        ranking, chosen = self.ranking, self.ranking.rows[self.chosen]
        if ranking.alike:
            others = " and ".join(ranking.alike)
            least = min(ranking.rows[name].criteria.bic - chosen.criteria.bic for name in ranking.alike)
            unseen = f", and predictions differ within their scatter over {ranking.windows} windows"
            yield (
                f"candidates: {others} not distinguishable from {self.chosen}, which is written: BIC differs by "
                f"{least:.2g}, below {TELLING:g}{unseen if ranking.windows else ''}"
            )
        if ranking.contested:
            yield (
                f"candidates: BIC prefers {ranking.contested}, but it predicts what was held out worse than "
                f"{self.chosen} by more than scatters over {ranking.windows} windows ({100 * LEVEL:g} %)"
            )
        unknowns = max(outcome.unknowns for outcome in self.outcomes.values())
        if chosen.criteria.samples < FEW * unknowns:
            yield (
                f"candidates: the noise is so correlated that criteria count {chosen.criteria.samples:.0f} independent "
                f"samples, few for up to {unknowns} unknowns: they say little, and predictions more"
            )
        if not ranking.windows:
            yield "candidates: no trace is held out (`traces.hold_out`), so criteria of what was fitted decide alone"
        elif ranking.windows == 1:
            yield "candidates: one window is held out, so how far predictions scatter is not known and criteria decide"
        for name, why in self.failed.items():
            yield f"candidates: {name} failed and is not ranked: {why}"
        for name, outcome in self.outcomes.items():
            if outcome.unsettled and name != self.chosen:
                yield f"candidates: {name} has not converged and may be better than it looks: {outcome.unsettled}"
        if self.left:
            yield f"candidates: {' and '.join(self.left)} not tried, as the calibration was stopped"
