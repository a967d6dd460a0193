"""What subspace identification costs here and in other tools, and how well the models predict an unseen record.

The work: 12,000 samples of a system of order 18 with one input and four outputs, 5 % of noise, block size 40. The error
is delta-bar (the manipulator thesis, Eq. 2-25) of a free run along another input, against the noise-free outputs. A
second figure is a record of a million samples.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from identification.estimation.validation import delta
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.subspace import subspace
from identification.subspace.weightings import Weighting

from ..environments import python_with
from ..figure import Figure
from ..memory import peak_megabytes
from .subspace_peers import TOOLS

ROOT = Path(__file__).parents[3]
PACKAGES = ("nfoursid==1.0.2", "sippy-unipi==1.0.1")
STEP, BLOCK, ORDER, SAMPLES, REPEATS = 1 / 300, 40, 18, 12_000, 5
WEIGHTINGS: tuple[Weighting, ...] = ("orse", "n4sid", "moesp", "cva")
COUNTERPARTS: dict[str, Weighting] = {
    "nfoursid": "moesp",
    "sippy_n4sid": "n4sid",
    "sippy_moesp": "moesp",
    "sippy_cva": "cva",
}
FASTER, LONG, LONG_SECONDS, LONG_MEGABYTES = 10, 1_000_000, 30, 2_000


@dataclass(frozen=True)
class Measured:
    """Seconds of the quickest repetition, and delta-bar on the unseen record."""

    seconds: float
    error: float


def figures() -> list[Figure]:
    """Every method's time and error, ours beside its counterparts', and the long record."""
    true, rng = lightly_damped(ORDER // 2), np.random.default_rng(1)
    seen, unseen = excited(true, SAMPLES, rng), excited(true, SAMPLES, rng, noise=0.0)
    ours = {weighting: ours_measured(weighting, seen, unseen) for weighting in WEIGHTINGS}
    found = [shown(f"subspace, weighting {weighting}", each) for weighting, each in ours.items()]
    for tool in TOOLS:
        found += against(tool, ours[COUNTERPARTS[tool]], seen, unseen)
    return found + [figure for weighting in ("orse", "cva") for figure in long_record(weighting)]


def lightly_damped(modes: int) -> LinearModel:
    """A system of so many pairs of poles, between 1 and 130 Hz, with 1 to 5 % of damping."""
    rng = np.random.default_rng(0)
    omega, damping = 2 * np.pi * np.geomspace(1, 130, modes), rng.uniform(0.01, 0.05, modes)
    poles = np.exp(omega * STEP * (-damping + 1j * np.sqrt(1 - damping**2)))
    a = np.zeros((2 * modes, 2 * modes))
    for i, pole in enumerate(poles):
        a[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = [[pole.real, pole.imag], [-pole.imag, pole.real]]
    b = rng.standard_normal((2 * modes, 1)) * np.repeat(1 - np.abs(poles), 2)[:, None]
    return LinearModel(
        a, b, rng.standard_normal((4, 2 * modes)), np.zeros((4, 1)), STEP, ("u1",), ("y1", "y2", "y3", "y4")
    )


def excited(system: LinearModel, samples: int, rng: np.random.Generator, noise: float = 0.05) -> InputOutputData:
    """A record under white excitation; `noise` is relative to each output's standard deviation."""
    u = rng.standard_normal((samples, 1))
    y = system.simulate(u)
    return InputOutputData(u, y + noise * y.std(axis=0) * rng.standard_normal(y.shape), STEP)


def error(model: LinearModel, unseen: InputOutputData) -> float:
    """Delta-bar of the free run from rest."""
    return float(np.mean(delta(unseen.y, model.simulate(unseen.u))))


def ours_measured(weighting: Weighting, seen: InputOutputData, unseen: InputOutputData) -> Measured:
    """Time of all that `subspace` does."""
    settings, taken = SubspaceSettings(BLOCK, weighting, feedthrough=True), []
    for _ in range(REPEATS):
        begun = perf_counter()
        result = subspace(seen, ORDER, settings)
        taken.append(perf_counter() - begun)
    return Measured(min(taken), error(result.model, unseen))


def against(tool: str, ours: Measured, seen: InputOutputData, unseen: InputOutputData) -> list[Figure]:
    """Another tool beside our method with the same weights; one line with the reason where it does not run."""
    try:
        theirs = peer_measured(tool, seen, unseen)
    except (OSError, subprocess.SubprocessError, ValueError) as failure:
        output = getattr(failure, "stderr", None) or str(failure)
        return [Figure(tool, "-", f"does not run: {(output.strip().splitlines() or ['no word why'])[-1][:60]}")]
    times = theirs.seconds / ours.seconds
    counterpart = COUNTERPARTS[tool]
    return [
        shown(tool, theirs),
        Figure(f"{tool} takes x times ours, {counterpart}", f"at least {FASTER}", f"{times:.0f}", times >= FASTER),
        Figure(
            f"our error over that of {tool}",
            "at most 1",
            f"{ours.error / theirs.error:.3f}",
            ours.error <= theirs.error,
        ),
    ]


def peer_measured(tool: str, seen: InputOutputData, unseen: InputOutputData) -> Measured:
    """The tool's times and error."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "data.npz", Path(folder) / "model.npz"
        np.savez(source, u=seen.u, y=seen.y, block=BLOCK, order=ORDER)
        command = [
            python_with("subspace_peers", *PACKAGES),
            str(Path(__file__).with_name("subspace_peers.py")),
            tool,
            str(source),
            str(target),
        ]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800)
        with np.load(target) as matrices:
            a, b, c, d = (matrices[name] for name in "abcd")
            model = LinearModel(a, b, c, d, STEP, seen.inputs, seen.outputs)
    return Measured(min(map(float, json.loads(done.stdout.splitlines()[-1]))), error(model, unseen))


def long_record(weighting: Weighting) -> list[Figure]:
    """Time and peak memory of a million samples, in a process of its own."""
    command = [sys.executable, "-m", "tests.benchmarks.identification.subspace_speed", weighting]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800, cwd=ROOT)
    seconds, busy, megabytes = (float(each) for each in done.stdout.split())
    name = f"{LONG:,} samples, weighting {weighting}"
    return [
        Figure(name, f"under {LONG_SECONDS} s", f"{seconds:.1f} s, {busy:.1f} s busy", seconds < LONG_SECONDS),
        Figure(
            f"{name}: peak memory", f"under {LONG_MEGABYTES:,} MB", f"{megabytes:,.0f} MB", megabytes < LONG_MEGABYTES
        ),
    ]


def print_long_record(weighting: Weighting) -> None:
    """Seconds of the estimate, seconds of a processor, and the process' peak memory [MB]."""
    record = excited(lightly_damped(ORDER // 2), LONG, np.random.default_rng(2))
    begun, busy = perf_counter(), process_time()
    subspace(record, ORDER, SubspaceSettings(BLOCK, weighting, feedthrough=True))
    print(perf_counter() - begun, process_time() - busy, peak_megabytes())


def shown(name: str, measured: Measured) -> Figure:
    return Figure(name, "-", f"{measured.seconds:.2f} s, delta {100 * measured.error:.2f} %")


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print_long_record(sys.argv[1])  # type: ignore[arg-type]
