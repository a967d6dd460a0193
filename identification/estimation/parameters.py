"""What is free in an estimation: parameters, ties between them, and the initial states of windows.

A declaration also carries its scaling: the estimator moves a vector z whose entries are of order 1 and start
at 0.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.prior import Prior
from orchestrator.trace import FloatArray

Scale = Literal["linear", "log"]


@dataclass(frozen=True)
class Parameter:
    """One parameter, as `component.variable`.

    Attributes:
        start: where the estimation begins [unit]; on the linear scale its size is also the unit of z.
        lower: smallest value allowed [unit].
        upper: largest value allowed [unit].
        scale: "linear": z = (value - start) / size; "log": z = ln(value / start), for positive values.
        fixed: True keeps it at `start`.
        prior: what is known of it before the recordings.
    """

    name: str
    start: float
    lower: float = -math.inf
    upper: float = math.inf
    unit: str = "1"
    scale: Scale = "linear"
    fixed: bool = False
    prior: Prior | None = None

    def __post_init__(self) -> None:
        _check_range(self.name, (self.start,), self.lower, self.upper)
        if self.scale not in ("linear", "log"):
            raise IdentificationError(self.name, f"scale is '{self.scale}'", "use linear or log")
        if self.scale == "log" and self.start <= 0:
            raise IdentificationError(self.name, f"start {self.start:g} on a log scale", "start above 0")
        if self.prior is not None:
            lower, upper = self.prior.bounds(f"parameters.{self.name}.prior", self.lower, self.upper)
            _check_range(self.name, (self.start,), lower, upper)
            object.__setattr__(self, "lower", lower)
            object.__setattr__(self, "upper", upper)

    @property
    def size(self) -> float:
        """One unit of z [unit]: |start|; for a start of 0 a hundredth of the bounds' width, else 1."""
        return _size(self.start, self.lower, self.upper)

    @property
    def z_bounds(self) -> tuple[float, float]:
        """The bounds in z."""
        if self.scale == "linear":
            return (self.lower - self.start) / self.size, (self.upper - self.start) / self.size
        lower = math.log(self.lower / self.start) if self.lower > 0 else -math.inf
        return lower, math.log(self.upper / self.start) if self.upper < math.inf else math.inf

    @property
    def reach(self) -> float:
        """The longest step in z: ten times the value, or a tenth; a slope says nothing of what is further."""
        return math.inf if self.scale == "linear" else math.log(10)

    def value(self, z: float) -> float:
        """Value at z [unit], never outside the bounds by rounding."""
        return min(max(self.unbounded(z), self.lower), self.upper)

    def unbounded(self, z: float) -> float:
        """Value at z [unit] without regard to the bounds, as an interval's end needs it."""
        return self.start + z * self.size if self.scale == "linear" else self.start * math.exp(z)

    def z(self, value: float) -> float:
        """z at a value [unit]."""
        return (value - self.start) / self.size if self.scale == "linear" else math.log(value / self.start)

    def at_bound(self, value: float) -> float | None:
        """The bound that a value is at, None where it is at none."""
        return next((bound for bound in (self.lower, self.upper) if abs(value - bound) <= 1e-9 * self.size), None)

    def slope(self, z: float) -> float:
        """d value / d z [unit]."""
        return self.size if self.scale == "linear" else self.unbounded(z)


@dataclass(frozen=True)
class Tie:
    """`name` always has the value `factor * other`; `other` is a declared parameter."""

    name: str
    other: str
    factor: float = 1.0


@dataclass(frozen=True)
class Around:
    """Parameters that are drawn about a common mean, which is not known, with this standard deviation [their unit]."""

    members: tuple[str, ...]
    std: float

    def __post_init__(self) -> None:
        if not 0 < self.std < math.inf:
            raise IdentificationError(
                f"{self.members[0]}: around", f"std {self.std:g} is not positive", "give one above 0"
            )


