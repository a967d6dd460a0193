"""Does anything grow? 100,000 cycles of instantiate, run 100 steps, free; and 1,000,000 resets. Linux only.

Takes about ten minutes, most of it in FMPy's instantiation.
"""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from time import perf_counter

from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.tools import third_party

from ..figure import Figure

ROOT = Path(__file__).parents[3]
CYCLES, RESETS = 100_000, 1_000_000
TIMING = Timing(Fraction(20), Fraction(1, 5))  # 100 steps
MEMORY_LIMIT = 4e6  # [B]: what an allocator may keep, 40 B a cycle


def endurance() -> list[Figure]:
    """Growth of memory and of loaded libraries, for an FMU of either version."""
    found = []
    with ExitStack() as stack:
        for version in (2, 3):
            file = stack.enter_context(FmuFile(third_party.reference(version, "Feedthrough")))
            slave = Slave(file, "fmu")
            stack.callback(slave.close)
            found += grown(f"FMI {version}: instantiate, 100 steps, free", lambda f=file: live(f), CYCLES // 2)
            found += grown(f"FMI {version}: reset", lambda s=slave: reset(s), RESETS // 2)
    return found


def live(file: FmuFile) -> None:
    """A whole life of an instance."""
    system = wire({"fmu": Part(file.interface)}, [])
    with Simulation(system, {"fmu": Slave(file, "fmu")}, TIMING) as simulation:
        simulation.run()


def reset(slave: Slave) -> None:
    """Initialise and reset."""
    slave.begin(0.0, None)
    slave.run()
    slave.reset()


def grown(name: str, cycle: Callable[[], None], count: int) -> list[Figure]:
    """Memory and libraries gained, after a hundredth of the cycles to warm up."""
    for _ in range(max(count // 100, 200)):
        cycle()
    memory, libraries = resources()
    begun = perf_counter()
    for _ in range(count):
        cycle()
    each = (perf_counter() - begun) / count
    after = resources()
    gain, loaded = after[0] - memory, after[1] - libraries
    return [
        Figure(
            f"{name}, {count:,} times: memory gained",
            f"under {MEMORY_LIMIT / 1e6:.0f} MB",
            f"{gain / 1e6:.2f} MB",
            gain < MEMORY_LIMIT,
        ),
        Figure(f"{name}, {count:,} times: libraries gained", "0", f"{loaded}", loaded == 0),
        Figure(f"{name}: time", "-", f"{1e6 * each:.0f} µs"),
    ]


def resources() -> tuple[int, int]:
    """Resident memory [B] and number of shared libraries of this process."""
    gc.collect()
    libraries = {line.split()[-1] for line in Path("/proc/self/maps").read_text().splitlines() if ".so" in line}
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE"), len(libraries)
