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
from identification.resonance.calibration import SCRIPTS, experiment
from identification.resonance.schema import ResonanceBlock
from identification.resonance.steps import Experiment, study
from identification.study import load_study

from .figure import Figure, Interval, coverage

STUDY = Path(__file__).parents[2] / "scenarios" / "butterfly" / "synthetic.yaml"
NOISE = 3e-4  # rms on the angle [rad]: 1 to 30 % of the amplitudes of the campaign
DRAWS, MANY = 100, 400
SIGNAL = "hand.angle"


def campaign() -> tuple[ResonanceBlock, list[Experiment]]:
    """The study file and its experiments without noise, simulated."""
    block = load_study(STUDY).block
    assert isinstance(block, ResonanceBlock)
    recorded = load_campaign(block.source(STUDY.parent))
    return block, [experiment(block.campaign, each) for each in recorded]


def noisy(experiments: Sequence[Experiment], rng: np.random.Generator) -> list[Experiment]:
    """The experiments with white noise on the angle."""
    return [
        replace(
            each,
            trace=replace(each.trace, signals={SIGNAL: each.trace[SIGNAL] + NOISE * rng.normal(size=len(each.trace))}),
        )
        for each in experiments
    ]


def intervals(block: ResonanceBlock, experiments: Sequence[Experiment], draws: int) -> list[dict[str, Interval]]:
    """p1..p4 -> 95 % interval, for each draw of the noise."""
    window = SCRIPTS[block.script].window
    found = []
    for draw in range(draws):
        result = study(noisy(experiments, np.random.default_rng([0, draw])), window, SIGNAL)
        found.append({name: value.ci95 for name, value in result.parameters.items()})
    return found


def truth(block: ResonanceBlock) -> dict[str, float]:
    """p1..p4 of the simulated rig."""
    return {name: block.truth[variable] for name, variable in block.write.items()}


def figures(draws: int = DRAWS) -> list[Figure]:
    """Coverage of p1, p2, p3 and p4."""
    block, experiments = campaign()
    return coverage("resonance study", intervals(block, experiments, draws), truth(block))


def endurance() -> list[Figure]:
    """The same with a narrower band."""
    return figures(MANY)
