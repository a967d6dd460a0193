"""What a recalibration near a motion is asked, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

from identification.motion.balance import Lumped
from identification.recordings.campaign import TraceSource
from orchestrator.assembly.assembly import SystemSpec

Way = Literal["balance", "invariant", "published"]


@dataclass(frozen=True)
class MotionSignals:
    """The signals of the traces, and what they are in the system.

    Attributes:
        angle, speed, voltage: signals; None where speed or voltage was not recorded.
        output: component.variable of the angle.
        angle_start, speed_start: component.parameter where free runs begin.
        input: component.input that the voltage drives in free runs.
    """

    angle: str
    output: str
    angle_start: str
    speed_start: str
    speed: str | None = None
    voltage: str | None = None
    input: str | None = None

    @property
    def units(self) -> dict[str, str]:
        """Signal -> the unit that the relations of the motion are in."""
        named = {self.angle: "rad", self.speed: "rad/s", self.voltage: "V"}
        return {signal: unit for signal, unit in named.items() if signal is not None}


@dataclass(frozen=True)
class TubeSpec:
    """Free runs in the tube around the motion.

    Attributes:
        periods: how many periods of the motion each lasts.
        skip: what is left out of every trace first, the approach [s].
        at_least: how many times smaller the recalibrated model's error has to be than the generic one's.
    """

    periods: float = 10.0
    skip: Fraction = Fraction(0)
    at_least: float | None = None


@dataclass(frozen=True)
class MotionStudy:
    """A generic model to be recalibrated near the motion that recordings show.

    Attributes:
        step: communication step of the free runs [s].
        equilibrium: component.parameter with the angle of the downward equilibrium.
        write: lumped parameter -> component.parameter that have its value, and take the new one.
        held: which of p1 to p4 is known; a motion tells all but a common factor.
        take: whose values are written.
        controller: the component whose E* and gain brought the motion about; None where it is not known.
        truth: component.parameter -> the value behind synthetic traces, shown beside the estimate.
    """

    title: str
    system: SystemSpec
    traces: TraceSource
    signals: MotionSignals
    step: Fraction
    equilibrium: str
    write: Mapping[Lumped, tuple[str, ...]]
    held: Lumped = "p4"
    take: Way = "balance"
    controller: str | None = None
    tube: TubeSpec | None = None
    description: str = ""
    truth: Mapping[str, float] = field(default_factory=dict)

    @property
    def dry_friction(self) -> bool:
        """Whether a component takes dry friction."""
        return "dry_positive" in self.write

    @property
    def free_system(self) -> SystemSpec:
        """The system without what drives the voltage there."""
        links = tuple(link for link in self.system.connections if link[1] != self.signals.input)
        return SystemSpec(self.system.components, links)
