"""What a design is asked, as plain values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Literal

from identification.output_error.study import OutputErrorStudy
from orchestrator.fmi.interface import Value
from orchestrator.scenario.scenario import Scenario
from orchestrator.trace import FloatArray

Criterion = Literal["D", "A", "E", "worst"]
WIDE = 3.0  # ratio of a range's ends from which it is searched by ratios


@dataclass(frozen=True)
class ListedValues:
    """Some values, one of which is taken."""

    values: tuple[Value, ...]

    def at(self, share: float) -> Value:
        """The value at a share (0 to 1) of the whole."""
        return self.values[min(int(share * len(self.values)), len(self.values) - 1)]


@dataclass(frozen=True)
class ValueRange:
    """All values between two; by their ratio where both are positive and far apart."""

    low: float
    high: float

    def at(self, share: float) -> float:
        """The value at a share (0 to 1) of the whole."""
        if self.low > 0 and self.high > WIDE * self.low:
            return float(self.low * (self.high / self.low) ** share)
        return self.low + share * (self.high - self.low)


Choice = ListedValues | ValueRange


@dataclass(frozen=True)
class Limit:
    """Between which values a variable of the rig has to stay."""

    above: float = -math.inf
    below: float = math.inf

    def beyond(self, value: float) -> float:
        """By how much a value exceeds it; negative inside."""
        return max(self.above - value, value - self.below)


@dataclass(frozen=True)
class SearchSpec:
    """How experiments are sought.

    Attributes:
        candidates: how many of each family are drawn.
        rounds: of looking near the best ones, nearer each time.
        neighbours: how many are tried of each experiment in each round.
        seed: of the draws.
    """

    candidates: int = 32
    rounds: int = 4
    neighbours: int = 8
    seed: int = 1


@dataclass(frozen=True)
class Sought:
    """A duration that is to be found: the shortest after which half-widths of 95 % intervals are small enough.

    Attributes:
        low, high: between which it lies [s].
        within: how nearly it is told [s].
        relative: the largest half-width, as a part of its value, of the parameters that the design is about.
        each: parameter -> largest half-width [its unit].
    """

    low: Fraction
    high: Fraction
    within: Fraction
    relative: float = math.inf
    each: Mapping[str, float] = field(default_factory=dict)

    def of_target(self, widths: Mapping[str, float], relative: float) -> float:
        """The largest of half-widths by parameter, and of the relative ones, over what it may be."""
        return max([relative / self.relative, *(widths[name] / most for name, most in self.each.items())])

    def __str__(self) -> str:
        whole = [] if math.isinf(self.relative) else [f"all half-widths at most {100 * self.relative:g} %"]
        return ", ".join([*whole, *(f"that of {name} at most {most:g}" for name, most in self.each.items())])


@dataclass(frozen=True)
class DurationTrial:
    """A duration that was tried.

    Attributes:
        duration: [s].
        of_target: the largest half-width over what it may be; infinite where it is not determined.
        problem: why there is none; nothing where there is.
    """

    duration: Fraction
    of_target: float
    problem: str = ""


@dataclass(frozen=True, eq=False)
class DesignStudy:
    """Experiments that are to be found for a calibration.

    Attributes:
        calibration: the study that will take their recordings.
        calibration_file: where that is from; None where it is from none.
        values: the parameters as they are known, over its starts.
        known: (n, n) information about the free parameters that there is already, in z; None without.
        rig: the scenario that stands for the rig; its recorder makes the recordings.
        rig_file: where that is from.
        families: name -> component.variable of the rig -> what it may be.
        vary: what may differ in all families.
        amplitude: the variable that is made smaller where a limit is exceeded.
        limits: component.variable of the rig -> within which it has to stay.
        count: of experiments.
        duration: of each [s]; the longest where it is sought.
        sought: what it has to reach, where it is to be found.
        criterion: "D" the volume, "A" the mean square, "E" the longest axis of the relative intervals' ellipsoid,
            "worst" the largest relative half-width.
        parameters: those that it is about.
        noise: output -> standard deviation of a compared sample [its unit]; of others it is that of the rig's sensors.
        compare: name -> cases of the rig's scenario that the design is held against.
        names: what experiments are called, with fields as `{number}` and `{hand.added_mass g}`.
    """

    title: str
    calibration: OutputErrorStudy
    values: Mapping[str, float]
    known: FloatArray | None
    rig: Scenario
    rig_file: Path
    calibration_file: Path | None
    families: Mapping[str, Mapping[str, Choice]]
    limits: Mapping[str, Limit]
    count: int
    duration: Fraction
    criterion: Criterion = "D"
    parameters: tuple[str, ...] = ()
    vary: Mapping[str, Choice] = field(default_factory=dict)
    amplitude: str | None = None
    noise: Mapping[str, float] = field(default_factory=dict)
    compare: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    names: str = "design_{number}"
    search: SearchSpec = SearchSpec()
    description: str = ""
    sought: Sought | None = None

    def space(self, family: str) -> dict[str, Choice]:
        """All that may differ in a family."""
        return {**self.vary, **self.families[family]}
