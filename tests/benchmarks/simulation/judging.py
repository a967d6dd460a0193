"""What judging a long run takes: a million samples against a reference of as many, at the same stamps and at others."""

from __future__ import annotations

import tempfile
from importlib.util import find_spec
from pathlib import Path
from time import process_time

import numpy as np

from orchestrator.measures import FunnelTolerance, funnel
from orchestrator.scenario.expectations import OnSignal, Ran
from orchestrator.scenario.expectations.funnel import Funnel, FunnelBlock
from orchestrator.scenario.expectations.reference import Reference
from orchestrator.trace import FloatArray, Trace

from ..figure import Figure

SAMPLES, FEW = 1_000_000, 20_000
LIMIT = 0.2  # [s]
REPEATS = 5


def figures() -> list[Figure]:
    """Processor time of a funnel, by how it is open in time and where the reference has its samples."""
    even = np.linspace(0.0, 1000.0, SAMPLES)
    uneven = np.sort(np.random.default_rng(0).uniform(0.0, 1000.0, SAMPLES))
    uneven[[0, -1]] = 0.0, 1000.0
    run = Ran(Trace(even, {"y": np.sin(even)}, {}, "run"))
    rows = [
        figure(f"{stamps}, open by {lag:g} s", run, expected(time, lag))
        for stamps, time in (("same stamps", even), ("other stamps", uneven))
        for lag in (0.0, 0.01, 1.0)
    ]
    return [*rows, beside_pyfunnel()] if find_spec("pyfunnel") else rows


def beside_pyfunnel() -> Figure:
    """How long a library takes for the same bounds of fewer samples, which it writes to files."""
    from pyfunnel import compareAndReport

    time = np.linspace(0.0, 1000.0, FEW)
    noisy = np.sin(time) + 0.1 * np.random.default_rng(1).normal(size=FEW)
    lists = [list(map(float, one)) for one in (time, noisy) * 2]
    with tempfile.TemporaryDirectory() as folder:
        begun = process_time()
        compareAndReport(*lists, outputDirectory=folder, atolx=0.5, atoly=0.01)
        theirs = process_time() - begun
    begun = process_time()
    funnel(time, time, noisy, FunnelTolerance(0.01, leading=0.5, lagging=0.5))
    ratio = theirs / (process_time() - begun)
    return Figure(
        f"bounds of {FEW:,} noisy samples by pyfunnel, against ours", "-", f"{theirs:.2f} s, {ratio:.0f} x as long"
    )


def expected(time: FloatArray, lag: float) -> OnSignal:
    reference = Reference(Trace(time, {"y": np.sin(time)}, {}, "reference"), "the reference", Path())
    return OnSignal("y", Funnel(reference, FunnelBlock(value=0.01, time=lag)))


def figure(name: str, run: Ran, asked: OnSignal) -> Figure:
    taken = []
    for _ in range(REPEATS):
        begun = process_time()
        check = asked.check(run)
        taken.append(process_time() - begun)
    assert check.held, check
    return Figure(
        f"judging {SAMPLES:,} samples by a funnel: {name}",
        f"under {LIMIT:g} s",
        f"{min(taken):.3f} s",
        min(taken) < LIMIT,
    )
