"""Random faults against bridges and benches, seen by a foreign peer: no command that nobody means, and the truth at the
end. Linux only.

What a run must do is in `KINDS`: how it ends, and what it says. A command that is not safe counts where it comes later
than what was wrong allows (its silence, or its lateness) and two periods.
"""

from __future__ import annotations

import json
import os
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fmus.modelling import ops
from fmus.modelling.model import Model, input_, output, parameter
from fmus.packaging import targets
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.foreign_peer import DBC, PERIOD, ForeignMachine
from tests.support.fmus import brute

from ..figure import Figure

ROOT = Path(__file__).parents[3]
SERVOTWIN = [sys.executable, "-c", "from identification.cli import main; main()", "can"]
RUNS, SIGNALS, AT_ONCE = 200, 500, 2
SILENCE, MOST_LATE, GIVE_UP, STEP, HEARD = 0.1, 0.1, 1.0, 0.01, 0.1  # [s]
HANG = 120.0  # patience with anything [s]
FILLER = 3  # the adapter that fills the bus where it is to be full
PAUSE = 0.03  # for which this computer may keep the peer from looking [s]
LAW: dict[str, Any] = {
    "title": "A law on a bus",
    "run": {"stop": 600, "step": STEP},
    "can": {
        "database": "rig.dbc",
        "receive": {"law.flow": {"signal": "flow", "safe": 0}},
        "send": {"level": {"source": "law.level", "safe": 0}},
        "silence": SILENCE,
        "most_late": MOST_LATE,
        "give_up": GIVE_UP,
    },
}
ROOTLESS = Model(
    "rootless",
    "A gain whose output is NaN from some time on",
    (
        input_("flow", "1", "Flow in"),
        output("level", "1", "Level"),
        parameter("at", "s", 1e9, "From when on"),
    ),
    outputs=lambda t, x, u, p: {"level": u.flow + 0 * ops.sqrt(p.at - t)},
)


@dataclass
class Trial:
    """A run while it goes on.

    Attributes:
        begun, ended: when the fault began and ended, None where it goes on to the end [s].
    """

    process: subprocess.Popen[str]
    machine: ForeignMachine
    hub: Hub
    folder: Path
    draws: random.Random
    begun: float = 0.0
    ended: float | None = None

    def wait(self, condition: Callable[[], bool]) -> None:
        until = time.monotonic() + HANG
        while not condition() and self.process.poll() is None and time.monotonic() < until:
            time.sleep(0.005)

    def drives(self) -> bool:
        return self.machine.latest not in (0.0,) and bool(self.machine.commands)

    @contextmanager
    def fault(self, least: float = 0.3, most: float = 1.0) -> Iterator[None]:
        """Something is wrong in the block, and for a while."""
        self.begun, self.machine.pauses = time.monotonic(), 0.0
        yield
        time.sleep(self.draws.uniform(least, most))
        self.ended = time.monotonic()

    def child(self) -> int:
        """The process that steps."""
        return _child(self.process.pid)

    def guard(self) -> int:
        """The process that has the bus."""
        return _child(self.child())


def _child(pid: int) -> int:
    return int(Path(f"/proc/{pid}/task/{pid}/children").read_text().split()[0])


def peer(fault: str) -> Callable[[Trial], None]:
    def act(trial: Trial) -> None:
        with trial.fault():
            trial.machine.fault = fault
        trial.machine.fault = ""
        trial.wait(trial.drives)
        trial.process.terminate()

    return act


def killed(trial: Trial) -> None:
    with trial.fault():
        os.kill(trial.child(), signal.SIGKILL)
    trial.ended = None


def stopped(trial: Trial) -> None:
    child = trial.child()
    with trial.fault(0.3, 0.7):
        os.kill(child, signal.SIGSTOP)
    with suppress(ProcessLookupError):
        os.kill(child, signal.SIGCONT)
    trial.wait(trial.drives)
    trial.process.terminate()


