"""What an inverse-dynamics identification is asked, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from identification.inverse_dynamics.loop import PositionLoop
from identification.inverse_dynamics.terms import Term
from identification.recordings.campaign import TraceSource
from orchestrator.assembly.assembly import SystemSpec

Way = Literal["least-squares", "instrumental"]


@dataclass(frozen=True)
class Axis:
    """The signals of the axis, and what they are in the system.

    Attributes:
        position, command: signals.
        output, input: component.variable of them.
        gain: component.parameter by which the command is the force; None where it is the force itself.
    """

    position: str
    output: str
    command: str
    input: str
    gain: str | None = None


@dataclass(frozen=True)
class Filtering:
    """How motions are made of a recorded position.

    Attributes:
        cutoff: of the low-pass that forces and motions go through, where half passes [Hz]; at most a fifth of the rate.
        rows_per_second: of the regression; forces and columns are brought down to it through another low-pass.
        least_speed: samples that are slower are left out: dry friction at rest is anything up to its size.
    """

    cutoff: float
    rows_per_second: float = 100.0
    least_speed: float = 0.0


@dataclass(frozen=True)
class InverseDynamicsStudy:
    """Parameters of an axis to be found from its inverse model.

    Attributes:
        write: term -> component.parameter that takes its value.
        loop: the control that the axis was recorded in; with it there are instruments.
        take: whose values are written.
        compare, truth: values of others, and those behind synthetic traces.
    """

    title: str
    system: SystemSpec
    traces: TraceSource
    axis: Axis
    filtering: Filtering
    write: Mapping[Term, str]
    take: Way
    loop: PositionLoop | None = None
    description: str = ""
    compare: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    truth: Mapping[str, float] = field(default_factory=dict)
