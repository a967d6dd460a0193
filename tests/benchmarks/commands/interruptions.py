"""Commands interrupted at random moments while the processors are busy: what is lost, and what is left behind.

A try is lost where the exit code is not 130, though the signal came while the command was at work; where it says more
than a line; where a process, a temporary folder or half a result is left.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from time import monotonic, sleep, time

from tests.support.identification.small_study import record, write_study

from ..figure import Figure

ROOT = Path(__file__).parents[3]
SERVOTWIN = [sys.executable, "-c", "from identification.cli import main; main()"]
TRIES, AT_ONCE = 500, 3
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
SOON = 0.3  # a command whose result is there so soon after a signal was done when it came [s]
PATIENCE, LEAVING = 120.0, 10.0  # with a command that was interrupted, and with what it has started [s]
SWING = {
    "title": "A swing",
    "components": {"hand": {"model": "pendulum", "parameters": {"angle_start": 0.5}}},
    "run": {"stop": 2, "step": 0.001},
    "cases": [{"name": name} for name in "abc"],
    "expect": [{"signal": "hand.angle", "below": 0.6}],
}
PARAMETERS = {
    "hand.inertia": {"start": 0.006, "min": 0.001, "max": 0.02},
    "hand.gravity_torque": {"start": 0.03, "min": 0.01, "max": 0.2},
}


def endurance() -> list[Figure]:
    """How many of the tries lose nothing."""
    return hammered(TRIES, seed=1)


def hammered(tries: int, seed: int) -> list[Figure]:
    """The figures of so many tries; what went wrong is told on standard error."""
    with tempfile.TemporaryDirectory(prefix="interruptions-") as place:
        folder = Path(place)
        commands = prepared(folder)
        lengths = [whole(command, folder) for command in commands]
        draws = random.Random(seed)
        plans = [
            (number, draws.randrange(len(commands)), draws.choice(SIGNALS), draws.random() < 0.5, draws.random())
            for number in range(tries)
        ]
        with ThreadPoolExecutor(AT_ONCE) as pool:
            outcomes = list(
                pool.map(
                    lambda plan: tried(
                        folder / f"{plan[0]}", commands[plan[1]], *plan[2:4], plan[4] * lengths[plan[1]]
                    ),
                    plans,
                )
            )
    for plan, outcome in zip(plans, outcomes, strict=True):
        if outcome not in ("interrupted", "done before"):
            print(f"try {plan[0]}: {commands[plan[1]][0]}, {plan[2].name}: {outcome}", file=sys.stderr)
    counts = Counter(outcomes)
    early, hit = counts["done before"], counts["interrupted"]
    return [
        Figure("commands interrupted at random moments", f"{tries}", f"{hit}, {early} were done before", certain=True),
        Figure(
            "... that lost a signal or left something",
            "0",
            f"{tries - hit - early}",
            tries == hit + early,
            certain=True,
        ),
    ]


def prepared(folder: Path) -> list[Sequence[str]]:
    """Commands without their --out, with the files that they need."""
    (folder / "swings").mkdir()
    for name in ("swing", "sway"):
        (folder / "swings" / f"{name}.yaml").write_text(json.dumps(SWING))
    record(folder / "data")
    study = write_study(folder / "study.yaml", parameters=PARAMETERS, options={"starts": 20})
    return [
        ("run", str(folder / "swings" / "swing.yaml")),
        ("run", str(folder / "swings" / "sway.yaml"), "--stream"),
        ("test", str(folder / "swings"), "-j", "2"),
        ("calibrate", str(study), "--data", str(folder / "data")),
    ]


def whole(command: Sequence[str], folder: Path) -> float:
    """How long the command takes undisturbed, once what it builds is there [s]."""
    for number in range(2):
        begun = monotonic()
        out = folder / f"whole{number}"
        subprocess.run(
            [*SERVOTWIN, *command, "--out", str(out)], check=False, env=environment(folder), capture_output=True
        )
    return monotonic() - begun


def environment(folder: Path, **more: str) -> dict[str, str]:
    return os.environ | {"PYTHONPATH": str(ROOT), "SERVOTWIN_CACHE": str(folder / "cache")} | more


def tried(folder: Path, command: Sequence[str], number: signal.Signals, group: bool, after: float) -> str:
    """What came of one try: "interrupted", "done before", or what went wrong."""
    scratch, results = folder / "scratch", folder / "results"
    scratch.mkdir(parents=True)
    results.mkdir()
    mark = f"INTERRUPTION={folder}"
    name, value = mark.split("=")
    running = subprocess.Popen(
        [*SERVOTWIN, *command, "--out", str(results / "out")],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env=environment(folder.parent, TMPDIR=str(scratch), **{name: value}),
    )
    while not _guarded(running.pid) and running.poll() is None:
        sleep(0.001)
    sleep(after)
    sent = time()
    with suppress(ProcessLookupError):
        (os.killpg if group else os.kill)(running.pid, number)
    try:
        _, said = running.communicate(timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        running.kill()
        return "did not end"
    written = [place.stat().st_ctime for place in (results / "out").rglob("report.html")]
    late = max(written, default=sent + 60) < sent + SOON
    return _judged(running.returncode, said, late, mark, scratch, results)


def _judged(code: int, said: str, late: bool, mark: str, scratch: Path, results: Path) -> str:
    deadline = monotonic() + LEAVING
    while (left := list(_processes(mark))) and monotonic() < deadline:
        sleep(0.02)
    if left:
        return f"left the processes {left}"
    if files := [*scratch.iterdir(), *results.glob(".*")]:
        return f"left {[file.name for file in files]}"
    if "Traceback" in said or "Exception ignored" in said or len(said.splitlines()) > 1:
        return f"said {said!r}"
    if code in (0, 1) and late and (results / "out").is_dir():
        return "done before"
    return "interrupted" if code == 130 else f"ended with exit code {code} and said {said!r}"


def _guarded(pid: int) -> bool:
    """Whether a command's process takes signals into its own hands."""
    with suppress(OSError):
        status = Path(f"/proc/{pid}/status").read_text()
        blocked = int(next(line.split()[1] for line in status.splitlines() if line.startswith("SigBlk")), 16)
        return bool(blocked >> (signal.SIGTERM - 1) & 1)
    return False


def _processes(mark: str) -> Iterator[str]:
    """Commands of the living processes that have a mark in their environment."""
    for process in Path("/proc").iterdir():
        with suppress(OSError):
            if process.name.isdigit() and mark.encode() in (process / "environ").read_bytes().split(b"\0"):
                yield (process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")[:80]


if __name__ == "__main__":
    tries, seed = (int(argument) for argument in sys.argv[1:3])
    for figure in hammered(tries, seed):
        print(figure.name, figure.measured)
