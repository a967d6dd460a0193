"""What a step costs in our loops, in a hand-written C loop on the same binary, and in other tools.

The work: five Reference FMUs `Feedthrough` (FMI 2.0) in a ring, 20,000 steps of 1 ms, Jacobi order as in the other
tools. Either every output of every FMU is recorded at every step ("all", five each), or the one that drives the ring
("ring"): that is what ecos and libcosim move when nothing observes them, although they keep nothing of it. Our times
are of the whole run, from the reset to the trace, those of the C loop from its first step to the last. Beside the C
loop the processor's time is taken, which other programs hardly change; beside the tools the time that passes. libcosim
does not read the file's `dependencies`, and CoFmuPy sets every input as a real number: they are given copies of the
FMU whose description lacks what they stumble over, with the same binary.
"""

from __future__ import annotations

import ctypes
import json
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from statistics import median
from time import perf_counter, thread_time

import fmpy
import numpy as np

from orchestrator.assembly.wiring import wire
from orchestrator.engine import Engine, Order, Result, Simulation, Timing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Value
from orchestrator.fmi.slave import Slave
from orchestrator.system import Part
from orchestrator.trace import FloatArray
from tests.support.tools import third_party

from ..environments import python_with
from ..figure import Figure

ROOT = Path(__file__).parents[3]
HERE = Path(__file__).parent
COUNT, STEPS, REPEATS = 5, 20_000, 5
STEP = Fraction(1, 1000)  # [s]
OUTPUTS = (
    "Float64_continuous_output",
    "Float64_discrete_output",
    "Int32_output",
    "Enumeration_output",
    "Boolean_output",
)
C_LIMIT = {"ring": 1.10, "all": 1.5}  # times the C loop


@dataclass(frozen=True)
class Peer:
    """Another tool: how many times its time ours is to be reached, and which record of ours compares with its own."""

    title: str
    limit: float
    record: str


PEERS = {
    "ecos": Peer("ecos 0.7.2, recording nothing", 10, "ring"),
    "ecos_read": Peer("ecos 0.7.2, the ring's outputs read at each step", 10, "ring"),
    "ecos_csv": Peer("ecos 0.7.2 with its CSV writer", 50, "all"),
    "libcosim": Peer("libcosim 0.0.6, recording nothing", 25, "ring"),
    "libcosim_observer": Peer("libcosim 0.0.6 with its file observer", 60, "all"),
    "fmpy_loop": Peer("FMPy, a loop over its slaves", 60, "all"),
    "cofmupy": Peer("CoFmuPy 1.0", 150, "all"),
}


def figures() -> list[Figure]:
    """Nanoseconds per FMU and step of every loop, and what ours is against each."""
    fmu = third_party.reference(2, "Feedthrough")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        file = stack.enter_context(FmuFile(fmu))
        ours = stack.enter_context(our_ring(file, Engine.COMPILED))
        by_hand = CLoop(file, Path(folder))
        found = []
        for kind in ("all", "ring"):
            found += against_c(kind, ours, by_hand)
        python = stack.enter_context(our_ring(file, Engine.PYTHON))
        found.append(Figure("our Python loop, all outputs", "-", nanoseconds(repeated(lambda: seconds(python, "all")))))
        copies = {"cofmupy": described_anew(fmu, Path(folder) / "reals.fmu", reals_only)}
        plain = described_anew(fmu, Path(folder) / "plain.fmu", without_dependencies)
        for tool, peer in PEERS.items():
            found += against_peer(tool, peer, copies.get(tool, plain), ours)
    return found


def against_c(kind: str, ours: Simulation, by_hand: CLoop) -> list[Figure]:
    """Our loop beside the hand-written one."""
    agreed = np.array_equal(by_hand.record(kind), rows(ours.run(start_values(), record=recorded(kind)), kind))
    times = interleaved({"ours": lambda: seconds(ours, kind, thread_time), "c": lambda: by_hand.seconds(kind)})
    return [
        Figure(f"our compiled loop, {kind}: a step of an FMU", "-", nanoseconds(times["ours"])),
        Figure(f"hand-written C loop, {kind}", "-", nanoseconds(times["c"])),
        Figure(f"every sample is that of the C loop, {kind}", "yes", "yes" if agreed else "no", agreed),
        ratio(f"our compiled loop takes, {kind},", times["ours"], times["c"], "the C loop", at_most=C_LIMIT[kind]),
    ]


def our_ring(file: FmuFile, engine: Engine) -> Simulation:
    """The ring in our engine."""
    parts = {f"c{number}": Part(file.interface) for number in range(COUNT)}
    links = [
        (f"c{(number - 1) % COUNT}.Float64_continuous_output", f"c{number}.Float64_continuous_input")
        for number in range(COUNT)
    ]
    timing = Timing(STEPS * STEP, STEP, order=Order.JACOBI, engine=engine)
    return Simulation(wire(parts, links), {name: Slave(file, name) for name in parts}, timing)


def start_values() -> dict[str, Value]:
    """As in the C loop, so that every column differs."""
    reals = {f"c{number}.Float64_discrete_input": number + 0.5 for number in range(COUNT)}
    return reals | {f"c{number}.Int32_input": number + 1 for number in range(COUNT)}


def recorded(kind: str) -> list[str]:
    """Names of what is recorded, in the order of the C loop."""
    return [f"c{number}.{output}" for number in range(COUNT) for output in (OUTPUTS if kind == "all" else OUTPUTS[:1])]


