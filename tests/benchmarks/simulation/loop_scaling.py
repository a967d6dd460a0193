"""Is the cost linear? Time over components and over steps, and memory of the longest run."""

from __future__ import annotations

import tracemalloc
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from time import perf_counter

import numpy as np

from orchestrator.assembly.wiring import wire
from orchestrator.engine import Order, Run, Simulation, Sink, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.tools import third_party

from ..figure import Figure

ROOT = Path(__file__).parents[3]
COMPONENTS = (2, 5, 20, 60, 200)
STEPS = (1_000, 10_000, 100_000, 1_000_000)
MANY = 10_000_000
WORK = 400_000  # steps times components, when the components are counted
STEP = Fraction(1, 1000)  # [s]
REPEATS = 5
RECORD = "c0.Float64_continuous_output"


def figures(counts: tuple[int, ...] = STEPS) -> list[Figure]:
    """Fitted exponents of time, and memory of the longest run with and without a sink."""
    most = counts[-1]
    with ExitStack() as stack:
        file = stack.enter_context(FmuFile(third_party.reference(2, "Feedthrough")))
        wide = [per_step(file, count, WORK // count) for count in COMPONENTS]
        pair = stack.enter_context(ring(file, 2))
        long = [taken(pair, count, 1 if count > 10**6 else REPEATS) for count in counts]
        kept, streamed, thinned = (
            peak(pair, run, sink)
            for run, sink in (
                (of_length(most), None),
                (of_length(most), lambda piece: None),
                (of_length(most, 100), None),
            )
        )
    return [
        exponent(f"time over {COMPONENTS[0]} to {COMPONENTS[-1]} components", COMPONENTS, wide),
        exponent(f"time over {counts[1]:.0e} to {most:.0e} steps", counts[1:], long[1:]),
        Figure("the shortest run, 1e3 steps", "-", f"{1e3 * long[0]:.2f} ms"),
        memory(f"{most:.0e} steps, one signal kept", kept, 8 * most * 4),
        memory("the same, every 100th row", thinned, 8 * most // 100 * 4 + 2**22),
        memory("the same, into a sink", streamed, 2**22),
    ]


def endurance() -> list[Figure]:
    """The same up to 1e7 steps."""
    return figures((*STEPS, MANY))


def ring(file: FmuFile, count: int) -> Simulation:
    """FMUs in a ring, in Jacobi order."""
    parts = {f"c{number}": Part(file.interface) for number in range(count)}
    links = [
        (f"c{(number - 1) % count}.Float64_continuous_output", f"c{number}.Float64_continuous_input")
        for number in range(count)
    ]
    timing = Timing(MANY * STEP, STEP, order=Order.JACOBI)
    return Simulation(wire(parts, links), {name: Slave(file, name) for name in parts}, timing)


def of_length(steps: int, every: int = 1) -> Run:
    return Run(record=[RECORD], stop=steps * STEP, record_every=every)


def per_step(file: FmuFile, count: int, steps: int) -> float:
    """Time of one more step of all components [s]."""
    with ring(file, count) as simulation:
        return (taken(simulation, steps, REPEATS) - taken(simulation, 1, REPEATS)) / (steps - 1)


def taken(simulation: Simulation, steps: int, repeats: int) -> float:
    """The least of some times of a run [s]."""
    times = []
    for _ in range(repeats):
        begun = perf_counter()
        simulation.execute(of_length(steps))
        times.append(perf_counter() - begun)
    return min(times)


def peak(simulation: Simulation, run: Run, sink: Sink | None) -> int:
    """Most memory that Python and NumPy had at once [B]."""
    tracemalloc.start()
    simulation.execute(run, sink=sink)
    found = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return found


def exponent(name: str, sizes: tuple[int, ...], times: list[float]) -> Figure:
    """The slope of log time over log size."""
    slope = float(np.polyfit(np.log(sizes), np.log(times), 1)[0])
    return Figure(f"exponent of {name}", "at most 1.1", f"{slope:.3f}", slope <= 1.1)


def memory(name: str, found: int, limit: int) -> Figure:
    return Figure(f"memory: {name}", f"under {limit / 1e6:.0f} MB", f"{found / 1e6:.1f} MB", found < limit)