def suspended(trial: Trial) -> None:
    """Both processes stand still, in which time the machine falls silent: what it had sent before is old by then."""
    pids = [trial.child(), trial.guard()]
    with trial.fault():
        for pid in pids:
            os.kill(pid, signal.SIGSTOP)
        time.sleep(trial.draws.uniform(0.1, 0.5))
        trial.machine.fault = "silence"
        time.sleep(SILENCE + 0.1)
        for pid in pids:
            os.kill(pid, signal.SIGCONT)
    trial.machine.fault = ""
    trial.wait(trial.drives)
    trial.process.terminate()


def guard_killed(trial: Trial) -> None:
    with trial.fault():
        os.kill(trial.guard(), signal.SIGKILL)
    trial.ended = None


def signals(trial: Trial) -> None:
    number = trial.draws.choice([signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT])
    with trial.fault(0.0, 0.0):
        for _ in range(trial.draws.randint(1, 3)):
            trial.process.send_signal(number)
    trial.ended = None


def unplugged(trial: Trial) -> None:
    with trial.fault():
        trial.hub.unplug(1)


def bus_off(trial: Trial) -> None:
    with trial.fault():
        trial.hub.bus_off(1)


def full_for_a_while(trial: Trial) -> None:
    with trial.fault(0.5, 1.5):
        trial.hub.fill(FILLER)
    trial.hub.spare(FILLER)
    trial.wait(trial.drives)
    trial.process.terminate()


def full_to_the_end(trial: Trial) -> None:
    with trial.fault(0.5, 1.5):
        trial.hub.fill(FILLER)
    trial.process.terminate()
    trial.process.wait(HANG)
    trial.ended = time.monotonic()
    trial.hub.spare(FILLER)


def disk_full(trial: Trial) -> None:
    with trial.fault(0.0, 0.0), suppress(OSError), (trial.folder / "small" / "fill").open("wb", 0) as file:
        while True:
            file.write(bytes(1 << 14))
    trial.ended = None


def by_itself(trial: Trial) -> None:
    """The FMU's own fault, at the time `at` of its steps, the first of which has sent the first command."""
    trial.begun, trial.machine.pauses = trial.machine.commands[0][0] + AT, 0.0


AT = 1.2  # when FMUs begin to misbehave [s]


@dataclass(frozen=True)
class Kind:
    """A fault, and what must come of it.

    Attributes:
        codes: of exit, `bridge` and `bench`; None where it is not tried.
        says: regular expression of what is said.
        late: how long a command may be other than safe after it has begun, but two periods [s]; None: no matter.
        rests: whether the last command is the safe one.
        mood: of the FMU.
    """

    act: Callable[[Trial], None]
    codes: tuple[int | None, int | None]
    says: str
    late: float | None = SILENCE
    rests: bool = True
    mood: int = 0
    small: bool = False
    model: str = "brute"
    options: dict[str, Any] = field(default_factory=dict)


KINDS = {
    "silence": Kind(peer("silence"), (130, 0), r"Sensors: no frame for 0\.1 s"),
    "wrong checksums": Kind(peer("checksum"), (130, 0), r"Sensors: no good value for 0\.1 s \(wrong checksum\)"),
    "a counter that stands": Kind(peer("counter"), (130, 0), r"no good value for 0\.1 s \(the counter stands still\)"),
    "NaN received": Kind(peer("not finite"), (130, 0), r"no good value for 0\.1 s \(not finite\)"),
    "short frames": Kind(peer("short"), (130, 0), r"no good value for 0\.1 s \(too short\)"),
    "NaN from the FMU": Kind(by_itself, (3, None), r"law\.level:? (was not finite|is nan)", STEP, model="rootless"),
    "the FMU hangs": Kind(
        by_itself, (3, None), r"hangs, and its process was killed", MOST_LATE + STEP, mood=brute.Mood.HANG
    ),
    "the FMU crashes": Kind(
        by_itself, (3, 3), r"crashed the command's process \(SIGSEGV\)", STEP, mood=brute.Mood.SEGMENTATION
    ),
    "the FMU aborts": Kind(by_itself, (3, 3), r"\(SIGABRT\)", STEP, mood=brute.Mood.ABORT),
    "the FMU exits": Kind(by_itself, (3, 3), r"ended the command's process", STEP, mood=brute.Mood.EXIT),
    "kill -9": Kind(killed, (3, 3), r"the result up to there is in .*was killed \(SIGKILL\)", MOST_LATE + STEP),
    "stop and continue": Kind(stopped, (130, 0), r"rests: (no step has ended|steps are)", MOST_LATE + STEP),
    "suspended while the machine falls silent": Kind(suspended, (130, 0), r"Sensors: no frame for 0\.1 s"),
    "kill -9 of the guard": Kind(guard_killed, (3, 3), r"safe values were sent by the process that steps", STEP),
    "signals": Kind(signals, (130, None), r"interrupted after", None),
    "unplugged": Kind(unplugged, (3, None), r"the adapter is gone", None, rests=False),
    "bus off": Kind(bus_off, (3, None), r"bus off", None, rests=False),
    "a full bus for a while": Kind(
        full_for_a_while, (130, 0), r"the bus is full: what is sent does not get out in time", MOST_LATE + HEARD
    ),
    "a full bus at the end": Kind(
        full_to_the_end, (3, 3), r"may not have got out: the bus is full, and the adapter", MOST_LATE + HEARD
    ),
    "a full disk": Kind(disk_full, (3, None), r"record: cannot be written", None, small=True),
}


