"""What judging a long run takes: a million samples against a reference of as many, at the same stamps and at others."""

from __future__ import annotations

from pathlib import Path
from time import process_time

import numpy as np

from orchestrator.scenario.expectations import OnSignal, Ran
from orchestrator.scenario.expectations.funnel import Funnel, FunnelBlock
from orchestrator.scenario.expectations.reference import Reference
from orchestrator.trace import FloatArray, Trace

from ..figure import Figure

SAMPLES = 1_000_000
LIMIT = 0.2  # [s]
REPEATS = 5


def figures() -> list[Figure]:
    """Processor time of a funnel, by how it is open in time and where the reference has its samples."""
    even = np.linspace(0.0, 1000.0, SAMPLES)
    uneven = np.sort(np.random.default_rng(0).uniform(0.0, 1000.0, SAMPLES))
    uneven[[0, -1]] = 0.0, 1000.0
    run = Ran(Trace(even, {"y": np.sin(even)}, {}, "run"))
    return [
        figure(f"{stamps}, open by {lag:g} s", run, expected(time, lag))
        for stamps, time in (("same stamps", even), ("other stamps", uneven))
        for lag in (0.0, 0.01, 1.0)
    ]


def expected(time: FloatArray, lag: float) -> OnSignal:
    reference = Reference(Trace(time, {"y": np.sin(time)}, {}, "reference"), "the reference", Path())
    return OnSignal("y", Funnel(reference, FunnelBlock(value=0.01, time=lag)))


def figure(name: str, run: Ran, funnel: OnSignal) -> Figure:
    taken = []
    for _ in range(REPEATS):
        begun = process_time()
        check = funnel.check(run)
        taken.append(process_time() - begun)
    assert check.held, check
    return Figure(
        f"judging {SAMPLES:,} samples by a funnel: {name}",
        f"under {LIMIT:g} s",
        f"{min(taken):.3f} s",
        min(taken) < LIMIT,
    )
