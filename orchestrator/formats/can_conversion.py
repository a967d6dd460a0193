"""CAN logs into other files and back: decoded into a trace piece by piece, copied frame by frame, or encoded."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fmus.errors import DatabaseError, TraceError
from fmus.files import atomic_write
from fmus.json_document import document_of
from orchestrator import formats
from orchestrator.can import logs
from orchestrator.can.codec.absence import AbsentError
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.merging import LateBegins, Merger
from orchestrator.can.codec.streams import FrameStream, SignalNames
from orchestrator.can.database.bus import LogDatabase, load_all
from orchestrator.can.database.database import Database
from orchestrator.can.database.sources import paths
from orchestrator.can.logs.frame_count import moment
from orchestrator.crossing import Crossing, crossing, named, noted
from orchestrator.formats import can_log, csv, parquet
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import coarse, largest
from orchestrator.progress import Progress, share_of
from orchestrator.trace import Trace

STREAMED: dict[str, Callable[[Path], AbstractContextManager[Callable[[Trace], None]]]] = {
    ".csv": csv.appending,
    ".parquet": parquet.appending,
}


@dataclass(frozen=True)
class ConvertedLog:
    """What was written.

    Attributes:
        count: of `what`: samples or frames.
        start: POSIX time of time 0 of a trace made from a log [s].
        notes: what was found on the way or could not be kept, a line each.
        found: the notes' figures.
    """

    count: int
    what: str
    start: float | None = None
    notes: tuple[str, ...] = ()
    found: Mapping[str, object] = field(default_factory=dict)

    @property
    def begin(self) -> str | None:
        """Time 0 as date and time."""
        return None if self.start is None else moment(self.start)

    def lines(self, target: Path) -> list[str]:
        """For people."""
        since = "" if self.start is None else f", time 0 is {self.begin}"
        return [f"{target}: {self.count} {self.what}{since}", *self.notes]


def convert(source: Path, target: Path, layout: Layout, progress: Progress) -> ConvertedLog:
    """A recording or log written in the format that the target's suffix names.

    A log becomes a log of the same frames, or with a database a trace; a trace becomes a log with a database.

    Raises:
        TraceError: the source cannot be read, or the target cannot hold it.
        DatabaseError: the database cannot be read, or lacks a signal.
    """
    is_csv = target.suffix.lower() == ".csv"
    to_log = target.suffix.lower() in logs.SUFFIXES and not is_csv
    if not logs.is_log(source):
        return encoded(source, target, layout) if to_log else _copied(source, target, layout)
    if to_log or (is_csv and layout.database is None):
        return relogged(source, target, layout, progress)
    if target.suffix.lower() in STREAMED and not (layout.interpolated or layout.steady):
        return streamed(source, target, layout, progress)
    return _copied(source, target, layout)


def relogged(source: Path, target: Path, layout: Layout, progress: Progress) -> ConvertedLog:
    """The same frames in another format of logs, all or those of the layout's channel."""
    log, lost = logs.read(source, progress), Counter[str]()
    count = logs.write(target, (can_log.of_channel(batch, layout) for batch in log), _attached(layout), lost)
    told = tuple(f"{target.suffix} does not hold {what}: {times} times" for what, times in lost.items())
    found: dict[str, object] = {**document_of(log.findings), **({"lost": dict(lost)} if lost else {})}
    return ConvertedLog(count, "frames", None, (*log.findings.lines(), *told), found)


def encoded(source: Path, target: Path, layout: Layout) -> ConvertedLog:
    """The frames that carry a trace: the signals that the layout chooses, or all that the database has, in its units.

    A signal `hand.angle` of a system is `hand_angle` in a database that has no message `hand`.
    """
    if layout.database is None:
        raise TraceError(target, "takes frames; a database says how signals become frames", "give it as --dbc FILE")
    recording, database = formats.read(source, replace(layout, database=None, signals=None)), _of_one_bus(layout)
    known = {
        name
        for message in database.messages
        for signal in message.signals
        for name in (signal.name, f"{message.name}.{signal.name}")
    }
    trace = recording.trace.renamed(
        {name: flat for name in recording.trace.names if (flat := name.replace(".", "_")) in known}
    )
    wanted = layout.signals or [name for name in trace.names if name in known]
    if not wanted:
        raise TraceError(source, f"has no signal of {database.path}", f"it holds {', '.join(trace.names)}")
    encoder, lost = Encoder(database, list(wanted)), Counter[str]()
    sent, crossed = _in_units_of(database, trace.select(wanted))
    count = logs.write(target, [encoder.encode(sent, recording.start or 0.0)], _attached(layout), lost)
    left = [name for name in trace.names if name not in wanted]
    told = [f"not in the database: {', '.join(left)}"] if left and layout.signals is None else []
    rest = _resting(database, wanted)
    told += [f"without a value in the recording, sent at rest: {', '.join(rest)}"] if rest else []
    told += [f"{target.suffix} does not hold {what}: {times} times" for what, times in lost.items()]
    notes = (*recording.notes, *database.notes, *map(str, noted(crossed)), *encoder.statistics.lines(), *told)
    return ConvertedLog(count, "frames", None, notes, encoder.statistics.document())


