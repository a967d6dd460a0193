"""A parameter's profile as a result, and how one side of it is followed to the interval's end."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from identification.estimation.parameters import Parameter
from orchestrator.trace import FloatArray, ReadOnlyArrays

_CLOSE = 0.01  # of the threshold's root, and of the way to it: where an end is found
_FARTHER = (1.05, 4.0)  # times the way so far: the least and the most that a step outward reaches
_INSIDE = 0.05  # of a bracket: how near to its ends a step may fall
_FAILURES = 6


@dataclass(frozen=True, eq=False)
class CostProfile(ReadOnlyArrays):
    """How the least cost rises as one parameter is held beside its estimate.

    Attributes:
        values: (k,) rising, the estimate among them [unit].
        rise: (k,) of twice the cost, over the noise: F with one degree of freedom at the true value.
        threshold: the rise at the ends of the 95 % interval.
        ends: of the interval [unit]; infinite on a side without one.
        open: "lower" or "upper" -> why the interval has no end there.
        held_by: "lower" or "upper" -> parameters that have come to a bound at the end there.
    """

    name: str
    values: FloatArray
    rise: FloatArray
    threshold: float
    ends: tuple[float, float]
    open: Mapping[str, str]
    held_by: Mapping[str, tuple[str, ...]] = field(default_factory=dict)


@dataclass
class ProfileSide:
    """One side of a profile by the root of the rise, which is a straight line where the outputs are linear.

    Attributes:
        sign: -1 below the estimate, 1 above.
        centre: z of the estimate.
        room: how far it may be followed; `at_bound` tells whether a bound is the reason.
        target: the root at the interval's end.
        next: how far from the estimate the next fit is.
        inner, outer: (way, root) of the farthest fit below the target and of the nearest above.
        reason: why there is no end.
    """

    sign: float
    centre: float
    room: float
    target: float
    next: float
    at_bound: bool
    inner: tuple[float, float] = (0.0, 0.0)
    outer: tuple[float, float] | None = None
    reason: str = ""
    found: bool = False
    failures: int = 0
    narrowed: int = 0

    def __post_init__(self) -> None:
        if self.room <= 0:
            self._open()

    @property
    def ended(self) -> bool:
        """Whether nothing is left to be tried."""
        return self.found or bool(self.reason)

    def reached(self, root: float) -> bool:
        """Take what a fit at `next` came to, and decide on the next; whether it lies inside the interval."""
        way, inside = self.next, root < self.target
        if inside:
            self.inner = (way, root)
        else:
            self.outer = (way, root)
        if abs(root - self.target) <= _CLOSE * self.target:
            self.found = True
        elif inside and way >= self.room:
            self._open()
        elif self.outer is None:
            self.next = min(self.room, self._farther())
        else:
            width = self.outer[0] - self.inner[0]
            self.found = width <= _CLOSE * self.outer[0]
            low, high = self.inner[0] + _INSIDE * width, self.outer[0] - _INSIDE * width
            self.narrowed += 1
            middle = self.narrowed % 3 == 0  # so that a bend cannot hold up what goes by straight lines
            self.next = 0.5 * (low + high) if middle else min(max(self._crossing(), low), high)
        return inside

    def failed(self) -> None:
        """No run succeeds at `next`: try nearer, and give up in the end."""
        self.failures += 1
        if self.failures >= _FAILURES:
            self.reason = "runs beyond it fail"
        self.room, self.at_bound = self.next, False
        self.next = 0.5 * (self.inner[0] + self.next)

    def end(self, parameter: Parameter) -> float:
        """The interval's end [unit]; infinite where it is open."""
        if self.reason or (self.outer is None and not self.found):
            self.reason = self.reason or "it was not found in the fits that are allowed"
            return self.sign * math.inf
        return parameter.value(self.centre + self.sign * self._crossing())

    def _open(self) -> None:
        self.reason = "the data do not exclude its bound" if self.at_bound else "the data exclude nothing of that side"

    def _farther(self) -> float:
        way, root = self.inner
        least, most = _FARTHER
        return way * min(max(least * self.target / root, least), most) if root > 0 else most * way

    def _crossing(self) -> float:
        """Where the root meets the target: between the fits beside it, or on through the nearest."""
        if self.outer is None:
            way, root = self.inner
            return way * self.target / root
        (a, below), (b, above) = self.inner, self.outer
        return a + (b - a) * (self.target - below) / (above - below)
