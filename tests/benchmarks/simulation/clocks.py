"""How many ticks of FMI 3.0's clocks a second are handled on one core, by how many of them fall into a step."""

from __future__ import annotations

import os
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

from orchestrator import open_system
from orchestrator.assembly.assembly import OpenSystem
from tests.support.fmus import clocks

from ..figure import Figure

ASKED = 1e6  # ticks a second and core
TICKS, RUNS = 100_000, 3
COUNTED = ("tick", "trigger", "countdown")


def figures() -> list[Figure]:
    """Ticks per second of processor time: many a step, one a step, passed on to another component, and counted down
    there."""
    with TemporaryDirectory() as folder:
        kinds = {
            "tick": 'intervalVariability="constant" intervalDecimal="1e-5"',
            **{name: clocks.CLOCKS[name] for name in ("trigger", "out", "countdown")},
        }
        counting = clocks.build(Path(folder), kinds, name="counting")
        del kinds["countdown"]
        plain = clocks.build(Path(folder), kinds)
        load = f"load {os.getloadavg()[0]:.1f}"
        found = []
        passed = "1,000 ticks in a step, a third of them to another component"
        for name, fmu, parts, step in (
            ("1,000 ticks of a clock in a step", plain, ("a",), "0.01"),
            ("a tick of a clock in a step", plain, ("a",), "1e-5"),
            (passed, plain, ("a", "b"), "0.01"),
            (f"{passed}, which counts down after each", counting, ("a", "b"), "0.01"),
        ):
            wires = ["a.out -> b.trigger"] if "b" in parts else []
            with open_system(dict.fromkeys(parts, fmu), wires) as system:
                rate = max(_rate(system, step) for _ in range(RUNS))
            found.append(Figure(f"{name}, {load}", f"{ASKED:,.0f} ticks/s", f"{rate:,.0f} ticks/s", rate >= ASKED))
        return found


def _rate(system: OpenSystem, step: str) -> float:
    """Ticks of all components per second of processor time."""
    recorded = [f"{part}.n_{clock}" for part in system.system.parts for clock in COUNTED]
    begun = process_time()
    trace = system.run(
        f"{TICKS}e-5", step, {f"{part}.delay": 1e-5 for part in system.system.parts}, record=recorded
    ).trace
    return float(sum(trace[name][-1] for name in recorded)) / (process_time() - begun)
