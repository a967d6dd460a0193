"""How long 1,000 runs of one system take: energy control from other starts with other parameters each, 10 s of each.

The scenario's system at its own steps, through the batch interface: instances are reset between runs. Some of the runs
are repeated alone, on instances of their own, and must give the same bits.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np

from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.engine import Result, Run
from orchestrator.fmi.interface import Value
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario

from ..figure import Figure

SCENARIO = Path(__file__).parents[3] / "scenarios" / "butterfly" / "energy_control.yaml"
RUNS, REPEATS = 1_000, 5
STOP = Fraction(10)  # [s]
LIMIT = 20.0  # [s]
ALONE = range(0, RUNS, RUNS // 20)  # the runs that are repeated alone


def figures() -> list[Figure]:
    """Time of all runs and of one, and whether runs alone give the same."""
    scenario = load_scenario(SCENARIO)
    with tempfile.TemporaryDirectory() as folder:
        begun = perf_counter()
        assembled = assemble(scenario.system, Path(folder))
        built = perf_counter() - begun
        own = scenario.system.values()
        runs = [Run(own | values, record=scenario.record, stop=STOP) for values in parameter_sets()]
        times, results = timed(scenario, assembled, runs)
        same = sum(equal(results[number], alone(scenario, assembled, runs[number])) for number in ALONE)
    whole = median(times)
    return [
        Figure(
            f"{RUNS:,} runs of 10 s of energy control, on one of {os.cpu_count()} processors",
            f"at most {LIMIT:g} s",
            f"{whole:.2f} s",
            whole <= LIMIT,
        ),
        Figure("a run, from the reset to the trace", "-", f"{1e3 * whole / RUNS:.2f} ms"),
        Figure("stepping of a run", "-", f"{1e3 * median(each.account.seconds for each in results):.2f} ms"),
        Figure("the FMUs built from the model files, before", "-", f"{built:.1f} s"),
        Figure(
            "runs that give the same bits alone",
            f"{len(ALONE)} of {len(ALONE)}",
            f"{same} of {len(ALONE)}",
            same == len(ALONE),
            certain=True,
        ),
    ]


def parameter_sets() -> list[dict[str, Value]]:
    """Starts with 0.6 to 1.4 times the orbit's energy, mechanisms that differ by up to 10 %, and other gains."""
    rng = np.random.default_rng(0)
    return [parameter_set(rng) for _ in range(RUNS)]


def parameter_set(rng: np.random.Generator) -> dict[str, Value]:
    """A start with the energy E = p1 w^2 / 2 + p3 (1 - cos a): the angle a has a part of it, the speed w the rest."""
    inertia, gravity = 0.00325 * rng.uniform(0.9, 1.1), 0.04905 * rng.uniform(0.9, 1.1)
    energy = gravity * (1 - np.cos(1.0)) * rng.uniform(0.6, 1.4)
    height = energy * rng.uniform()
    angle, speed = np.arccos(1 - height / gravity), np.sqrt(2 * (energy - height) / inertia)
    return {
        "hand.inertia": float(inertia),
        "hand.gravity_torque": float(gravity),
        "hand.viscous_friction": float(0.001 * rng.uniform(0.9, 1.1)),
        "hand.angle_start": float(angle * rng.choice([-1, 1])),
        "hand.speed_start": float(speed * rng.choice([-1, 1])),
        "controller.gain": float(rng.uniform(0.01, 0.03)),
    }


def timed(scenario: Scenario, assembled: Assembled, runs: Sequence[Run]) -> tuple[list[float], list[Result]]:
    """Times of all runs, opening the FMUs included [s], and the results of the last time."""
    times, results = [], []
    for _ in range(REPEATS):
        begun = perf_counter()
        with OpenSystem(assembled) as opened, opened.simulation(scenario.timing) as simulation:
            results = [simulation.execute(run) for run in runs]
        times.append(perf_counter() - begun)
    return times, results


def alone(scenario: Scenario, assembled: Assembled, run: Run) -> Result:
    with OpenSystem(assembled) as opened, opened.simulation(scenario.timing) as simulation:
        return simulation.execute(run)


def equal(one: Result, other: Result) -> bool:
    """Whether two traces agree in every bit."""
    names = one.trace.names
    return names == other.trace.names and all(
        one.trace[name].tobytes() == other.trace[name].tobytes() for name in names
    )
