"""Whether values stay where they are when motions are prepared otherwise: what moves them is no noise of the force."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.inverse_dynamics.regression import Regression
from identification.inverse_dynamics.rows import FilteredRecord, corners
from identification.inverse_dynamics.study import Filtering
from identification.inverse_dynamics.terms import Term
from orchestrator.trace import FloatArray

_SLOWER = 0.6  # of the lowest corner; a bias by noise goes with its fifth power
_NEAR_REST = 0.1  # of the rms speed, below which friction may be another than where it moves
_BEYOND = 2.0  # standard deviations of both, beyond which values have moved


@dataclass(frozen=True, eq=False)
class Shift:
    """Values that are others when motions are prepared otherwise.

    Attributes:
        how: what is otherwise, for people; why: what may be behind, and what to write.
        by: (n,) how far each value has moved; 0 where noise explains it.
        untried: why it could not be tried; nothing where it was.
    """

    how: str
    why: str
    by: FloatArray
    untried: str = ""

    def told(self, names: Mapping[Term, str], values: Mapping[Term, float]) -> str:
        """A sentence; nothing where values stay."""
        if self.untried:
            return f"whether values stay the same {self.how} could not be tried: {self.untried}"
        moved = [
            f"{names[term]} by {100 * abs(by / values[term]):.2g} %"
            for term, by in zip(names, self.by, strict=True)
            if by and values[term]
        ]
        return f"{self.how} values move: {', '.join(moved)}; intervals allow for that; {self.why}" if moved else ""


def shifts(
    found: Regression, how: Filtering, rows: Sequence[FilteredRecord], again: Callable[[Filtering], Regression]
) -> tuple[Shift, ...]:
    """What becomes of the values by a lower cutoff, and without the samples near rest.

    Args:
        again: regresses with motions prepared like that, on the rows kept here: a lower cutoff smooths speeds as well,
            and would let in what rests, which is another question.
    """
    slow = _NEAR_REST * float(np.sqrt(np.mean(np.concatenate([one.speeds for one in rows]) ** 2)))
    lower = _SLOWER * min(corner for one in rows for corner in corners(one.record, how))
    tried = {
        f"with `cutoff: {lower:.3g}`": (
            replace(how, cutoff=lower),
            "noise of the position is in its accelerations (lower `cutoff`, or give the `loop` for instruments), or "
            "the model lacks what is fast",
        ),
        f"with `least_speed: {slow:.2g}`": (
            replace(how, least_speed=max(how.least_speed, slow)),
            f"near rest friction is not the model's: write `least_speed: {slow:.2g}`",
        ),
    }
    return tuple(_shift(found, words, why, other, again) for words, (other, why) in tried.items() if other != how)


def _shift(
    found: Regression, words: str, why: str, other: Filtering, again: Callable[[Filtering], Regression]
) -> Shift:
    try:
        there = again(other)
    except IdentificationError as error:
        return Shift(words, why, np.zeros_like(found.values), f"{error.place} {error.problem}")
    moved = there.values - found.values
    noise = np.sqrt(np.diag(found.covariance) + np.diag(there.covariance))
    return Shift(words, why, np.where(np.abs(moved) > _BEYOND * noise, moved, 0.0))
