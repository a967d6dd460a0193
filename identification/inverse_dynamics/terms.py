"""The terms of a driven axis' inverse model, force = sum of value times column, each linear in its value.

    force = inertia q'' + viscous q' + dry friction sign(q') + offset + stiffness q

Viscous and dry friction may differ by direction. An offset is the same force as dry friction that differs by direction.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

import numpy as np

from orchestrator.trace import FloatArray

Term = Literal[
    "inertia",
    "viscous",
    "viscous_positive",
    "viscous_negative",
    "coulomb",
    "coulomb_positive",
    "coulomb_negative",
    "offset",
    "stiffness",
]
PASSIVE: frozenset[Term] = frozenset(
    {"viscous", "viscous_positive", "viscous_negative", "coulomb", "coulomb_positive", "coulomb_negative"}
)
"""The terms that only take energy out, so that their values are not negative."""
SAME: tuple[frozenset[Term], ...] = (
    frozenset({"viscous", "viscous_positive"}),
    frozenset({"viscous", "viscous_negative"}),
    frozenset({"coulomb", "coulomb_positive"}),
    frozenset({"coulomb", "coulomb_negative"}),
    frozenset({"offset", "coulomb_positive", "coulomb_negative"}),
)
"""Terms that no motion tells apart when all of a set are there."""


@dataclass(frozen=True, eq=False)
class AxisMotion:
    """A motion of the axis, on the mean about each sample.

    Attributes:
        position, speed, acceleration: (K,) in the position's unit, over s and s^2.
        ahead: (K,) share in which the speed is positive.
    """

    position: FloatArray
    speed: FloatArray
    acceleration: FloatArray
    ahead: FloatArray

    def columns(self, terms: Iterable[Term]) -> FloatArray:
        """(K, n) what each term's value is multiplied by."""
        return np.column_stack([self._column(term) for term in terms])

    def _column(self, term: Term) -> FloatArray:
        if term in ("inertia", "offset", "stiffness"):
            same = np.ones_like(self.ahead)
            return {"inertia": self.acceleration, "offset": same, "stiffness": self.position}[term]
        kind, _, side = term.partition("_")
        ahead, back = (0.0 if side == "negative" else self.ahead), (0.0 if side == "positive" else 1 - self.ahead)
        return np.asarray(self.speed * (ahead + back) if kind == "viscous" else ahead - back)
