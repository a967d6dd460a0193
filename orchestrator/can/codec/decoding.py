"""Frames to signals, many at once: what logs need. Values equal those of cantools.

Everything in the stream that is not as it should be is counted in a statistics.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fmus.errors import TraceError
from orchestrator.can.codec.merging import Merger, Series, ascending, joined
from orchestrator.can.codec.message_reader import MessageReader, signal_columns
from orchestrator.can.codec.schedule import Schedule, counter_of, on_schedule
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.codec.time_stamps import StampRepair
from orchestrator.can.database.database import Database, MessageSpec
from orchestrator.can.frames import Flag, Frames
from orchestrator.can.statistics import FrameStatistics
from orchestrator.trace import Trace

__all__ = ["Decoded", "Decoder", "Merger", "Series", "SingleDecoder", "trace"]

CHUNK = 1 << 16  # frames decoded at once: their columns stay in the processor's cache
STANDARD = 1 << 11  # standard identifiers

Numbers = NDArray[np.signedinteger[Any]]


class Decoder:
    """Decodes a stream of frames, batch after batch.

    Attributes:
        statistics: what was found so far.
    """

    def __init__(self, database: Database, signals: Sequence[str] | None = None) -> None:
        """Decode these signals, all by default.

        Raises:
            DatabaseError: a signal is not in the database, or its name alone is that of several.
        """
        self.statistics = FrameStatistics()
        wanted = signal_columns(database, signals)
        self._readers = [
            MessageReader(message, wanted.get(message.name, ()), self.statistics) for message in database.messages
        ]
        self._stamps = StampRepair(self.statistics)
        self._standard, self._extended, self._extended_numbers = _tables(database.messages)

    @property
    def start(self) -> float | None:
        """Stamp of the first frame [s]; None before there was one."""
        return self._stamps.first

    def feed(self, frames: Frames) -> dict[str, Series]:
        """The signals of these frames: message -> its series; messages without a wanted signal are only counted."""
        pieces: dict[str, list[Series]] = {}
        for begin in range(0, len(frames), CHUNK):
            for name, series in self._chunk(frames[begin : begin + CHUNK]):
                pieces.setdefault(name, []).append(series)
        return {name: joined(parts) for name, parts in pieces.items()}

    def _chunk(self, frames: Frames) -> Iterator[tuple[str, Series]]:
        self.statistics.frames += len(frames)
        frames = self._data_frames(self._stamps.straightened(frames))
        numbers = self._numbers(frames)
        order = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers + 1, minlength=len(self._readers) + 1))
        time, length, data = frames.time[order], frames.length[order], frames.data.take(order, axis=0)
        self._count_unknown(frames[order[: ends[0]]])
        for reader, begin, end in zip(self._readers, ends[:-1].tolist(), ends[1:].tolist(), strict=True):
            if end > begin:
                series = reader.read(time[begin:end], length[begin:end], data[begin:end])
                if series.values:
                    yield reader.spec.name, series

    def _data_frames(self, frames: Frames) -> Frames:
        special = frames.flags & np.uint8(Flag.ERROR | Flag.REMOTE)
        if not special.any():
            return frames
        errors = frames.has(Flag.ERROR)
        self.statistics.errors += int(np.count_nonzero(errors))
        self.statistics.remotes += int(np.count_nonzero(frames.has(Flag.REMOTE) & ~errors))
        return frames[special == 0]

    def _numbers(self, frames: Frames) -> Numbers:
        """(K,) which message each frame is, by its place in the database; -1 for none."""
        extended = frames.has(Flag.EXTENDED)
        numbers = self._standard[np.minimum(frames.id, STANDARD)]
        if extended.any():
            identifiers = frames.id[extended]
            places = np.searchsorted(self._extended, identifiers)
            found = self._extended[places] == identifiers
            numbers[extended] = np.where(found, self._extended_numbers[places], -1)
        return numbers

    def _count_unknown(self, frames: Frames) -> None:
        extended = frames.has(Flag.EXTENDED)
        for kind, chosen in ((False, ~extended), (True, extended)):
            for identifier, count in zip(*np.unique(frames.id[chosen], return_counts=True), strict=True):
                self.statistics.add_unknown(int(identifier), kind, int(count))


@dataclass(frozen=True)
class Decoded:
    """A log as a trace.

    Attributes:
        trace: all signals that are in the log, over time from 0 at the first frame [s].
        start: stamp of the first frame [s].
        series: message -> its series, over the same time.
        schedules: of the messages whose stamps were put on one.
    """

    trace: Trace
    start: float
    statistics: FrameStatistics
    series: Mapping[str, Series]
    schedules: tuple[Schedule, ...] = ()


def trace(
    frames: Iterable[Frames],
    database: Database,
    signals: Sequence[str] | None = None,
    interpolated: Collection[str] = (),
    channel: int | None = None,
    steady: Collection[str] = (),
    name: str = "can",
) -> Decoded:
    """A whole log in memory: rows at all stamps, from where every signal that is in the log has been seen.

    Args:
        interpolated: signals that run linearly between their frames (measured quantities) instead of being held.
        channel: only frames of this channel.
        steady: messages whose frames get the stamps of the even schedule that their sender kept.

    Raises:
        DatabaseError: a signal or message is not in the database.
        TraceError: none of the signals is in the log, one that was named is not, or a steady message has no counter.
    """
    counters = {message: counter_of(database, message) for message in steady}
    decoder = Decoder(database, None if signals is None else [*signals, *counters.values()])
    linear = {database.public_name(*database.signal(signal)) for signal in interpolated}
    pieces: dict[str, list[Series]] = {}
    for batch in frames:
        chosen = batch if channel is None else batch[batch.channel == channel]
        for message, part in decoder.feed(chosen).items():
            pieces.setdefault(message, []).append(part)
    start = decoder.start or 0.0
    series = {message: _from(start, joined(parts)) for message, parts in pieces.items()}
    schedules = []
    for message in counters.keys() & series.keys():
        protection = database.message(message).protection
        assert protection is not None
        own = series[message]
        series[message], found = on_schedule(own, message, own.values[counters[message]], protection.modulus)
        schedules.append(found)
    named = None if signals is None else [database.public_name(*database.signal(signal)) for signal in signals]
    merger = Merger(
        _columns(named, series, name), interpolated=linear, name=name, statistics=decoder.statistics, patience=0.0
    )
    return Decoded(merger.feed(series), start, decoder.statistics, series, tuple(schedules))


def _tables(messages: Sequence[MessageSpec]) -> tuple[Numbers, NDArray[np.uint32], Numbers]:
    """Message numbers of standard identifiers; extended identifiers, ascending and ended by a guard, and theirs."""
    # NumPy sorts short ones faster.
    kind: type[np.signedinteger[Any]] = np.int16 if len(messages) < np.iinfo(np.int16).max else np.int32
    standard: Numbers = np.full(STANDARD + 1, -1, dtype=kind)
    pairs = []
    for number, message in enumerate(messages):
        if message.extended:
            pairs.append((message.id, number))
        else:
            standard[message.id] = number
    identifiers, numbers = zip(*sorted(pairs), (np.iinfo(np.uint32).max, -1), strict=True)
    return standard, np.array(identifiers, dtype=np.uint32), np.array(numbers, dtype=kind)


def _from(start: float, series: Series) -> Series:
    """The series with stamps from `start` on, ascending."""
    return ascending(Series(series.time - start, series.values, series.units))


def _columns(wanted: Sequence[str] | None, series: Mapping[str, Series], name: str) -> list[str]:
    """The wanted signals, by default all that have a value in the log.

    Raises:
        TraceError: there are none, or one that was named has none.
    """
    found = [key for part in series.values() for key, values in part.values.items() if np.isfinite(values).any()]
    missing = [key for key in wanted or () if key not in found]
    if missing:
        raise TraceError(
            name, f"holds no frame with the signal {', '.join(missing)}", "check the database, the channel and the log"
        )
    if not found:
        raise TraceError(name, "holds no frame of the database", "check that log and database belong together")
    return found if wanted is None else list(dict.fromkeys(wanted))
