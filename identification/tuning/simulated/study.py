"""What a study of tuning on simulated closed loops asks, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from identification.tuning.procedures.search import Search
from identification.tuning.rig import Rig
from identification.tuning.study import CONTROLLER, GoalSpec
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Value


@dataclass(frozen=True)
class LoopSpec:
    """A closed loop: a case of a scenario.

    Attributes:
        component: of the scenario, in whose place the controller's FMU is put.
        case: its name, the first by default; what it expects is not judged.
        values: component.variable -> value over those of the file.
    """

    scenario: Path
    component: str = CONTROLLER
    case: str | None = None
    values: Mapping[str, Value] = field(default_factory=dict)


@dataclass(frozen=True)
class SimulatedStudy:
    """A controller, the loops it is tuned for at once, and what is asked.

    Attributes:
        reference, tracked: signals of all scenarios, in one unit: where to go, and what is to follow it.
        command: what the controller gives, for goals that are of it.
        band: part of a move within which it has settled.
        limit: of the command [its unit]; what counts as saturation.
        rigs: on which what is found is judged before it is written back.
    """

    title: str
    controller: ComponentSpec
    plants: Mapping[str, LoopSpec]
    reference: str
    tracked: str
    command: str | None
    goals: tuple[GoalSpec, ...]
    search: Search
    band: float = 0.02
    limit: float | None = None
    description: str = ""
    rigs: tuple[Rig, ...] = ()
