"""How fast the closed loop of the flexible arm under PDPC steps: arm, drive, noisy and rounding sensors, controller.

Runs differ in move, payload, stiffness, torque constant and noise. What settles of such draws under each controller
`servotwin sweep` tells (`scenarios/flexible_arm/control/robustness`).
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from fractions import Fraction
from functools import partial
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

import numpy as np

from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.engine import Run, Simulation, Timing
from orchestrator.fmi.interface import Value
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import FloatArray
from tests.support.side_by_side import side_by_side

from ..figure import Figure

PDPC = Path(__file__).parents[3] / "scenarios" / "flexible_arm" / "control" / "pdpc.yaml"
RUNS, REPEATS = 1_000, 5
STOP = Fraction(20)  # [s]
LIMIT = 60.0  # [s]
REAL_TIME = 300.0
Draw = Mapping[str, Value]


def figures() -> list[Figure]:
    """Time of 1,000 closed loops, and how much faster than real time one is."""
    draws = [draw(np.random.default_rng(number)) for number in range(RUNS)]
    with tempfile.TemporaryDirectory() as folder:
        scenario = load_scenario(PDPC)
        assembled, timing = assemble(scenario.system, Path(folder)), replace(scenario.timing, stop=STOP)
        begun = perf_counter()
        count = ran(assembled, timing, draws)
        spent = perf_counter() - begun
        one = alone(assembled, timing, draws[0])
    return [
        Figure(
            f"{RUNS:,} runs of 20 s of the arm under PDPC, on {os.cpu_count()} processors",
            f"at most {LIMIT:g} s",
            f"{spent:.1f} s",
            spent <= LIMIT,
        ),
        Figure(
            "one of them, in processor time",
            f"at least {REAL_TIME:g} x faster than real time",
            f"{float(STOP) / one:.0f} x",
            float(STOP) / one >= REAL_TIME,
        ),
        Figure("runs that came to their end", f"{RUNS:,}", f"{count:,}", count == RUNS, certain=True),
    ]


def draw(rng: np.random.Generator) -> dict[str, Value]:
    """Another arm, drive and noise, and a move."""
    noise = rng.uniform(0.5, 2.0)
    given = {
        "source.amplitude": rng.choice([1.0, 3.0, 5.0]),
        "arm.payload": rng.uniform(0.0, 0.4),
        "arm.bending_stiffness": 7.906 * rng.normal(1, 0.01),
        "drive.torque_constant": 0.5876 * rng.uniform(0.9, 1.1),
        "potentiometer.noise": 0.002 * noise,
        "tachometer.noise": 0.005 * noise,
        "middle_gauge.noise": 0.06 * noise,
    }
    seeds = {f"{name}.seed": int(rng.integers(2**31)) for name in ("potentiometer", "tachometer", "middle_gauge")}
    return {name: float(value) for name, value in given.items()} | seeds


def ran(assembled: Assembled, timing: Timing, draws: Sequence[Draw]) -> int:
    """How many runs come to their end, on all processors."""
    samples = int(timing.stop * 300) + 1
    return side_by_side(partial(Arm, assembled, timing), draws, os.cpu_count() or 1).count(samples)


class Arm:
    """The closed loop, open in one process: of a draw it tells how many samples it gives."""

    def __init__(self, assembled: Assembled, timing: Timing) -> None:
        self._assembled, self._stack = assembled, ExitStack()
        self._running = self._stack.enter_context(simulation(assembled, timing))

    def __call__(self, one: Draw) -> int:
        return len(angles(self._running, self._assembled, one))

    def close(self) -> None:
        """Free the FMUs."""
        self._stack.close()


def alone(assembled: Assembled, timing: Timing, one: Draw) -> float:
    """Processor time of a run [s]."""
    times = []
    with simulation(assembled, timing) as opened:
        for _ in range(REPEATS):
            begun = thread_time()
            angles(opened, assembled, one)
            times.append(thread_time() - begun)
    return median(times)


@contextmanager
def simulation(assembled: Assembled, timing: Timing) -> Iterator[Simulation]:
    with OpenSystem(assembled) as opened, opened.simulation(timing) as running:
        yield running


def angles(opened: Simulation, assembled: Assembled, one: Draw) -> FloatArray:
    """(K,) the hub's angle [rad] at 300 Hz over one move: the square does not turn round before the end."""
    values = assembled.system.values() | {"source.frequency": 0.01} | dict(one)
    return opened.rows(Run(values, record=["arm.angle"], record_every=round(Fraction(1, 300) / opened.timing.step)))[
        :, 0
    ]
