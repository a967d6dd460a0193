"""A scenario in real time on a CAN bus: as a bridge that couples it to devices, or as a stand-in for a bench.

At step k, t0 + k h on a clock that never jumps: what has been received is given to inputs, everything steps from t_k to
t_(k+1), and messages that are due go out with what is to be seen at t_k.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Collection, Sequence
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from fmus.errors import RecordError, ServotwinError, TraceError
from orchestrator import formats
from orchestrator.assembly.whole_arrays import elements
from orchestrator.bridge.account import BusAccount
from orchestrator.bridge.bus.keeper import IN_PROCESS, Keeper, beside
from orchestrator.bridge.bus.keeper_process import apart
from orchestrator.bridge.mapping import Coupling
from orchestrator.bridge.preparation import BridgeJob, PreparedBridge, prepared
from orchestrator.bridge.session import Ending, Session
from orchestrator.engine import Result
from orchestrator.formats import arrows
from orchestrator.progress import Progress, silent
from orchestrator.realtime.background import Background
from orchestrator.realtime.pacing import quiet
from orchestrator.realtime.stopping import Stop, stop_requests
from orchestrator.scenario.expectations import Check, Expected, Ran
from orchestrator.scenario.run import CaseResult, CaseState, Keeping, ScenarioResult, hashes_of
from orchestrator.trace import Trace

LOG = logging.getLogger("servotwin.can")
RECORDS = f"0{arrows.SUFFIX}", "0.parquet"  # names of the record while it grows, and in its last form
UNGUARDED = "the bus is in the process that steps: if that crashes or is killed, nothing sends the safe values"
READABLE = 5_000_000  # values of a record up to which all of it is read again, to be drawn


@dataclass(frozen=True)
class BridgeResult:
    """What came of a job.

    Attributes:
        result: the scenario's, with one case; partial where the coupling ended before its time.
        account: of bus, watchdog and deadlines.
        interrupted: whether Ctrl-C ended it.
    """

    job: BridgeJob
    result: ScenarioResult
    account: BusAccount
    ending: Ending
    interrupted: bool


def couple(
    job: BridgeJob,
    aside: Path,
    ready: Callable[[Stop], None] = lambda stop: None,
    progress: Progress = silent,
    rescue: Callable[[], str] = lambda: "",
) -> BridgeResult:
    """Couple to the end of the job, to Ctrl-C or SIGTERM, or to a failure.

    Args:
        aside: folder on the disk of the results, for the record while it grows.
        ready: called when all is on the bus, before the first step; is given the wish to end.
        progress: called ten times a second.
        rescue: called by the process that has the bus where this one is gone before its end; what it returns is said.

    Raises:
        InputError: something does not fit; the bus was not touched.
        BusError: the adapter does not open.
        FmuError: an FMU failed before the first step.
    """
    growing, file = (aside / name for name in RECORDS)
    with prepared(job) as system, stop_requests() as stop:
        started = datetime.now(UTC)
        coupling = system.coupling
        notes = [*system.notes, *coupling.notes(), *([UNGUARDED] if _inside(job) else [])]
        with ExitStack() as stack:
            append = stack.enter_context(arrows.appending(growing))
            record = _Growing(stack.enter_context(Background()), append)
            live = system.simulation.live(system.run, coupling.outputs, record.take, job.steering.tuned)
            requests = stack.enter_context(job.steering.begun(live, float(system.scenario.timing.step)))
            keeper = stack.enter_context(_keeper(job, coupling, float(system.scenario.timing.step), rescue))
            stack.enter_context(quiet())
            session = Session(
                live,
                keeper,
                system.scenario.timing.step,
                system.course,
                job.places,
                record.unkept,
                requests.make,
            )
            for note in notes:
                _warn(note)
            ready(stop)
            ending = session.run(stop, progress)
            result = live.result()
        file = _settled(growing, file)
        account = BusAccount(
            **vars(ending.report),
            mode="bench" if job.stand_in else "bridge",
            buses=job.buses,
            database=system.database,
            notes=notes,
            started=started,
            seconds=round(ending.elapsed, 6),
            deadlines=session.deadlines,
        )
        judged = _judged(job, system, result, ending, account, file)
        return BridgeResult(job, judged, account, ending, ending.stopped and stop.interrupted)


class _Growing:
    """The record while it grows; written in the background, and readable up to what was written."""

    def __init__(self, background: Background, append: Callable[[Trace], None]) -> None:
        self._background, self._append = background, append
        self._failure: OSError | None = None

    def take(self, piece: Trace) -> None:
        """Write the next rows."""
        self._background.do(partial(self._write, piece))

    def unkept(self) -> RecordError | None:
        """Why no more can be written, None while it can."""
        if self._failure is None:
            return None
        why = self._failure.strerror or str(self._failure)
        return RecordError("record", f"cannot be written ({why})", "give it a disk with more room")

    def _write(self, piece: Trace) -> None:
        if self._failure is None:
            try:
                self._append(piece)
            except OSError as failure:
                self._failure = failure


def _settled(growing: Path, file: Path) -> Path:
    """The record in its last form; as it grew where there is no room for that."""
    try:
        arrows.settle(growing, file)
    except (OSError, TraceError):
        file.unlink(missing_ok=True)
        return growing
    growing.unlink()
    return file


def _keeper(
    job: BridgeJob, coupling: Coupling, step: float, rescue: Callable[[], str]
) -> AbstractContextManager[Keeper]:
    """Who has the bus: a process of its own, but where the bus is in this one."""
    buses = [replace(bus, reopens=job.stand_in or coupling.rules.reconnects) for bus in job.buses]
    if _inside(job):
        return beside(buses, coupling, step, _warn)
    return apart(buses, coupling, step, _warn, not job.stand_in, rescue)


def _inside(job: BridgeJob) -> bool:
    return sys.platform == "win32" or any(bus.interface in IN_PROCESS for bus in job.buses)


def _warn(line: str) -> None:
    LOG.warning("%s", line)


def _judged(
    job: BridgeJob, system: PreparedBridge, result: Result, ending: Ending, account: BusAccount, file: Path
) -> ScenarioResult:
    """The scenario's result with this case alone; judged where it came to its end and is no stand-in."""
    case = system.case
    expected = () if job.stand_in else case.expected
    early = ending.failure is not None or (ending.stopped and not job.stand_in)
    names = system.run.record or ()
    looked_at = {} if job.stand_in else case.looked_at
    try:
        result = replace(result, trace=_read(file, job.every, tuple(names), looked_at, result))
    except TraceError:
        if not isinstance(ending.failure, RecordError):  # of which there may be less than a record
            raise
    ran = Ran(result.trace, None, result, case=case.name, bus=account.counts)
    checks = () if early else tuple(_check(one, ran) for one in expected)
    state = CaseState.INTERRUPTED if early else CaseState.DONE
    judged = CaseResult(case.name, result, ending.failure, checks, file if file.exists() else None, state)
    keeping = Keeping(job.every, file.parent)
    given = {name: system.run.values[name] for name in elements(job.overrides)}
    return ScenarioResult(
        system.scenario,
        system.assembled,
        (judged,),
        keeping,
        early,
        system.crossings,
        given,
        system.simulation.system,
        hashes_of(system.assembled),
    )


def _check(expected: Expected, ran: Ran) -> Check:
    """How it turned out; one that looks beyond the record has not held, and what there is is kept."""
    try:
        return expected.check(ran)
    except ServotwinError as error:
        return Check(error.place, False, error.problem)


def _read(file: Path, every: int, names: Sequence[str], looked_at: Collection[str], result: Result) -> Trace:
    """What was recorded; of a long record what expectations look at."""
    rows = result.account.steps // every + 1
    chosen = names if rows * len(names) <= READABLE else [name for name in names if name in looked_at]
    if not chosen or rows < 2 or not file.exists():
        return result.trace
    return formats.read(file, formats.Layout(columns={name: name for name in chosen}, texts=True)).trace
