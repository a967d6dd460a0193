"""The study file of a tuning on simulated closed loops."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import Field, model_validator

from identification.recordings.schema import StudyBlock
from identification.tuning.goals.table import MEASURES
from identification.tuning.procedures.schema import SearchBlock
from identification.tuning.schema import GoalBlock, RigBlock, TermBlock, require_wanted, wanted
from identification.tuning.simulated.study import LoopSpec, SimulatedStudy
from orchestrator.assembly.schema import ComponentBlock
from orchestrator.assembly.whole_arrays import Values, elements
from orchestrator.yaml_file import Block


class SimulatedLoopBlock(Block):
    """A closed loop, a case of a scenario.

    Attributes:
        scenario: its file, relative to this one.
        set: component.variable -> value over those of the file.
    """

    explained_by = (LoopSpec,)

    scenario: Path
    component: str = LoopSpec.component
    case: str | None = LoopSpec.case
    set: Values = {}

    def spec(self, base: Path) -> LoopSpec:
        """As a plain value."""
        return LoopSpec(base / self.scenario, self.component, self.case, elements(self.set))


class SimulatedBlock(StudyBlock):
    """A study that finds the values of any controller's FMU for several simulated closed loops at once, nonlinear ones.

    Attributes:
        controller: what is tuned, as a component of a scenario; its values are where searches start.
        goals: bounds that the design has to hold, or, `soft`, should.
        minimise: what is to be small besides, summed up by weight.
        design: the unknowns, and how they are sought.
        plants: name -> a scenario in which the controller closes the loop; the reference's last step is the move.
        judged_on: further scenarios, all of whose expectations the design has to hold.
    """

    explained_by = (SimulatedStudy,)

    method: Literal["tune-simulated"]
    controller: ComponentBlock
    plants: dict[str, SimulatedLoopBlock] = Field(min_length=1)
    reference: str
    tracked: str
    command: str | None = None
    band: float = Field(SimulatedStudy.band, gt=0, lt=1)
    limit: float | None = Field(SimulatedStudy.limit, gt=0)
    goals: list[GoalBlock] = []
    minimise: list[TermBlock] = []
    design: SearchBlock
    judged_on: list[RigBlock] = []

    @model_validator(mode="after")
    def _asked(self) -> SimulatedBlock:
        require_wanted(self.goals, self.minimise)
        for asked in (*self.goals, *self.minimise):
            if "signal" not in MEASURES[asked.measure].needs:
                raise ValueError(f"'{asked.measure}' is of linear loops; use `method: tune` for it")
            if asked.disturbed is not None:
                raise ValueError("`disturbed` is of linear loops; let a scenario of its own disturb the plant")
        return self

    def study(self, base: Path) -> SimulatedStudy:
        """The study as plain values; `base` is the folder of its file."""
        return SimulatedStudy(
            self.title,
            self.controller.spec(base),
            {name: block.spec(base) for name, block in self.plants.items()},
            self.reference,
            self.tracked,
            self.command,
            wanted(self.goals, self.minimise),
            self.design.procedure(),
            self.band,
            self.limit,
            self.description,
            tuple(block.rig(base) for block in self.judged_on),
        )
