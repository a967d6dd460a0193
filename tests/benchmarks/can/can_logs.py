"""How fast BLF and text logs become frames and traces, beside python-can and cantools, and in how much memory.

The log: four messages of four signals each, a millisecond apart, deflated as loggers do. python-can's reader and a loop
of it with cantools' decoder run on the same file in the same process. Memory is that of a process that converts a log
into a Parquet file: of a short and of a long log, whose difference tells what one of 1 GB would take.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import can
import cantools
import numpy as np

from orchestrator.can import logs
from orchestrator.can.codec.decoding import trace
from orchestrator.can.database.bus import load_all
from orchestrator.can.frames import Frames
from orchestrator.progress import silent

from ..figure import Figure
from ..memory import peak_megabytes

ROOT = Path(__file__).parents[3]
MESSAGES, FRAMES, REPEATS = 4, 100_000, 3
READ_FASTER, TRACE_FASTER, TEXT_FASTER = 5, 5, 5
READERS: dict[str, Any] = {
    ".asc": can.ASCReader,
    ".csv": can.CSVReader,
    ".log": can.CanutilsLogReader,
    ".trc": can.TRCReader,
}
BEFORE = {".asc": 2.2, ".csv": 4.2, ".log": 2.9, ".trc": 3.0}
SHORT, LONG, GIGABYTE, MEGABYTES = 40e6, 200e6, 1e9, 600
FILE_HEADER = 144  # bytes


def figures() -> list[Figure]:
    """Reading, decoding and memory."""
    with tempfile.TemporaryDirectory() as folder:
        return [*speed(Path(folder)), *text_speed(Path(folder)), *memory(Path(folder))]


def database(folder: Path) -> Path:
    """A DBC of the messages."""
    lines = ['VERSION ""', "NS_ :", "BS_:", "BU_: rig"]
    for number in range(MESSAGES):
        lines.append(f"BO_ {256 + number} Message{number}: 8 rig")
        lines += [f' SG_ s{number}{k} : {16 * k}|16@1- (0.001,0) [-32|32] "V" rig' for k in range(4)]
    (folder / "rig.dbc").write_text("\n".join(lines) + "\n")
    return folder / "rig.dbc"


def log(folder: Path, suffix: str = ".blf") -> Path:
    """A log."""
    time = np.linspace(1.7e9, 1.7e9 + 1e-3 * (FRAMES - 1), FRAMES)
    steps = np.random.default_rng(0).integers(-20, 21, (FRAMES, 4))
    data = np.cumsum(steps, axis=0).astype("<i2").view(np.uint8).reshape(FRAMES, 8)
    nothing = np.zeros(FRAMES, np.uint8)
    identifiers = (256 + np.arange(FRAMES) % MESSAGES).astype(np.uint32)
    path = folder / f"rig{suffix}"
    logs.write(path, [Frames(time, identifiers, nothing, nothing, nothing + np.uint8(8), data)])
    return path


def speed(folder: Path) -> list[Figure]:
    """Frames a second of our way and of the plain one."""
    path, dbc = log(folder), database(folder)
    ours, plain = seconds(lambda: sum(map(len, logs.read(path)))), seconds(lambda: sum(1 for _ in can.BLFReader(path)))
    mine = seconds(lambda: trace(logs.read(path), load_all(dbc)))
    theirs = seconds(lambda: plain_loop(path, dbc), repeats=1)
    return [
        Figure("BLF to frames", "-", f"{FRAMES / ours:,.0f} frames/s"),
        Figure(
            "python-can's reader takes x times ours",
            f"at least {READ_FASTER}",
            f"{plain / ours:.1f}",
            plain / ours >= READ_FASTER,
        ),
        Figure("BLF to Trace", "-", f"{FRAMES / mine:,.0f} frames/s"),
        Figure(
            "python-can with cantools takes x times ours",
            f"at least {TRACE_FASTER}",
            f"{theirs / mine:.1f}",
            theirs / mine >= TRACE_FASTER,
        ),
    ]


def text_speed(folder: Path) -> list[Figure]:
    """Text logs beside python-can's readers, through which they went before.

    `BEFORE` is how many times its own reader's time reading took then, measured on the same log of 60,000 frames.
    """
    table = []
    for suffix, reader in READERS.items():
        path = log(folder, suffix)
        ours = seconds(lambda path=path: sum(map(len, logs.read(path))))
        plain = seconds(lambda path=path, reader=reader: sum(1 for _ in reader(path)))
        faster = plain / ours
        table.append(
            Figure(
                f"python-can's reader of {suffix} takes x times ours; against reading through it before",
                f"at least {TEXT_FASTER} x than before",
                f"{faster:.1f}; {faster * BEFORE[suffix]:.1f} x",
                faster * BEFORE[suffix] >= TEXT_FASTER,
            )
        )
    return table


def seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Processor time of the quickest repetition [s]."""
    taken = []
    for _ in range(repeats):
        begun = process_time()
        work()
        taken.append(process_time() - begun)
    return min(taken)


def plain_loop(path: Path, dbc: Path) -> dict[str, list[tuple[float, float]]]:
    """Every signal's stamps and values, as one would write it down."""
    known: Any = cantools.database.load_file(dbc)
    found: dict[str, list[tuple[float, float]]] = {}
    for message in can.BLFReader(path):
        values = known.decode_message(message.arbitration_id, message.data)
        for name, value in values.items():
            found.setdefault(name, []).append((message.timestamp, value))
    return found


def memory(folder: Path) -> list[Figure]:
    """Peak memory of converting, extrapolated to a log of 1 GB; the log's own containers over and over."""
    content, peaks, times = (folder / "rig.blf").read_bytes(), [], []
    for size in (SHORT, LONG):
        with (folder / "long.blf").open("wb") as file:
            file.write(content[:FILE_HEADER])
            while file.tell() < size:
                file.write(content[FILE_HEADER:])
        command = [sys.executable, "-m", "tests.benchmarks.can.can_logs", str(folder)]
        done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=1800, cwd=ROOT)
        taken, peak = (float(each) for each in done.stdout.split())
        times.append(taken)
        peaks.append(peak)
    expected = peaks[1] + max(0.0, peaks[1] - peaks[0]) * (GIGABYTE - LONG) / (LONG - SHORT)
    return [
        Figure(
            f"BLF of {LONG / 1e6:.0f} MB to Parquet",
            "-",
            f"{LONG / 1e6 / times[1]:.1f} MB/s, {peaks[0]:.0f} MB at {SHORT / 1e6:.0f} MB, {peaks[1]:.0f} MB",
        ),
        Figure(
            "memory for a BLF of 1 GB, extrapolated",
            f"under {MEGABYTES} MB",
            f"{expected:.0f} MB",
            expected < MEGABYTES,
        ),
    ]


def print_conversion(folder: Path) -> None:
    """Seconds that the conversion takes, and the process' peak memory [MB]."""
    from orchestrator.formats import Layout
    from orchestrator.formats.can_conversion import convert

    begun = perf_counter()
    convert(folder / "long.blf", folder / "long.parquet", Layout(database=folder / "rig.dbc"), silent)
    print(perf_counter() - begun, peak_megabytes())


if __name__ == "__main__":
    if len(sys.argv) > 1:
        print_conversion(Path(sys.argv[1]))
