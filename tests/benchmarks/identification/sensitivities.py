"""What the exact Jacobian of a run costs beside forward differences, with 10 parameters and start values.

The work is a window of the Butterfly, as in `window_overhead`: one run that carries 10 tangents, and the 11 runs that
forward differences take.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from time import process_time

from orchestrator.assembly.assembly import open_system
from orchestrator.engine import Run, Simulation, Timing

from ..figure import Figure
from .window_overhead import COMPONENTS, CONNECTIONS, REPEATS, START, STEP, STEPS, window

BY = (*START, "hand.angle_start", "hand.speed_start", "motor.resistance")
THIRD = 1 / 3  # of the time of forward differences


def figures() -> list[Figure]:
    """Processor time of both; the least of many counts."""
    with open_system(COMPONENTS, CONNECTIONS, ["motor.voltage"]) as opened:
        simulation = opened.simulation(Timing(stop=STEPS * STEP, step=STEP))
        run = window(0)
        differences = least(lambda: forward(simulation, run))
        exact = least(lambda: simulation.sensitivities(run, BY))
    share = exact / differences
    return [
        Figure(f"forward differences by {len(BY)} values", "-", f"{1e6 * differences:.0f} µs"),
        Figure("the exact Jacobian", "-", f"{1e6 * exact:.0f} µs"),
        Figure(
            "the exact Jacobian takes of the differences' time", f"at most {THIRD:.2f}", f"{share:.2f}", share <= THIRD
        ),
    ]


def forward(simulation: Simulation, run: Run) -> None:
    """The runs of forward differences."""
    simulation.rows(run)
    for name in BY:
        simulation.rows(replace(run, values={**run.values, name: 1.0001 * float(run.values[name])}))


def least(work: Callable[[], object]) -> float:
    """Processor time of work [s]."""
    spent = []
    for _ in range(REPEATS):
        begun = process_time()
        work()
        spent.append(process_time() - begun)
    return min(spent)