def endurance() -> list[Figure]:
    """The campaigns."""
    return [*campaign(RUNS, seed=1), *campaign(SIGNALS, seed=2, only=["signals"])]


def campaign(runs: int, seed: int, only: Sequence[str] = ()) -> list[Figure]:
    """The figures of so many random faults, of all kinds or some; what went wrong is told on standard error."""
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for number in (signal.SIGHUP, signal.SIGQUIT):  # ignored where a shell began this in the background
        signal.signal(number, signal.SIG_DFL)
    with tempfile.TemporaryDirectory(prefix="faults-") as place:
        folder = Path(place)
        brute.build(folder / "brute.fmu")
        targets.build(ROOTLESS, folder / "rootless.fmu")
        (folder / "rig.dbc").write_text(DBC)
        kinds = only or [name for name, kind in KINDS.items() if not kind.small or _mounts(folder)]
        draws = random.Random(seed)
        order = [kinds[number % len(kinds)] for number in range(runs)]
        draws.shuffle(order)
        plans = [(number, name, draws.random()) for number, name in enumerate(order)]
        with ThreadPoolExecutor(AT_ONCE) as pool:
            outcomes = list(pool.map(lambda plan: tried(folder, *plan), plans))
    for (number, name, _), outcome in zip(plans, outcomes, strict=True):
        for problem in outcome:
            print(f"run {number}, {name}: {problem}", file=sys.stderr)
    counts = Counter(re.split(" \\(|:", problem)[0] for outcome in outcomes for problem in outcome)
    blind, excused = counts["blind command"], counts["late, and this computer paused"]
    asked = {
        "... with a command that nobody means, later than is allowed": blind,
        "... without the safe value at the end": counts["last command"],
        "... with another exit code, sentence or result than is right": counts["told"],
    }
    of = only[0] if len(only) == 1 else "faults"
    said = f"{runs} of {len(kinds)} kinds" if len(kinds) > 1 else f"{runs}"
    return [
        Figure(f"random {of} for a bridge or bench", f"{SIGNALS if only else RUNS}", f"{said}, load {_load()}"),
        *(Figure(name, "0", f"{count}", not count, certain=True) for name, count in asked.items()),
        Figure("... later, or told otherwise, while this computer kept peer or bus from going on", "-", f"{excused}"),
    ]


def _load() -> str:
    """What the computer had to do besides, on average over five minutes."""
    return f"{os.getloadavg()[1]:.1f}"


def _mounts(folder: Path) -> bool:
    """Whether a small disk can be had."""
    place = folder / "tried"
    place.mkdir(exist_ok=True)
    with _small_disk(place) as there:
        return there


@contextmanager
def _small_disk(place: Path) -> Iterator[bool]:
    command = ["mount", "-t", "tmpfs", "-o", "size=20m", "tmpfs", str(place)]
    there = subprocess.run(command, check=False, capture_output=True).returncode == 0
    try:
        yield there
    finally:
        if there:
            subprocess.run(["umount", "-l", str(place)], check=False)