@dataclass(frozen=True)
class ParameterSet:
    """All parameters of an estimation, the ties between them, and what is known of how they are spread.

    Raises:
        IdentificationError: a name twice, a tie to something undeclared, a factor that is not finite.
    """

    parameters: tuple[Parameter, ...]
    ties: tuple[Tie, ...] = ()
    around: tuple[Around, ...] = ()

    def __post_init__(self) -> None:
        refuse_duplicates(self.names)
        declared = {parameter.name for parameter in self.parameters}
        for tie in self.ties:
            if tie.other not in declared:
                known = ", ".join(sorted(declared)) or "none"
                raise IdentificationError(
                    tie.name,
                    f"is tied to '{tie.other}', which is no declared parameter",
                    f"tie it to: {known}",
                )
            if not math.isfinite(tie.factor):
                raise IdentificationError(tie.name, f"is tied with factor {tie.factor}", "give a finite factor")

    @property
    def names(self) -> tuple[str, ...]:
        """Every name that gets a value: declared ones, then tied ones."""
        return (*(p.name for p in self.parameters), *(tie.name for tie in self.ties))

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that z moves, in its order."""
        return tuple(parameter for parameter in self.parameters if not parameter.fixed)

    @property
    def z_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of z, (n,) each."""
        bounds = np.array([parameter.z_bounds for parameter in self.free]).reshape(-1, 2)
        return bounds[:, 0], bounds[:, 1]

    @property
    def reach(self) -> FloatArray:
        """The longest steps in z, (n,)."""
        return np.array([parameter.reach for parameter in self.free])

    def values(self, z: FloatArray) -> dict[str, float]:
        """name -> value [its unit] for all parameters and ties, at z (n,)."""
        free = {p.name: p.value(float(zi)) for p, zi in zip(self.free, z, strict=True)}
        values = {p.name: free.get(p.name, p.start) for p in self.parameters}
        return values | {tie.name: tie.factor * values[tie.other] for tie in self.ties}

    def z(self, values: Mapping[str, float]) -> FloatArray:
        """(n,) z at these values; a free parameter without a value is at its start."""
        return np.array([p.z(values.get(p.name, p.start)) for p in self.free])

    def slopes(self, z: FloatArray) -> FloatArray:
        """(n,) d value / d z [unit each]."""
        return np.array([p.slope(float(zi)) for p, zi in zip(self.free, z, strict=True)])

    @property
    def informed(self) -> tuple[Parameter, ...]:
        """The parameters, fixed ones too, of which something is known before."""
        return tuple(p for p in self.parameters if p.prior is not None)

    @property
    def is_known_of(self) -> bool:
        """Whether something is known before of any, alone or of how they are spread."""
        return bool(self.informed or self.around)

    def held(self, name: str, value: float) -> ParameterSet:
        """The same set with one parameter fixed at this value [its unit]."""
        held = (replace(p, start=value, fixed=True) if p.name == name else p for p in self.parameters)
        return replace(self, parameters=tuple(held))

    def fixed_at(self, values: Mapping[str, float]) -> ParameterSet:
        """The same set with every parameter fixed at its value here (at its start when it has none)."""
        return replace(
            self,
            parameters=tuple(replace(p, start=values.get(p.name, p.start), fixed=True) for p in self.parameters),
        )


@dataclass(frozen=True)
class InitialState:
    """A start value that every window has of its own, as `component.variable`.

    Attributes:
        start: one value a window [unit]: the measured ones, or where their estimation begins.
        lower: smallest value allowed [unit].
        upper: largest value allowed [unit].
        estimated: False keeps the values at `start`; True fits one value a window.
    """

    name: str
    start: tuple[float, ...]
    lower: float = -math.inf
    upper: float = math.inf
    estimated: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "start", tuple(float(value) for value in self.start))
        _check_range(self.name, self.start, self.lower, self.upper)

    @cached_property
    def size(self) -> float:
        """One unit of z [unit], the same for all windows."""
        return _size(max(abs(value) for value in self.start), self.lower, self.upper)

    @property
    def z_bounds(self) -> tuple[FloatArray, FloatArray]:
        """Lower and upper bounds of z, (W,) each."""
        start = np.array(self.start)
        return (self.lower - start) / self.size, (self.upper - start) / self.size

    def value(self, window: int, z: float) -> float:
        """Value in a window at z [unit], never outside the bounds by rounding."""
        return min(max(self.start[window] + z * self.size, self.lower), self.upper)


def refuse_duplicates(names: Iterable[str]) -> None:
    """Nothing, when the names are distinct.

    Raises:
        IdentificationError: a name comes twice.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise IdentificationError(name, "is declared twice", "declare it once: free, fixed or tied")
        seen.add(name)


def _check_range(name: str, starts: tuple[float, ...], lower: float, upper: float) -> None:
    if not starts:
        raise IdentificationError(name, "has no start value", "give one a window")
    if not lower < upper:
        raise IdentificationError(name, f"bounds {lower:g} and {upper:g} leave no room", "let lower < upper")
    for start in starts:
        if not (math.isfinite(start) and lower <= start <= upper):
            raise IdentificationError(
                name, f"start {start:g} is not within {lower:g} to {upper:g}", "move the start or the bounds"
            )


def _size(start: float, lower: float, upper: float) -> float:
    if start:
        return abs(start)
    width = upper - lower
    return 0.01 * width if math.isfinite(width) else 1.0
