"""CAN logs as recordings: their frames decoded with a database into one trace over the time since the first frame."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from fmus.errors import TraceError
from fmus.files import sha256
from fmus.json_document import document_of
from orchestrator.can import logs
from orchestrator.can.codec import decoding
from orchestrator.can.codec.absence import AbsentError
from orchestrator.can.codec.merging import LateBegins
from orchestrator.can.codec.streams import SignalNames
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.frames import Frames
from orchestrator.can.logs.frame_count import FrameCount
from orchestrator.can.statistics import FrameStatistics
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording
from orchestrator.marks import Mark
from orchestrator.progress import Progress, silent
from orchestrator.stamps import ordered
from orchestrator.trace import Trace

MOST = 1000  # marks that are told


def read(path: Path, layout: Layout, progress: Progress = silent) -> Recording:
    """The recording in a log: the signals that the layout chooses, all of the database by default.

    Raises:
        TraceError: the layout names no database, nothing of it is in the log, or the log cannot be read.
        DatabaseError: the database cannot be read, or lacks a signal.
    """
    database = database_of(path, layout)
    log = logs.read(path, progress)
    counted = Counted(log)
    try:
        decoded = decoding.trace(
            counted,
            database,
            signals(layout),
            layout.interpolated,
            layout.channel,
            layout.steady,
            str(path),
            source_of(layout),
            log.channels,
        )
    except AbsentError as error:
        raise refusal(path, error, counted.frame_count) from None
    trace, stamps = ordered(decoded.trace.time, decoded.trace.signals, decoded.trace.units, str(path))
    schedules = {"schedules": [*map(str, decoded.schedules)]} if decoded.schedules else {}
    found: dict[str, object] = {**decoded.statistics.document(), **document_of(log.findings), **schedules}
    named = laid_out(Trace(trace.time, trace.signals, trace.units, path.stem), layout, decoded.names)
    begins = LateBegins()
    begins.feed(named)
    told = notes(log, database, decoded.names, decoded.statistics)
    marks = _laid_out_marks(decoded.marks, decoded.trace, layout, decoded.names)
    found |= {"marks": [vars(mark) for mark in marks[:MOST]]} if marks else {}
    return Recording(named, stamps, path, sha256(path), (*told, *begins.lines()), decoded.start, found, marks=marks)


def notes(
    log: logs.LogReader, database: LogDatabase, names: SignalNames, statistics: FrameStatistics
) -> tuple[str, ...]:
    """What was found in log and database, a line each."""
    return (*database.notes, *log.findings.lines(), *names.notes(), *statistics.lines())


@dataclass
class Counted:
    """Batches as they pass by, and what they hold."""

    batches: Iterable[Frames]
    frame_count: FrameCount = field(default_factory=FrameCount)

    def __iter__(self) -> Iterator[Frames]:
        for batch in self.batches:
            self.frame_count.feed(batch)
            yield batch


def database_of(path: Path, layout: Layout) -> LogDatabase:
    """The database that the layout names.

    Raises:
        TraceError: it names none.
    """
    if layout.database is None:
        raise TraceError(
            path,
            "holds raw CAN frames; a database says what they mean",
            "give it as --dbc FILE, in a study as traces.layout.database",
        )
    return load_all(layout.database, layout.encoding, j1939=layout.source is not None)


def source_of(layout: Layout) -> int | None:
    """The address of the only sender that is wanted; None for all."""
    return layout.source if isinstance(layout.source, int) else None


def of_channel(frames: Frames, layout: Layout) -> Frames:
    """The frames of the layout's channel."""
    return frames if layout.channel is None else frames[frames.channel == layout.channel]


def signals(layout: Layout) -> list[str] | None:
    """The database's signals that are wanted, None for all."""
    if layout.columns is not None:
        return [str(column) for column in layout.columns.values()]
    return None if layout.signals is None else list(layout.signals)


def laid_out(trace: Trace, layout: Layout, names: SignalNames) -> Trace:
    """The trace with the names and units that the layout gives.

    Raises:
        TraceError: units are given for a signal that is not read, or a column is in the log several times.
    """
    if layout.columns is not None:
        chosen = {name: _only(trace, str(column), names) for name, column in layout.columns.items()}
        units = {name: trace.units[source] for name, source in chosen.items() if source in trace.units}
        trace = Trace(trace.time, {name: trace[source] for name, source in chosen.items()}, units, trace.name)
    stray = set(layout.units) - set(trace.names)
    if stray:
        raise TraceError(trace.name, f"units are given for '{min(stray)}', which is not read", "correct the layout")
    return Trace(trace.time, trace.signals, {**trace.units, **layout.units}, trace.name)


def _laid_out_marks(marks: Sequence[Mark], trace: Trace, layout: Layout, names: SignalNames) -> tuple[Mark, ...]:
    """Those of the signals that the layout chooses, by the names that it gives."""
    given = (layout.columns or {name: name for name in trace.names}).items()
    sources = {name: _only(trace, str(column), names) for name, column in given}
    chosen = (
        replace(mark, signals=tuple(name for name, source in sources.items() if source in mark.signals))
        for mark in marks
    )
    return tuple(mark for mark in chosen if mark.signals)


def _only(trace: Trace, column: str, names: SignalNames) -> str:
    """The one signal of the trace that a column of the layout means."""
    found = [name for name in names.of(column) if name in trace.names]
    if len(found) > 1:
        raise TraceError(
            trace.name, f"has '{column}' {len(found)} times, as {' and '.join(found)}", "name one, or give the channel"
        )
    return found[0]


def refusal(path: Path, error: AbsentError, frame_count: FrameCount) -> TraceError:
    """The decoder's refusal with the reasons, and with what is in the log."""
    there = (
        f"identifiers in the log: {frame_count.listed()}"
        if frame_count.identifiers
        else "there are no data frames in it"
    )
    reasons = error.reasons(frame_count.identifiers)
    return TraceError(path, f"{error.problem} ({f'{reasons}; ' if reasons else ''}{there})", error.fix)
