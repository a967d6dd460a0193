"""How long the calibration from the real recordings takes and how much memory, and what a step of an FMU costs.

The cost of a step is measured between runs of two lengths, so loading and initialising do not count; FMPy's own
loop on the same FMU in the same process is the reference.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import fmpy
import numpy as np

from orchestrator.assembly.assembly import Assembled, ComponentSpec, OpenSystem, SystemSpec, assemble
from orchestrator.engine import Timing

from ..figure import Figure

ROOT = Path(__file__).parents[3]
STUDY = ROOT / "scenarios" / "butterfly" / "calibration.yaml"
LIMIT, STARTS, MANY_LIMIT = 4.0, 20, 15.0  # [s], and with so many starts
MEMORY_LIMIT = 500e6  # [B]
FIT = 0.94
STEP = 0.005  # [s]
SHORT, LONG, REPEATS = 500, 4500, 3


def figures() -> list[Figure]:
    """Calibration time, memory and FIT where the recordings are there, and the cost of a step."""
    return [*calibration(), *step_cost()]


def calibration() -> list[Figure]:
    """The whole `servotwin calibrate` on the real recordings, FMUs from the cache; from one start and from many."""
    data = Path(os.environ.get("SERVOTWIN_DATA", ROOT.parent / "shared" / "data")) / "butterfly"
    if not data.is_dir():
        return [Figure("real calibration", "recordings", f"none in {data} (set SERVOTWIN_DATA)")]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        many = folder / "many.yaml"
        many.write_text(f"{STUDY.read_text(encoding='utf-8')}options: {{starts: {STARTS}}}\n", encoding="utf-8")
        peak = _watched(STUDY, data, folder / "watched")  # the FMUs are in the cache from here on
        one, several = _timed(STUDY, data, folder / "one"), _timed(many, data, folder / "many")
        fit = json.loads((folder / "one" / "summary.json").read_text(encoding="utf-8"))["fit"]["validation"]["median"]
    processors = os.cpu_count() or 1
    return [
        Figure(
            f"real calibration, report included: wall time on {processors} processors",
            f"at most {LIMIT:g} s",
            f"{one:.1f} s",
            one <= LIMIT,
        ),
        Figure(
            f"with {STARTS} starts",
            f"at most {MANY_LIMIT:g} s",
            f"{several:.1f} s",
            several <= MANY_LIMIT,
        ),
        Figure(
            "real calibration: peak memory, all processes",
            f"under {MEMORY_LIMIT / 1e6:.0f} MB",
            f"{peak / 1e6:.0f} MB",
            peak < MEMORY_LIMIT,
        ),
        Figure("real calibration: median FIT, unseen recordings", f"{FIT} or more", f"{fit:.3f}", fit >= FIT),
    ]


def _timed(study: Path, data: Path, out: Path) -> float:
    """Wall time of a calibration by command [s]."""
    begun = time.perf_counter()
    subprocess.run(_command(study, data, out), cwd=ROOT, check=True)
    return time.perf_counter() - begun


def _watched(study: Path, data: Path, out: Path) -> int:
    """Most memory of all processes of a calibration by command [B].

    Raises:
        CalledProcessError: it failed.
    """
    peak = 0
    with subprocess.Popen(_command(study, data, out), cwd=ROOT) as process:
        while process.poll() is None:
            peak = max(peak, sum(_memory(pid) for pid in _family(process.pid)))
            time.sleep(0.1)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, "servotwin calibrate")
    return peak


def _command(study: Path, data: Path, out: Path) -> list[str]:
    command = [sys.executable, "-c", "from identification.cli import main; main()", "calibrate", str(study)]
    return [*command, "--data", str(data), "--out", str(out), "-q"]


def _family(pid: int) -> list[int]:
    """A process and all below it."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        children = []
    return [pid, *(below for child in children for below in _family(int(child)))]


def _memory(pid: int) -> int:
    """Resident memory of a process, what it shares with others by its share of that [B]; Linux only."""
    try:
        rollup = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return 1024 * sum(int(line.split()[1]) for line in rollup if line.startswith("Pss:"))


def step_cost() -> list[Figure]:
    """Nanoseconds a step of the pendulum's Python FMU takes in our loop and in FMPy's."""
    system = SystemSpec({"hand": ComponentSpec("pendulum")})
    with tempfile.TemporaryDirectory() as folder:
        assembled = assemble(system, Path(folder), ("hand.torque",))
        ours, theirs = _marginal(_our_runs(assembled)), _marginal(_fmpy_runs(assembled.files["hand"]))
    return [
        Figure("Python FMU, our loop: per FMU and step", "-", f"{ours:.0f} ns"),
        Figure("Python FMU, FMPy's simulate_fmu: per step", "-", f"{theirs:.0f} ns"),
        Figure("our loop against FMPy's", "no slower", f"{theirs / ours:.2f} times as fast", ours <= theirs),
    ]


def _torque(count: int) -> np.ndarray:
    return 0.01 * np.sin(3 * STEP * np.arange(count + 1))


def _our_runs(assembled: Assembled) -> Callable[[int], None]:
    def run(count: int) -> None:
        step = Fraction(STEP).limit_denominator(1000)
        with OpenSystem(assembled) as opened, opened.simulation(Timing(count * step, step)) as simulation:
            simulation.run(stimuli={"hand.torque": _torque(count)})

    return run


def _fmpy_runs(fmu: Path) -> Callable[[int], None]:
    description = fmpy.read_model_description(fmu)
    outputs = [v.name for v in description.modelVariables if v.causality == "output"]

    def run(count: int) -> None:
        rows = list(zip(STEP * np.arange(count + 1), _torque(count), strict=True))
        stimulus = np.array(rows, dtype=[("time", float), ("torque", float)])
        fmpy.simulate_fmu(
            str(fmu), stop_time=count * STEP, output_interval=STEP, input=stimulus, output=outputs, validate=False
        )

    return run


def _marginal(run: Callable[[int], None]) -> float:
    """Time of one more step [ns], the least of a few measurements of each length."""
    least = {}
    for count in (SHORT, LONG):
        times = []
        for _ in range(REPEATS):
            begun = time.perf_counter()
            run(count)
            times.append(time.perf_counter() - begun)
        least[count] = min(times)
    return 1e9 * (least[LONG] - least[SHORT]) / (LONG - SHORT)
