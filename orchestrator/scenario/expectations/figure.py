"""A kind of expectation that asks for one figure of a signal, and between which bounds it lies."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import ClassVar, Self

import numpy as np
from pydantic import model_validator

from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations.base import Condition, ExpectationScope, Judgement
from orchestrator.scenario.expectations.quantities import Dimension, Number, brought
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block, Quantity


class FigureBounds(Block):
    """Between which bounds a figure lies; each may have its unit, `5 %`, `20 ms`.

    Attributes:
        at_least, at_most: the bounds themselves are good.
        near: a value, from which the figure is not farther than `within`.
        within: how far it may be from `near`.
    """

    at_least: float | Quantity | None = None
    at_most: float | Quantity | None = None
    near: float | Quantity | None = None
    within: float | Quantity | None = None

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if (self.near is None) != (self.within is None):
            raise ValueError("`near` and `within` go together")
        if self.at_least is None and self.at_most is None and self.near is None:
            raise ValueError("give `at_most`, `at_least`, or `near` and `within`")
        if str(self.within).strip().startswith("-"):
            raise ValueError("`within` must not be negative")
        return self

    def bounds_in(self, place: str, dimension: Dimension, port: Port | None = None) -> Self:
        """The same in the unit that figures of this dimension have, for a signal where it is made of its unit.

        Raises:
            WiringError: as `number`.
        """
        given = {name: getattr(self, name) for name in ("at_least", "at_most", "near", "within")}
        return self.model_copy(
            update={
                name: dimension.number(place, value, port, difference=name == "within")
                for name, value in given.items()
                if value is not None
            }
        )

    def margin(self, figure: float) -> float:
        """How far the figure is from the bound that is nearest, negative outside [unit of the figure]."""
        sides = [] if self.at_most is None else [float(self.at_most) - figure]
        sides += [] if self.at_least is None else [figure - float(self.at_least)]
        if self.near is not None and self.within is not None:
            sides.append(float(self.within) - abs(figure - float(self.near)))
        return min(sides)

    def judgement(
        self,
        words: str,
        figure: float,
        dimension: Dimension,
        more: str = "",
        lowest: float = -np.inf,
        highest: float = np.inf,
    ) -> Judgement:
        """What the bounds say of a figure of that name, which always lies between two values."""
        margin, doubt = self.margin(figure), self._doubt(words, lowest, highest)
        return Judgement(margin >= 0, f"{words} {figure:.4g}", figure, margin, dimension, more, doubt)

    def _doubt(self, words: str, lowest: float, highest: float) -> str:
        if self.margin(lowest) >= 0 and self.margin(highest) >= 0:
            above = f" or above {highest:g}" if highest < np.inf else ""
            return f"cannot fail: {words} is never below {lowest:g}{above}"
        return ""

    def asked(self, dimension: Dimension) -> str:
        """The bounds of a figure in words."""
        unit = dimension.own
        parts = [] if self.at_least is None else [f"at least {shown(self.at_least, unit)}"]
        parts += [] if self.at_most is None else [f"at most {shown(self.at_most, unit)}"]
        if self.near is not None and self.within is not None:
            parts.append(f"{shown(self.near, unit)} within {shown(self.within, unit)}")
        return " and ".join(parts)


class Figure(FigureBounds, Condition):
    """A figure of a signal and its bounds.

    Attributes:
        words: what it is called.
        dimension: what it is.
        lowest: below which it never lies.
    """

    words: ClassVar[str]
    dimension: ClassVar[Dimension]
    lowest: ClassVar[float] = 0.0

    @abstractmethod
    def figure(self, time: FloatArray, values: FloatArray, hold: bool) -> float | None:
        """The figure [its unit]; None where it does not come to it, so that no bound holds."""

    def __str__(self) -> str:
        return f"has {self.words} {self.asked(self.dimension)}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return brought(self.bounds_in(place, self.dimension, port), place, port)

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        figure = self.figure(time, values, hold)
        if figure is None:
            return Judgement(False, f"no {self.words}")
        return self.judgement(self.words, figure, self.dimension, lowest=self.lowest)


def shown(value: Number, unit: str = "") -> str:
    """A number as files have it; a plain one is in this unit."""
    return value if isinstance(value, str) else f"{value:g} {unit}".rstrip()
