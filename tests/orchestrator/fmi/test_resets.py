"""A run after another, an instance beside another, and many of them: none leaves a trace in the next."""

from __future__ import annotations

import gc
import os
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from fmus.packaging import targets
from orchestrator.assembly.wiring import wire
from orchestrator.engine import Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from tests.support.simulation.slaves import Load
from tests.support.tools import third_party


def own(folder: Path) -> Path:
    return targets.build("pendulum", folder / "pendulum.fmu", target="python")


def van_der_pol(version: int) -> Callable[[Path], Path]:
    return lambda folder: third_party.reference(version, "VanDerPol")


SETS: dict[str, tuple[Callable[[Path], Path], dict[str, Value], dict[str, Value]]] = {
    "own": (own, {"fmu.angle_start": 0.5}, {"fmu.added_mass": 0.1, "fmu.added_length": 0.1, "fmu.speed_start": 1.0}),
    "fmi2": (van_der_pol(2), {"fmu.mu": 2.0}, {"fmu.x0": 0.5}),
    "fmi3": (van_der_pol(3), {"fmu.mu": 2.0}, {"fmu.x0": 0.5}),
}


@pytest.mark.parametrize("kind", SETS)
def test_run_a_after_run_b_is_bitwise_run_a(kind: str, tmp_path: Path) -> None:
    source, a, b = SETS[kind]
    with FmuFile(source(tmp_path)) as fmu:
        system = wire({"fmu": Part(fmu.interface)}, [])
        with Simulation(system, {"fmu": Slave(fmu, "fmu")}, Timing(Fraction(1), Fraction(1, 100))) as made:
            first, other, again = made.run(a).trace, made.run(b).trace, made.run(a).trace
    for name in first.names:
        assert np.array_equal(first[name], again[name])
    assert any(not np.array_equal(first[name], other[name]) for name in first.names)


def resident() -> int:
    """Memory of this process [bytes]."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("kind", SETS)
def test_memory_does_not_grow_over_two_thousand_resets(kind: str, tmp_path: Path) -> None:
    source, values, _ = SETS[kind]
    with FmuFile(source(tmp_path)) as fmu:
        system = wire({"fmu": Part(fmu.interface)}, [])
        with Simulation(system, {"fmu": Slave(fmu, "fmu")}, Timing(Fraction(2, 100), Fraction(1, 100))) as made:
            for _ in range(300):
                made.run(values)
            before = resident()
            for _ in range(2000):
                made.run(values)
            assert resident() - before < 512 * 1024


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="memory is read from /proc")
@pytest.mark.parametrize("version", [2, 3])
def test_memory_does_not_grow_over_instances(version: int) -> None:
    with FmuFile(third_party.reference(version, "VanDerPol")) as fmu:

        def grown(count: int) -> int:
            """What so many instances leave behind once garbage is collected, which Python does the more seldom the more
            other tests keep [bytes]; the heap may grow once for other reasons."""
            gc.collect()
            before = resident()
            for _ in range(count):
                Slave(fmu, "fmu").close()
            gc.collect()
            return resident() - before

        grown(200)
        assert any(grown(1500) < 2 << 20 for _ in range(3))


def test_two_instances_of_one_fmu_do_not_share_values(load: Load, tmp_path: Path) -> None:
    with FmuFile(own(tmp_path)) as fmu:
        one, other = Slave(fmu, "one"), Slave(fmu, "other")
        one.set({"inertia": 0.5})
        assert (one.get("inertia"), other.get("inertia")) == (0.5, 0.00325)
        one.close()
        other.close()
