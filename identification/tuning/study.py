"""What a study of tuning asks, as plain values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from identification.tuning.goals.goal import Over, Relative
from identification.tuning.procedures.procedure import Procedure
from identification.tuning.rig import Rig
from identification.tuning.sources.plants import PlantSpec
from orchestrator.assembly.assembly import ComponentSpec
from orchestrator.fmi.interface import Value

CONTROLLER, PLANT = "controller", "plant"
"""How connections call the two."""


@dataclass(frozen=True)
class GoalSpec:
    """A goal as the study names it; see `goals.goal.Goal`.

    Attributes:
        place: its key in the study, for messages.
        opened: a connection.
        of: component.variable, an output of the plant or an input of it.
        disturbed: an input of the plant.
    """

    place: str
    measure: str
    lower: float | str | None = None
    upper: float | str | None = None
    weight: float = 1.0
    hard: bool = True
    opened: str | None = None
    of: str | None = None
    disturbed: str | None = None
    relative: Relative | None = None
    over: Over = "sum"


@dataclass(frozen=True)
class StepSpec:
    """The steps that responses answer to.

    Attributes:
        height: of the reference [its unit].
        duration: how long responses are followed [s].
        disturbance: height of what is added to a plant's input [its unit].
        band: share of the height within which a response has settled.
        limit: of the command [its unit], which linear loops do not have; what counts as saturation.
    """

    height: float = 1.0
    limit: float | None = None
    duration: float = 5.0
    disturbance: float = 1.0
    band: float = 0.02


@dataclass(frozen=True)
class DrawSpec:
    """Draws of the plants whose parameters have a spread.

    Attributes:
        count: how many of each such plant the search sees; as many more show what its values do with others.
        seed: of the draws.
        share: of all draws that has to hold all hard goals.
    """

    count: int = 1000
    seed: int = 0
    share: float = 0.99


@dataclass(frozen=True)
class TuningStudy:
    """A controller, the plants it is tuned for at once, and what is asked.

    Attributes:
        connections: (source, target) between `plant` and `controller`.
        reference: the controller's input that tells where to go.
        tracked: the plant's output that is to follow it; the loop is opened there for margins.
        delay: computing delay, from a sample to the command that comes of it [s].
        rigs: on which what is found is judged before it is written back.
        around: plant -> values that the controller has around it, over the others: where a schedule of gains stands.
    """

    title: str
    controller: ComponentSpec
    plants: Mapping[str, PlantSpec]
    connections: tuple[tuple[str, str], ...]
    reference: str
    tracked: str
    goals: tuple[GoalSpec, ...]
    procedure: Procedure
    step: StepSpec = StepSpec()
    delay: float = 0.0
    draws: DrawSpec | None = None
    description: str = ""
    rigs: tuple[Rig, ...] = ()
    around: Mapping[str, Mapping[str, Value]] = field(default_factory=dict)
