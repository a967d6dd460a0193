"""Limits that samples keep: below, above, near a value, or within bounds that change with time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from orchestrator.fmi.interface import Port
from orchestrator.scenario.expectations.base import Condition, ExpectationScope, Judgement, Tube
from orchestrator.scenario.expectations.figure import shown
from orchestrator.scenario.expectations.quantities import Dimension, Level, Number, brought
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import Block, Time


@dataclass(frozen=True)
class OneSided(Condition):
    """Every sample lies on one side of a limit [unit of the signal].

    Attributes:
        side: in a word.
    """

    side: ClassVar[str]
    takes_nonfinite: ClassVar[bool] = True
    limit: Number
    unit: str = ""

    def __str__(self) -> str:
        return f"stays {self.side} {shown(self.limit, self.unit)}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return replace(self, limit=port.number(place, self.limit), unit=port.unit or "")


class Below(OneSided):
    """Every sample lies below the limit."""

    side = "below"

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        largest, limit = float(values.max()), float(self.limit)
        return Judgement(largest < limit, f"largest {largest:.6g}", largest, limit - largest)

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube:
        return np.full_like(time, -np.inf), np.full_like(time, float(self.limit))


class Above(OneSided):
    """Every sample lies above the limit."""

    side = "above"

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        smallest, limit = float(values.min()), float(self.limit)
        return Judgement(smallest > limit, f"smallest {smallest:.6g}", smallest, smallest - limit)

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube:
        return np.full_like(time, float(self.limit)), np.full_like(time, np.inf)


@dataclass(frozen=True)
class Near(Condition):
    """No sample is farther than `within` from a value [unit of the signal]."""

    takes_nonfinite: ClassVar[bool] = True
    target: Number
    within: Number
    unit: str = ""

    def __str__(self) -> str:
        return f"is {shown(self.target, self.unit)} within {shown(self.within, self.unit)}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        within = port.quantity(place, self.within, difference=True) if isinstance(self.within, str) else self.within
        return replace(self, target=port.number(place, self.target), within=within, unit=port.unit or "")

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        return within(values, float(self.target), float(self.within))

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube:
        target, width = float(self.target), float(self.within)
        return np.full_like(time, target - width), np.full_like(time, target + width)


def within(values: FloatArray, target: float | FloatArray, allowed: float) -> Judgement:
    """Whether values (K,) are no farther than that from a target, or from targets (K,)."""
    deviation = float(np.max(np.abs(values - target)))
    return Judgement(deviation <= allowed, f"largest deviation {deviation:.3g}", deviation, allowed - deviation)


class Piece(Block):
    """Bounds until a time: constant, or from a first level to a last one along a line.

    Attributes:
        to: when it ends [s]; None where the window does.
        below, above: bounds; two values are those at its begin and its end [unit of the signal].
    """

    to: Time | None = None
    below: Annotated[Level | tuple[Level, Level] | None, Dimension.LEVEL] = None
    above: Annotated[Level | tuple[Level, Level] | None, Dimension.LEVEL] = None

    @model_validator(mode="after")
    def _bounded(self) -> Self:
        if self.below is None and self.above is None:
            raise ValueError("give `below`, `above` or both")
        return self


def _ascending(pieces: list[Piece]) -> list[Piece]:
    ends = [piece.to for piece in pieces]
    known = [end for end in ends if end is not None]
    if None in ends[:-1] or known != sorted(set(known)):
        raise ValueError("the pieces must end one after the other, and only the last with the run")
    return pieces


Pieces = Annotated[list[Piece], Field(min_length=1), AfterValidator(_ascending)]
"""Bounds one after the other."""


class Range(Block, Condition):
    """Bounds over time, piece by piece."""

    pieces: Pieces

    def __str__(self) -> str:
        return f"stays within bounds of {len(self.pieces)} pieces"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return self.model_copy(update={"pieces": [brought(piece, place, port) for piece in self.pieces]})

    def judged(self, time: FloatArray, values: FloatArray, hold: bool, draws: Sequence[Trace]) -> Judgement:
        return inside(time, values, self.tube(time, hold))

    def tube(self, time: FloatArray, hold: bool, draws: Sequence[Trace] = ()) -> Tube:
        lower, upper = np.full_like(time, -np.inf), np.full_like(time, np.inf)
        begin, first = float(time[0]), 0
        for piece in self.pieces:
            end = float(time[-1]) if piece.to is None else piece.to
            after = len(time) if piece.to is None else int(np.searchsorted(time, end, side="right"))
            share = (time[first:after] - begin) / max(end - begin, 1e-300)
            for bound, level in ((lower, piece.above), (upper, piece.below)):
                if level is not None:
                    start, stop = level if isinstance(level, tuple) else (level, level)
                    bound[first:after] = float(start) + share * (float(stop) - float(start))
            begin, first = end, max(after, first)
        return lower, upper


def inside(time: FloatArray, values: FloatArray, band: Tube) -> Judgement:
    """Whether values (K,) lie between bounds (K,), and where they are farthest out, or come nearest to them."""
    lower, upper = band
    margins = np.minimum(upper - values, values - lower)
    row = int(np.argmin(margins))
    margin = float(margins[row])
    where = f"at {time[row]:.6g} s: {values[row]:.6g} between {lower[row]:.6g} and {upper[row]:.6g}"
    if margin >= 0:
        return Judgement(True, f"nearest to its bounds {where}", float(values[row]), margin)
    share = float(np.mean(margins < 0))
    return Judgement(False, f"{share:.3g} of the samples outside, farthest {where}", float(values[row]), margin)
