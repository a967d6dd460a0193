"""The study file of the pendulum thesis' Steps 1-4."""

from __future__ import annotations

from typing import Literal

from pydantic import model_validator

from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from orchestrator.assembly.schema import SystemBlock
from orchestrator.yaml_file import Block


class SineBlock(Block):
    """What each trace of a sine campaign was made with: constants, or fields of the file's name.

    Attributes:
        signal: the measured angle.
        added_length: [m].
    """

    signal: str
    added_mass: str | float
    added_length: str | float
    amplitude: str | float
    frequency: str | float
    frequency_in: Literal["rad/s", "Hz"] = "rad/s"


class BoundsBlock(Block):
    """Start (the middle by default) and bounds of p1, p2 and p3, in this order, for the regression of Eq. 102."""

    start: tuple[float, float, float] | None = None
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


class ResonanceBlock(RecordedStudyBlock, SystemBlock):
    """A study of sine recordings by Steps 1-4 of the pendulum thesis.

    Attributes:
        script: which script's treatment of the recordings the published method repeats.
        write: p1, p2, p3 and p4 -> the FMU's parameter that takes it.
        take: whose estimates are written back.
    """

    method: Literal["resonance"]
    campaign: SineBlock
    script: Literal["synthetic", "recordings"]
    bounds: BoundsBlock
    write: dict[Literal["p1", "p2", "p3", "p4"], str]
    take: Literal["published", "corrected"] = "corrected"
    truth: dict[str, float] = {}

    @property
    def signals(self) -> UsedSignals:
        """What it uses of the traces."""
        return UsedSignals(measured=frozenset({self.campaign.signal}))

    @model_validator(mode="after")
    def _nothing_unused(self) -> ResonanceBlock:
        if self.traces.hold_out or self.traces.values:
            raise ValueError("`traces.hold_out` and `traces.values` mean nothing here; remove them")
        return self
