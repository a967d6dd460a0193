"""Many runs, and many lives of FMUs: each is as if it were the only one, and nothing is left behind."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from orchestrator.assembly.wiring import wire
from orchestrator.engine import (
    Engine,
    Run,
    Simulation,
    Timing,
)
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.simulation.both_loops import STEP, Case, Shelf, bits

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def resources() -> tuple[int, int]:
    """Resident memory [B] and number of shared libraries of this process."""
    gc.collect()
    maps = Path("/proc/self/maps").read_text().splitlines()
    libraries = {line.split()[-1] for line in maps if ".so" in line}
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"), len(libraries)


def leaves(cycle: Callable[[], object], count: int) -> str:
    """What so many cycles leave behind each time, four times one after the other; nothing where one time did not.

    What leaks does so each time; allocators that fill their pools or take a new one do not.
    """
    grown = ""
    before = resources()
    for _ in range(4):
        for _ in range(count):
            cycle()
        after = resources()
        memory, libraries = after[0] - before[0], after[1] - before[1]
        if memory < 500 * count and not libraries:
            return ""
        grown, before = f"{memory} bytes and {libraries} libraries more", after
    return grown


linux_only = pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="needs /proc")


@linux_only
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["Feedthrough2", "Feedthrough3"])
def test_a_thousand_instances_leave_nothing_behind(shelf: Shelf, kind: str) -> None:
    file = shelf[kind]
    system = wire({"c0": Part(file.interface)}, [])
    timing = Timing(100 * STEP, STEP)

    def cycle() -> None:
        with Simulation(system, {"c0": Slave(file, "c0")}, timing) as made:
            made.run()

    assert leaves(cycle, 1000) == ""


@linux_only
def test_a_thousand_runs_of_one_simulation_leave_nothing_behind(shelf: Shelf) -> None:
    with Case(("Feedthrough2", "VanDerPol3"), steps=10).simulation(shelf, Engine.AUTO) as made:
        assert leaves(made.run, 1000) == ""


def test_many_runs_are_the_runs_one_by_one(shelf: Shelf) -> None:
    case = Case(("VanDerPol2", "Feedthrough2"), stimuli={"c1.Float64_continuous_input": np.zeros(21)})
    waves = [np.random.default_rng(seed).normal(size=21) for seed in range(4)]
    runs = [
        Run({"c0.mu": float(n)}, {"c1.Float64_continuous_input": wave}, ["c0.x1", "c1.Float64_continuous_output"])
        for n, wave in enumerate(waves)
    ]
    with case.simulation(shelf, Engine.AUTO) as made:
        results = [made.execute(run) for run in runs]
    for run, result in zip(runs, results, strict=True):
        with case.simulation(shelf, Engine.AUTO) as alone:
            assert bits(result.trace) == bits(alone.run(run.values, run.stimuli, run.record).trace)
