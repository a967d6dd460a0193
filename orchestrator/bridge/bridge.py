"""A scenario in real time on a CAN bus: as a bridge that couples it to devices, or as a stand-in for a bench.

At step k, t0 + k h on a clock that never jumps: what has been received is given to inputs, everything steps from t_k to
t_(k+1), and messages that are due go out with what is to be seen at t_k.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import can

from fmus.errors import ServotwinError
from fmus.files import sha256
from orchestrator import formats
from orchestrator.bridge.preparation import Job, Prepared, prepared
from orchestrator.bridge.session import Ending, Progress, Session
from orchestrator.bridge.traffic import Exchange
from orchestrator.bridge.watchdog import Watchdog
from orchestrator.can.live.bus import opened
from orchestrator.can.live.receiver import Receiver
from orchestrator.engine import Result
from orchestrator.formats import parquet
from orchestrator.realtime.background import Background
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests
from orchestrator.scenario.expectations import Check, Expectation, check
from orchestrator.scenario.run import CaseResult, Keeping, ScenarioResult, State
from orchestrator.trace import Trace

LOG = logging.getLogger("servotwin.can")
QUEUE = 4096  # frames that wait to be taken at most; more are dropped and counted
READABLE = 5_000_000  # values of a record up to which all of it is read again, to be drawn


@dataclass(frozen=True)
class Coupled:
    """What came of a job.

    Attributes:
        result: the scenario's, with one case; partial where the coupling ended before its time.
        about: bus, watchdog and deadlines as plain values.
        found: what was not as it should be in the frames, a line each.
        interrupted: whether Ctrl-C ended it.
    """

    job: Job
    result: ScenarioResult
    deadlines: Deadlines
    about: dict[str, Any]
    found: tuple[str, ...]
    ending: Ending
    interrupted: bool


def couple(
    job: Job,
    aside: Path,
    ready: Callable[[Stop], None] = lambda stop: None,
    progress: Progress = lambda share, elapsed: None,
) -> Coupled:
    """Couple to the end of the job, to Ctrl-C or SIGTERM, or to a failure.

    Args:
        aside: folder on the disk of the results, for the record while it grows.
        ready: called when all is on the bus, before the first step; is given the wish to end.
        progress: called ten times a second.

    Raises:
        InputError: something does not fit; the bus was not touched.
        BusError: the adapter does not open.
        FmuError: an FMU failed before the first step.
    """
    file = aside / "0.parquet"
    with prepared(job) as system, stop_requests() as stop:
        started = datetime.now(UTC)
        with ExitStack() as stack:
            append = stack.enter_context(parquet.appending(file))
            background = stack.enter_context(Background())
            live = system.simulation.live(
                system.run, system.coupling.outputs, lambda piece: background.do(partial(append, piece))
            )
            bus = stack.enter_context(opened(job.bus))
            stack.enter_context(quiet())
            receiver = stack.enter_context(Receiver(bus, QUEUE))
            inlets = system.coupling.inward.inlets
            watchdog = Watchdog(inlets, lambda line: background.do(partial(LOG.warning, "%s", line)))
            exchange = Exchange(bus, receiver, system.coupling, watchdog)
            session = Session(live, exchange, system.block.run.step, system.course, job.bus.place)
            ready(stop)
            ending = session.run(stop, progress)
            result = live.result()
        about = _document(job, system, bus, receiver, exchange) | {
            "started": started.isoformat(),
            "seconds": round(ending.elapsed, 6),
            "deadlines": session.deadlines.document(),
            "watchdog": watchdog.document(ending.elapsed),
        }
        judged = _judged(job, system, result, ending, file)
        found = (*system.coupling.inward.census.lines(), *system.coupling.sent.lines())
        return Coupled(job, judged, session.deadlines, about, found, ending, ending.stopped and stop.interrupted)


def _document(job: Job, system: Prepared, bus: can.BusABC, receiver: Receiver, exchange: Exchange) -> dict[str, Any]:
    """The bus and what passed over it, as plain values."""
    settings, coupling = job.bus, system.coupling
    sent = {name: each for name, each in coupling.sent.document().items() if name != "frames"}
    return {
        "mode": "bench" if job.stand_in else "bridge",
        "interface": settings.interface,
        "channel": settings.channel,
        "bitrate": settings.bitrate,
        "fd": settings.fd,
        "data_bitrate": settings.data_bitrate,
        "database": {"file": system.database.name, "sha256": sha256(system.database)},
        "received": coupling.inward.census.document() | {"dropped": receiver.dropped},
        "sent": {"frames": exchange.sent, "no_room": exchange.refused} | sent,
        "malformed_lines": getattr(bus, "malformed", 0),
        "refused_lines": getattr(bus, "refused", 0),
        "trouble": exchange.trouble,
        "notes": coupling.notes(),
    }


def _judged(job: Job, system: Prepared, result: Result, ending: Ending, file: Path) -> ScenarioResult:
    """The scenario's result with this case alone; judged where it came to its end and is no stand-in."""
    block, case = system.block, system.case
    expected = [] if job.stand_in else [*block.expect, *case.expect]
    early = ending.failure is not None or (ending.stopped and not job.stand_in)
    names = system.run.record or ()
    looked_at = {each.signal for each in expected if each.signal is not None}
    result = replace(result, trace=_read(file, job.every, tuple(names), looked_at, result))
    checks = () if early else tuple(_check(each, result.trace, job.scenario.parent) for each in expected)
    state = State.INTERRUPTED if early else State.DONE
    judged = CaseResult(case.name, result, ending.failure, checks, file if file.exists() else None, state)
    keeping = Keeping(job.every, file.parent)
    return ScenarioResult(job.scenario, block, system.assembled, (judged,), keeping, interrupted=early)


def _check(expectation: Expectation, trace: Trace, base: Path) -> Check:
    """How it turned out; one that looks beyond the record has not held, and what there is is kept."""
    try:
        return check(expectation, trace, None, base)
    except ServotwinError as error:
        return Check(error.place, False, error.problem)


def _read(file: Path, every: int, names: Sequence[str], looked_at: Collection[str], result: Result) -> Trace:
    """What was recorded; of a long record what expectations look at."""
    rows = result.account.steps // every + 1
    chosen = names if rows * len(names) <= READABLE else [name for name in names if name in looked_at]
    if not chosen or rows < 2 or not file.exists():
        return result.trace
    return formats.read(file, formats.Layout(columns={name: name for name in chosen})).trace
