"""A tube about a reference, open in value and in time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
from pydantic import Field, model_validator

from orchestrator.fmi.interface import Port
from orchestrator.measures import FunnelTolerance, funnel
from orchestrator.scenario.expectations.base import ExpectationScope, Judgement, Tube
from orchestrator.scenario.expectations.figure import shown
from orchestrator.scenario.expectations.limits import inside
from orchestrator.scenario.expectations.quantities import Distance, Share, brought
from orchestrator.scenario.expectations.reference import Tubed, too_wide
from orchestrator.trace import FloatArray
from orchestrator.yaml_file import Block, Time


class FunnelBlock(Block):
    """How far a signal may be from its reference, in value and in time; what is given for the value adds up.

    Attributes:
        time: by how much it may come earlier or later [s].
        leading, lagging: instead of `time`, by how much it may come earlier, or later [s].
    """

    explained_by = (FunnelTolerance,)

    value: Distance = 0.0
    relative: Share = Field(0.0, ge=0)
    of_range: Share = Field(0.0, ge=0)
    time: Time | None = Field(None, ge=0)
    leading: Time | None = Field(None, ge=0)
    lagging: Time | None = Field(None, ge=0)

    @model_validator(mode="after")
    def _open(self) -> Self:
        if self.time is not None and (self.leading is not None or self.lagging is not None):
            raise ValueError("give `time`, or `leading` and `lagging`")
        if str(self.value).strip().startswith("-"):
            raise ValueError("`value` must not be negative")
        if not self.model_fields_set:
            raise ValueError("give `value`, `relative`, `of_range`, `time`, `leading` or `lagging`")
        return self

    @property
    def tolerance(self) -> FunnelTolerance:
        """As plain numbers, when it is brought."""
        either = self.time or 0.0
        return FunnelTolerance(
            float(self.value), self.relative, self.of_range, self.leading or either, self.lagging or either
        )


@dataclass(frozen=True)
class Funnel(Tubed):
    """Every sample lies in a tube about the reference, open in value and in time."""

    block: FunnelBlock

    def __str__(self) -> str:
        given = self.block
        parts = [f"{shown(given.value)}"] if given.value else []
        parts += [f"{given.relative:.3g} of its amount"] if given.relative else []
        parts += [f"{given.of_range:.3g} of its range"] if given.of_range else []
        early, late = given.leading or given.time or 0.0, given.lagging or given.time or 0.0
        times = f", {early:g} s early to {late:g} s late" if early or late else ""
        return f"stays in a funnel of {' + '.join(parts) or '0'}{times} about {self.reference.name}"

    def brought(self, place: str, port: Port, wiring: ExpectationScope) -> Self:
        return replace(super().brought(place, port, wiring), block=brought(self.block, place, port))

    def compared(self, time: FloatArray, values: FloatArray, hold: bool) -> Judgement:
        tube = self.about(time, hold)
        return replace(inside(time, values, tube), doubt=too_wide(tube, self.reference.during(time)))

    def about(self, time: FloatArray, hold: bool) -> Tube:
        return funnel(time, self.reference.samples.time, self.reference.values, self.block.tolerance, hold)

    def precision(self, values: FloatArray) -> float:
        tolerance = self.block.tolerance
        least = tolerance.width(float(np.ptp(values))) + tolerance.relative * float(np.min(np.abs(values)))
        return least or super().precision(values)