def _in_units_of(database: Database, trace: Trace) -> tuple[Trace, list[Crossing]]:
    """The trace with each signal in the unit that the database has for it, and how it got there.

    Raises:
        WiringError: it has one of another quantity.
    """
    units = {name: database.signal(name)[1].unit for name in trace.names}
    crossed = {name: crossing(f"{trace.name}.{name}", named(trace.unit(name)), named(units[name])) for name in units}
    signals = {name: how.conversion(trace[name]) for name, how in crossed.items()}
    return Trace(trace.time, signals, {n: unit for n, unit in units.items() if unit}, trace.name), [*crossed.values()]


def _resting(database: Database, wanted: Sequence[str]) -> list[str]:
    """The signals that go along in the frames of those that are wanted; what protects or selects is made up rightly."""
    sent = {(message.name, signal.name): message for message, signal in map(database.signal, wanted)}
    return [
        f"{message.name}.{signal.name}"
        for message in dict.fromkeys(sent.values())
        for signal in message.signals
        if (message.name, signal.name) not in sent
        and not signal.is_multiplexer
        and (message.protection is None or signal.name not in (message.protection.counter, message.protection.checksum))
    ]


def streamed(source: Path, target: Path, layout: Layout, progress: Progress) -> ConvertedLog:
    """A log decoded into a file of samples, in memory that does not grow with the log.

    The log is read twice: first to know which signals are in it, from when on rows are complete.
    """
    database = can_log.database_of(source, layout)
    survey = _survey(source, database, layout, share_of(progress, 0.0, 0.5))
    log = logs.read(source, share_of(progress, 0.5, 1.0))
    decoder, units = Decoder(database, can_log.signals(layout), log.channels, can_log.source_of(layout)), survey.units
    merger = Merger(list(units), start=survey.start, name=source.stem, statistics=decoder.statistics)
    known = {name: unit for name, unit in units.items() if unit}
    begins, reached = LateBegins(), dict[str, float]()

    def content(file: BinaryIO) -> None:
        nonlocal reached
        with STREAMED[target.suffix.lower()](Path(file.name)) as append:
            for piece in _pieces(log, decoder, merger, layout, survey.names):
                whole = can_log.laid_out(Trace(piece.time, piece.signals, known, piece.name), layout, survey.names)
                append(whole)
                begins.feed(whole)
                reached = largest(whole, reached)

    atomic_write(target, content)
    told = (*can_log.notes(log, database, survey.names, decoder.statistics), *begins.lines(), *coarse(reached))
    return ConvertedLog(
        begins.rows, "samples", survey.start, told, {**decoder.statistics.document(), **document_of(log.findings)}
    )


def _of_one_bus(layout: Layout) -> Database:
    """The databases that frames are made with."""
    assert layout.database is not None
    read = load_all(layout.database, layout.encoding)
    if read.own or read.everywhere is None:
        channels = ", ".join(read.own)
        raise DatabaseError(f"channel {channels}", "frames are made for one bus", "give the database without a channel")
    return read.everywhere


def _attached(layout: Layout) -> Path | None:
    """The database that a log may carry along."""
    files = [] if layout.database is None else paths(layout.database)
    return files[0] if len(files) == 1 else None


def _copied(source: Path, target: Path, layout: Layout) -> ConvertedLog:
    recording = formats.read(source, layout)
    formats.write(recording.trace, target)
    notes = (str(recording.stamps), *recording.notes)
    return ConvertedLog(len(recording.trace), "samples", recording.start, notes, dict(recording.found))


def _pieces(
    log: logs.LogReader, decoder: Decoder, merger: Merger, layout: Layout, names: SignalNames
) -> Iterator[Trace]:
    for batch in log:
        found = decoder.feed(can_log.of_channel(batch, layout))
        yield merger.feed({stream: series.renamed(partial(names.name, stream)) for stream, series in found.items()})
    yield merger.finish()


@dataclass(frozen=True)
class Survey:
    """What is in a log: stamp of its first frame [s], its streams, and units ("" unknown) of what has a value."""

    start: float
    names: SignalNames
    units: Mapping[str, str]


def _survey(source: Path, database: LogDatabase, layout: Layout, progress: Progress) -> Survey:
    """Reads the log for what is in it.

    Raises:
        TraceError: no signal has a value, or one that was asked for has none.
    """
    wanted = can_log.signals(layout)
    log = logs.read(source, progress)
    counted = can_log.Counted(log)
    decoder, there = (
        Decoder(database, wanted, log.channels, can_log.source_of(layout)),
        dict[tuple[FrameStream, str], str](),
    )
    for batch in counted:
        for stream, series in decoder.feed(can_log.of_channel(batch, layout)).items():
            for name, values in series.values.items():
                if (stream, name) not in there and np.isfinite(values).any():
                    there[stream, name] = series.units.get(name, "")
    names = decoder.names()
    units = {names.name(*signal): unit for signal, unit in there.items()}
    try:
        chosen = names.chosen(wanted, units, str(source))
    except AbsentError as error:
        raise can_log.refusal(source, error, counted.frame_count) from None
    return Survey(decoder.start or 0.0, names, {name: units[name] for name in chosen})
