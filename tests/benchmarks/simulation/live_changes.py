"""Does changing values while a run goes on at 1 kHz make steps late? A motor and a hand, 1,000 changes in 2 s.

A step is late because of a change where it would not have been without the time that the change before it took; what
else makes steps late is the machine's, and is measured in runs without changes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

from orchestrator.assembly.assembly import OpenSystem, assemble
from orchestrator.engine import LiveRun, Run, Timing
from orchestrator.live.paced import Paced
from orchestrator.live.requests import Requests
from orchestrator.live.steering import Steering
from orchestrator.realtime.deadlines import LATE, Deadlines
from orchestrator.scenario.schema import load_scenario

from ..figure import Figure

CHANGES, STEPS, REPEATS = 1000, 2000, 3
SCENARIO = """\
title: A motor that turns a hand
components: {motor: {model: dc_motor}, hand: {model: pendulum}}
connections: [motor.torque -> hand.torque, hand.speed -> motor.speed]
run: {stop: 2, step: 0.001}
"""


@dataclass
class Seen:
    """What a run was seen to do, a value a step.

    Attributes:
        lateness: from the deadline to the beginning [s].
        spent: what changes took [s of processor time].
    """

    lateness: list[float] = field(default_factory=list)
    spent: list[float] = field(default_factory=list)
    changes: int = 0

    @property
    def late(self) -> int:
        return sum(lateness > LATE for lateness in self.lateness)

    @property
    def because(self) -> int:
        """Steps that are late because of the changes of the step before."""
        pairs = zip(self.lateness[1:], self.spent, strict=False)
        return sum(lateness > LATE >= lateness - spent for lateness, spent in pairs)


def figures() -> list[Figure]:
    """Late steps with changes and without, in turns."""
    with TemporaryDirectory() as folder:
        (Path(folder) / "motor.yaml").write_text(SCENARIO)
        scenario = load_scenario(Path(folder) / "motor.yaml")
        with OpenSystem(assemble(scenario.system, Path(folder))) as opened:
            timing = Timing(Fraction(STEPS, 1000), Fraction(1, 1000))
            with opened.simulation(timing) as simulation:
                pairs = [(seen(simulation, 0), seen(simulation, CHANGES)) for _ in range(REPEATS)]
    without, changed = ([pair[place] for pair in pairs] for place in (0, 1))
    made, because = sum(one.changes for one in changed), sum(one.because for one in changed)
    spent = sorted(spent for one in changed for spent in one.spent)[-made:]  # the others have made none
    return [
        Figure(f"{made:,} changes at 1 kHz: steps late because of them", "0", f"{because}", because == 0),
        Figure(
            f"late steps of {STEPS:,} with {CHANGES:,} changes, and without",
            "-",
            " ".join(f"{one.late}:{other.late}" for one, other in zip(changed, without, strict=True)),
        ),
        Figure(
            "processor time of the changes of a step: half of them, 99.9 %",
            "-",
            f"{1e6 * spent[len(spent) // 2]:.0f} µs, {1e6 * spent[int(0.999 * len(spent))]:.0f} µs",
        ),
    ]


def seen(simulation: Any, count: int) -> Seen:
    """A run with so many changes, one a millisecond."""
    found = Seen()
    begun = Deadlines.begun

    def noted(deadlines: Deadlines, lateness: float) -> None:
        found.lateness.append(lateness)
        begun(deadlines, lateness)

    def shown(live: LiveRun[Any], requests: Requests) -> None:
        make = requests.make
        requests.make = lambda: found.spent.append(timed(make))  # type: ignore[method-assign]
        threading.Thread(target=ask, args=(live, requests, count), daemon=True).start()

    with patch.object(Deadlines, "begun", noted):
        result = Paced(Steering(("motor.voltage",), shown=shown)).execute(simulation, Run())
    found.changes = len(result.changes)
    return found


def timed(work: Callable[[], None]) -> float:
    """Processor time that it takes; that others have the processor meanwhile is not its fault [s]."""
    before = time.thread_time()
    work()
    return time.thread_time() - before


def ask(live: LiveRun[Any], requests: Requests, count: int) -> None:
    """Ask for so many changes, from the first step on."""
    while count and not live.steps:
        time.sleep(1e-3)
    for number in range(count):
        requests.ask(f"motor.voltage={1e-3 * (number % 7)}", "bench")
        time.sleep(1e-3)