def tried(folder: Path, number: int, name: str, seed: float) -> list[str]:
    """What was wrong in one run."""
    kind, draws = KINDS[name], random.Random(seed)
    modes = [mode for mode, code in zip(("bridge", "bench"), kind.codes, strict=True) if code is not None]
    mode = draws.choice(modes)
    place = folder / f"{number}"
    (place / "small").mkdir(parents=True)
    law = {"fmu": f"../{kind.model}.fmu"}
    if kind.model == "rootless" or kind.mood:
        law["parameters"] = {"at": AT} | ({"mood": int(kind.mood)} if kind.mood else {})  # type: ignore[assignment]
    (place / "law.yaml").write_text(json.dumps(LAW | {"components": {"law": law}}))
    (place / "rig.dbc").write_text(DBC)
    small = _small_disk(place / "small") if kind.small else _nothing()
    with small, hub_process(place / "bus", 4) as hub:
        machine = ForeignMachine(hub.paths[0], hub.paths[2])
        out = place / "small" / "out" if kind.small else place / "out"
        adapter = ["--interface", "slcan", "--channel", hub.paths[1], "--bitrate", 500_000, "--out", out]
        process = subprocess.Popen(
            [*SERVOTWIN, mode, str(place / "law.yaml"), *map(str, adapter)],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            start_new_session=True,
        )
        try:
            trial = Trial(process, machine, hub, place, draws)
            trial.wait(trial.drives)
            time.sleep(draws.uniform(0.0, 1.0) if kind.act is not by_itself else 0.0)
            kind.act(trial)
            said = process.communicate(timeout=HANG)[1]
            machine.hear_out()
        except subprocess.TimeoutExpired:
            return [f"told: does not end; {_processes(process.pid)}"]
        finally:
            process.kill()
            machine.end()
        return judged(trial, kind, kind.codes[mode == "bench"], said, out)


def _processes(group: int) -> str:
    """What a command's processes are at."""
    columns = ["ps", "-eo", "pid,ppid,pgid,sid,stat,wchan:20,args"]
    lines = subprocess.run(columns, check=False, capture_output=True, text=True).stdout.splitlines()
    return " | ".join(line[:90] for line in lines if line.split()[3] == str(group))


@contextmanager
def _nothing() -> Iterator[bool]:
    yield False


def judged(trial: Trial, kind: Kind, code: int | None, said: str, out: Path) -> list[str]:
    """What was wrong."""
    found, machine = [], trial.machine
    if kind.late is not None:
        allowed = trial.begun + kind.late + 2 * PERIOD
        ended = trial.ended or float("inf")
        if late := [(at, value) for at, value in machine.commands if allowed < at <= ended and value != 0]:
            excuse = machine.pauses > PAUSE
            what = "late, and this computer paused" if excuse else "blind command"
            found.append(f"{what}: {len(late)} up to {late[-1][0] - allowed:.3f} s (pause {machine.pauses:.3f} s)")
    if kind.rests and machine.latest != 0:
        found.append(f"last command: {machine.latest:g}")
    if kind.act in (full_for_a_while, full_to_the_end):
        after = [value for at, value in machine.commands if trial.ended is not None and at > trial.ended]
        if after and after[0] != 0:
            found.append(f"blind command: {after[0]:g} was the first when the full bus had room")
    said, ended = " ".join(said.split()), trial.process.returncode
    right = ended == code and re.search(kind.says, said)
    if not right or "Traceback" in said:
        paused = trial.hub.statistics().paused
        deceived = kind.act is full_to_the_end and ended in (0, 130) and paused > HEARD
        what = f"late, and this computer paused (the bus, for {paused:.3f} s)" if deceived else "told"
        found.append(f"{what}: {ended} for {code}: {said[-700:]}")
    with suppress(OSError, ValueError):
        if json.loads((out / "manifest.json").read_text())["ended"] in ("failed", "stopped"):
            return found
    return [*found, f"told: no result in {out.name}"]


if __name__ == "__main__":
    runs, seed, *only = sys.argv[1:]
    for figure in campaign(int(runs), int(seed), only):
        print(figure.name, figure.measured)
