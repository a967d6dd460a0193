"""What a study by the pendulum thesis' Steps 1-4 is asked, as plain values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from fmus.errors import ScenarioError
from identification.recordings.campaign import StudyTrace, TraceSource
from identification.recordings.marks import nothing_left, pieces, require_known
from identification.resonance.added_mass import AddedMassBounds
from identification.resonance.steps import Experiment, Processing
from orchestrator.assembly.assembly import SystemSpec

Lumped = Literal["p1", "p2", "p3", "p4"]
Taken = Literal["published", "corrected"]


@dataclass(frozen=True)
class SineCampaign:
    """What each trace of a sine campaign was made with: constants, or fields of the file's name.

    Attributes:
        signal: the measured angle.
        added_mass: mass fixed to the body [kg].
        added_length: its distance from the axis [m].
        amplitude: of the sine [input unit].
        frequency: of the sine, in the unit of `frequency_in`.
        frequency_in: `rad/s` or `Hz`.
    """

    signal: str
    added_mass: str | float
    added_length: str | float
    amplitude: str | float
    frequency: str | float
    frequency_in: Literal["rad/s", "Hz"] = "rad/s"

    def experiment(self, recorded: StudyTrace) -> Experiment:
        """A trace, the longest part of it between its marks, with what its name tells about it.

        Raises:
            ScenarioError: its name does not tell a field.
            TraceError: marks leave nothing of it.
        """
        between = pieces(recorded.trace, recorded.marks)
        if not between:
            raise nothing_left(recorded.place, "nothing is", recorded.marks)
        require_known(recorded.excluded_as, between, [self.signal])
        turn = 2 * math.pi if self.frequency_in == "Hz" else 1.0
        return Experiment(
            max(between, key=lambda piece: piece.duration),
            _value(self.added_mass, recorded),
            _value(self.added_length, recorded),
            _value(self.amplitude, recorded),
            turn * _value(self.frequency, recorded),
        )


def _value(given: str | float, recorded: StudyTrace) -> float:
    if not isinstance(given, str):
        return float(given)
    if given not in recorded.fields:
        raise ScenarioError(
            f"campaign, {recorded.trace.name}",
            f"no field '{given}'",
            f"there are {', '.join(recorded.fields) or 'none'}",
        )
    return recorded.fields[given]


@dataclass(frozen=True)
class CampaignStudy:
    """A sine campaign whose parameters are to be found, and where they go.

    Attributes:
        processing: the script whose treatment of the recordings the published method repeats.
        bounds: within which p1, p2 and p3 are sought by the regression of Eq. 102.
        write: p1, p2, p3 and p4 -> component.parameter that takes it.
        take: whose estimates are written, `published` or `corrected`.
        truth: component.parameter -> the value behind synthetic traces, shown beside the estimate.
    """

    title: str
    system: SystemSpec
    traces: TraceSource
    campaign: SineCampaign
    processing: Processing
    bounds: AddedMassBounds
    write: Mapping[Lumped, str]
    description: str = ""
    take: Taken = "corrected"
    truth: Mapping[str, float] = field(default_factory=dict)
