"""What commands cost before they do anything: processor time of `servotwin`, and how soon Ctrl-C ends a run.

Processor time is that of the command and all that it starts, compilers too, the least of a few times. The first run
finds a cache of built FMUs empty, the second finds in it what the first has built.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from resource import RUSAGE_CHILDREN, getrusage
from time import perf_counter, sleep

import numpy as np

from ..figure import Figure

ROOT = Path(__file__).parents[3]
SERVOTWIN = [sys.executable, "-c", "from identification.cli import main; main()"]
SCENARIO = ROOT / "scenarios" / "butterfly" / "sine.yaml"
HELP, INFO, RATIO, IMPORT, ENDS = 0.25, 0.6, 3.0, 0.05, 0.2
REPEATS = 3
SWING = {
    "title": "A long swing",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},
    "run": {"stop": 100_000, "step": 0.001},
    "record": ["hand.angle"],
}


def figures() -> list[Figure]:
    """Processor time of help, of a file's description, of a first and a second run; the end of an interrupted run."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        table = np.column_stack([np.arange(1000) / 1000, np.sin(np.arange(1000) / 50)])
        np.savetxt(folder / "a.csv", table, delimiter=",", header="time [s],angle [rad]", comments="")
        return [
            imported(),
            within("servotwin --help", HELP, least([*SERVOTWIN, "--help"], folder)),
            within("servotwin info FILE.csv", INFO, least([*SERVOTWIN, "info", str(folder / "a.csv")], folder)),
            *runs(folder),
            interrupted(folder),
        ]


def imported() -> Figure:
    """What `import orchestrator` adds to an interpreter."""
    bare, package = (least([sys.executable, "-c", code], ROOT) for code in ("pass", "import orchestrator"))
    return within("import orchestrator", IMPORT, max(0.0, package - bare))


def within(name: str, limit: float, found: float) -> Figure:
    return Figure(f"{name}: processor time", f"under {limit:g} s", f"{found:.3f} s", found < limit)


def runs(folder: Path) -> list[Figure]:
    """The same scenario with an empty cache and with a filled one."""
    command = [*SERVOTWIN, "run", str(SCENARIO), "-q", "--out", str(folder / "out")]
    first = min(processor_time(command, folder / f"cache{number}") for number in range(2))
    second = least(command, folder / "cache0")
    name = f"servotwin run {SCENARIO.name}"
    return [
        Figure(f"{name}, nothing built yet: processor time", "-", f"{first:.2f} s"),
        Figure(f"{name}, the second time", "-", f"{second:.2f} s"),
        Figure(
            "the first takes x times the second",
            f"at least {RATIO:g}",
            f"{first / second:.1f}",
            first >= RATIO * second,
        ),
    ]


def least(command: list[str], cache: Path) -> float:
    """The least processor time of some repetitions [s]."""
    return min(processor_time(command, cache) for _ in range(REPEATS))


def processor_time(command: list[str], cache: Path) -> float:
    """Of a command that succeeds and of all that it starts [s]."""
    before = getrusage(RUSAGE_CHILDREN)
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env=environment(cache), cwd=ROOT)
    after = getrusage(RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def environment(cache: Path) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "SERVOTWIN_CACHE": str(cache)}


def interrupted(folder: Path) -> Figure:
    """From Ctrl-C to the end of a run that keeps its record in a stream; the least of some times."""
    (folder / "swing.yaml").write_text(json.dumps(SWING))
    command = [*SERVOTWIN, "run", str(folder / "swing.yaml"), "--stream", "-q", "--out", str(folder / "swing")]
    taken = []
    for _ in range(3):
        with subprocess.Popen(command, stderr=subprocess.DEVNULL, env=environment(folder / "cache0")) as running:
            sleep(4)
            begun = perf_counter()
            running.send_signal(signal.SIGINT)
            running.wait()
            taken.append(perf_counter() - begun)
        if running.returncode != 130:
            raise RuntimeError(f"the run ended with exit code {running.returncode}")
    return Figure("Ctrl-C ends a run", f"within {ENDS} s and writing", f"{min(taken):.2f} s", min(taken) < 2 * ENDS)
