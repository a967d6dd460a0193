"""The study file of the pendulum thesis' Steps 1-4."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from pydantic import model_validator

from identification.recordings.schema import RecordedStudyBlock, UsedSignals
from identification.resonance.added_mass import AddedMassBounds
from identification.resonance.steps import RECORDINGS_SCRIPT, SYNTHETIC_SCRIPT, Processing
from identification.resonance.study import CampaignStudy, Lumped, SineCampaign, Taken
from orchestrator.assembly.schema import SystemBlock
from orchestrator.yaml_file import Block

SCRIPTS: dict[str, Processing] = {"synthetic": SYNTHETIC_SCRIPT, "recordings": RECORDINGS_SCRIPT}


class SineBlock(Block):
    """What each trace of a sine campaign was made with: each a number, or the name of a field of the file's name."""

    explained_by = (SineCampaign,)

    signal: str
    added_mass: str | float
    added_length: str | float
    amplitude: str | float
    frequency: str | float
    frequency_in: Literal["rad/s", "Hz"] = SineCampaign.frequency_in


class BoundsBlock(Block):
    """Start and bounds of p1, p2 and p3, in this order, for the regression of Eq. 102.

    Attributes:
        start: where it begins, the middle by default.
        lower, upper: the bounds.
    """

    start: tuple[float, float, float] | None = None
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]

    def bounds(self) -> AddedMassBounds:
        first, second, third = ((low + high) / 2 for low, high in zip(self.lower, self.upper, strict=True))
        return AddedMassBounds(self.start or (first, second, third), self.lower, self.upper)


class ResonanceBlock(RecordedStudyBlock, SystemBlock):
    """A study of sine recordings by Steps 1-4 of the pendulum thesis.

    Attributes:
        script: whose treatment of the recordings the published method repeats.
    """

    explained_by = (CampaignStudy,)

    method: Literal["resonance"]
    campaign: SineBlock
    script: Literal["synthetic", "recordings"]
    bounds: BoundsBlock
    write: dict[Lumped, str]
    take: Taken = CampaignStudy.take
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

    def study(self, base: Path) -> CampaignStudy:
        """The study as plain values; `base` is the folder of its file."""
        return CampaignStudy(
            self.title,
            self.system(base),
            self.source(base),
            SineCampaign(**dict(self.campaign)),
            SCRIPTS[self.script],
            self.bounds.bounds(),
            self.write,
            self.description,
            self.take,
            self.truth,
        )