def seconds(simulation: Simulation, kind: str, clock: Callable[[], float] = perf_counter) -> float:
    """Time of one whole run [s]."""
    begun = clock()
    simulation.run(start_values(), record=recorded(kind))
    return clock() - begun


def rows(result: Result, kind: str) -> FloatArray:
    """(K, n) the record as the C loop has it."""
    return np.column_stack([result.trace[name] for name in recorded(kind)])


class CLoop:
    """`c_loop.c`, compiled here."""

    def __init__(self, file: FmuFile, folder: Path) -> None:
        compiler = shutil.which("cc")
        if compiler is None:
            raise RuntimeError("there is no C compiler to build the hand-written loop with")
        library = folder / "c_loop.so"
        headers = Path(fmpy.__file__).parent / "c-code"
        subprocess.run(
            [compiler, "-O3", "-shared", "-fPIC", f"-I{headers}", str(HERE / "c_loop.c"), "-ldl", "-o", str(library)],
            check=True,
        )
        self._ring = ctypes.CDLL(str(library)).ring
        self._ring.restype = ctypes.c_double
        self._ring.argtypes = [ctypes.c_char_p] * 3 + [
            ctypes.c_int,
            ctypes.c_long,
            ctypes.c_double,
            ctypes.c_int,
            ctypes.c_void_p,
        ]
        binary = file.folder / "binaries" / fmpy.platform / f"{file.identifier}{fmpy.sharedLibraryExtension}"
        self._fmu = str(binary).encode(), file.description.guid.encode(), b""
        self._rows = np.zeros((STEPS + 1, COUNT * len(OUTPUTS)))

    def seconds(self, kind: str) -> float:
        """Processor time from the first step to the last [s]."""
        taken = float(self._ring(*self._fmu, COUNT, STEPS, float(STEP), kind == "all", self._rows.ctypes.data))
        if taken < 0:
            raise RuntimeError("the hand-written loop failed")
        return taken

    def record(self, kind: str) -> FloatArray:
        """(K, n) outputs, FMU by FMU."""
        self.seconds(kind)
        width = len(recorded(kind))
        return self._rows.reshape(-1)[: (STEPS + 1) * width].reshape(-1, width).copy()


def repeated(run: Callable[[], float]) -> list[float]:
    return [run() for _ in range(REPEATS)]


def interleaved(loops: Mapping[str, Callable[[], float]]) -> dict[str, list[float]]:
    """Times of loops in turn, so that a busy machine slows all alike; a first round does not count."""
    taken: dict[str, list[float]] = {name: [] for name in loops}
    for turn in range(2 * REPEATS + 1):
        for name, run in loops.items():
            once = run()
            if turn:
                taken[name].append(once)
    return taken


def against_peer(tool: str, peer: Peer, fmu: Path, ours: Simulation) -> list[Figure]:
    """The time of another tool and what ours is against it; one line with the reason where it does not run."""
    before = repeated(lambda: seconds(ours, peer.record))
    try:
        theirs = measured(tool, fmu)
    except (OSError, subprocess.SubprocessError, ValueError) as error:
        output = getattr(error, "stderr", None) or str(error)
        reason = (output.strip().splitlines() or [f"ended with {getattr(error, 'returncode', 'an error')}"])[-1]
        return [Figure(peer.title, "-", f"does not run: {reason[:60]}")]
    after = repeated(lambda: seconds(ours, peer.record))
    return [
        Figure(peer.title, "-", nanoseconds(theirs)),
        ratio(f"{peer.title} takes", theirs, before + after, f"ours, {peer.record}", at_least=peer.limit),
    ]


def measured(tool: str, fmu: Path) -> list[float]:
    """Seconds of each repetition."""
    python = python_with("cofmupy", "cofmupy==1.0.0") if tool == "cofmupy" else sys.executable
    command = [python, str(HERE / "peers.py"), tool, str(fmu), str(COUNT), str(STEPS), str(REPEATS)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=600)
    return [float(each) for each in json.loads(done.stdout)]


def described_anew(fmu: Path, copy: Path, change: Callable[[str], str]) -> Path:
    """A copy of an FMU with another modelDescription.xml."""
    with zipfile.ZipFile(fmu) as source, zipfile.ZipFile(copy, "w") as target:
        for name in source.namelist():
            content = source.read(name)
            target.writestr(name, change(content.decode()) if name == "modelDescription.xml" else content)
    return copy


def without_dependencies(description: str) -> str:
    return re.sub(r' dependencies(Kind)?="[^"]*"', "", description)


def reals_only(description: str) -> str:
    """Without variables of other types, and without the model structure that counts them."""
    variables = re.sub(r"<ScalarVariable[^>]*>\s*<(?!Real)\w.*?</ScalarVariable>", "", description, flags=re.S)
    return re.sub(r"<ModelStructure>.*?</ModelStructure>", "<ModelStructure/>", variables, flags=re.S)


def nanoseconds(times: list[float]) -> str:
    return f"{1e9 * median(times) / COUNT / STEPS:,.0f} ns"


def ratio(
    name: str,
    times: list[float],
    against: list[float],
    what: str,
    *,
    at_most: float | None = None,
    at_least: float | None = None,
) -> Figure:
    """How many times longer."""
    found = median(times) / median(against)
    if at_most is not None:
        return Figure(f"{name} x times {what}", f"at most {at_most:g}", f"{found:.2f}", found <= at_most)
    assert at_least is not None
    return Figure(f"{name} x times {what}", f"at least {at_least:g}", f"{found:.1f}", found >= at_least)
