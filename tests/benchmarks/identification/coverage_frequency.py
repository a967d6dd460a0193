"""Do the resonance study's 95 % intervals cover? The synthetic campaign of Section 2.3 with noise on the angle.

The 65 sine experiments run once through the FMUs; every draw adds white noise to all of them and repeats the
corrected Steps 1-4.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from identification.recordings.campaign import load_campaign
from identification.resonance.schema import ResonanceBlock
from identification.resonance.steps import Experiment, study
from identification.resonance.study import CampaignStudy
from identification.study import load_study

from ..figure import Figure, Interval, coverage

STUDY = Path(__file__).parents[3] / "scenarios" / "butterfly" / "synthetic.yaml"
NOISE = 3e-4  # rms on the angle [rad]: 1 to 30 % of the amplitudes of the campaign
DRAWS, MANY = 100, 400
SIGNAL = "hand.angle"


def campaign() -> tuple[CampaignStudy, list[Experiment]]:
    """The study file and its experiments without noise, simulated."""
    block = load_study(STUDY).block
    assert isinstance(block, ResonanceBlock)
    asked = block.study(STUDY.parent)
    return asked, [asked.campaign.experiment(trace) for trace in load_campaign(asked.traces)]


def noisy(experiments: Sequence[Experiment], rng: np.random.Generator) -> list[Experiment]:
    """The experiments with white noise on the angle."""
    return [
        replace(
            one,
            trace=replace(one.trace, signals={SIGNAL: one.trace[SIGNAL] + NOISE * rng.normal(size=len(one.trace))}),
        )
        for one in experiments
    ]


def intervals(asked: CampaignStudy, experiments: Sequence[Experiment], draws: int) -> list[dict[str, Interval]]:
    """p1..p4 -> 95 % interval, for each draw of the noise."""
    window = asked.processing.window
    found = []
    for draw in range(draws):
        result = study(noisy(experiments, np.random.default_rng([0, draw])), window, SIGNAL)
        found.append({name: value.ci95 for name, value in result.parameters.items()})
    return found


def truth(asked: CampaignStudy) -> dict[str, float]:
    """p1..p4 of the simulated rig."""
    return {name: asked.truth[variable] for name, variable in asked.write.items()}


def figures(draws: int = DRAWS) -> list[Figure]:
    """Coverage of p1, p2, p3 and p4."""
    asked, experiments = campaign()
    return coverage("resonance study", intervals(asked, experiments, draws), truth(asked))


def endurance() -> list[Figure]:
    """The same with a narrower band."""
    return figures(MANY)
