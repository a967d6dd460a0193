"""What segments of windows came to, which were run from start values of their own: where a search may begin."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from identification.estimation.arrow_least_squares import WindowBlock
from orchestrator.trace import FloatArray, ReadOnlyArrays


@dataclass(frozen=True, eq=False)
class Shot(ReadOnlyArrays):
    """What segments came to.

    Attributes:
        segments: of each window.
        values: name -> parameter.
        starts: component.variable -> (W,) estimated start values of the windows.
        gap: the largest that is left between two segments, in sizes of the states.
        closed: whether that is none.
        cost: of the outputs, by least squares.
        noise: standard deviation of the residuals, by which what is known before was weighed.
        growth: how many times as much windows make at most of a deviation at their start.
        blocks: the windows linearised there, as far as segments stay joined.
    """

    segments: int
    values: Mapping[str, float]
    starts: Mapping[str, FloatArray]
    gap: float
    closed: bool
    cost: float
    iterations: int
    simulations: int
    growth: float
    noise: float
    blocks: tuple[WindowBlock, ...]
