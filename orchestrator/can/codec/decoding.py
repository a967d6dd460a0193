"""Frames to signals, many at once: what logs need. Values equal those of cantools.

Everything in the stream that is not as it should be is counted in a statistics.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from orchestrator.can.codec.merging import Merger, Series, ascending, joined
from orchestrator.can.codec.message_reader import MessageReader, columns
from orchestrator.can.codec.routing import Router
from orchestrator.can.codec.schedule import Schedule, counter_of, on_schedule
from orchestrator.can.codec.streams import SignalNames, Stream, channel_name, wanted
from orchestrator.can.codec.time_stamps import StampRepair, smallest_step
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.frames import Flag, Frames
from orchestrator.can.statistics import FrameStatistics
from orchestrator.trace import Bytes, Trace

CHUNK = 1 << 16  # frames decoded at once: their columns stay in the processor's cache


class Decoder:
    """Decodes a stream of frames, batch after batch.

    Attributes:
        statistics: what was found so far.
    """

    def __init__(
        self, log: LogDatabase, signals: Sequence[str] | None = None, channels: Mapping[int, str] | None = None
    ) -> None:
        """Decode these signals, all by default.

        Args:
            channels: names of the channels' interfaces, as far as they are known; may grow while frames come.

        Raises:
            DatabaseError: a signal is not in the database, or its name alone is that of several.
        """
        self.statistics = FrameStatistics()
        self._log = log
        self._channels = {} if channels is None else channels
        self._router = Router(log, self._channels)
        chosen = None if signals is None else {(asked.message, asked.name) for asked in wanted(log, signals)}
        self._columns = [
            [column for column in columns(owner, message) if chosen is None or (message.name, column.name) in chosen]
            for owner, message in zip(self._router.owners, self._router.messages, strict=True)
        ]
        self._readers: dict[tuple[int, int], tuple[Stream, MessageReader]] = {}
        self._stamps = StampRepair(self.statistics)

    @property
    def start(self) -> float | None:
        """Stamp of the first frame [s]; None before there was one."""
        return self._stamps.first

    def names(self) -> SignalNames:
        """What the signals of the streams so far are called."""
        streams = {stream: reader.signals for _, (stream, reader) in sorted(self._readers.items()) if reader.count}
        return SignalNames(self._log, streams)

    def feed(self, frames: Frames) -> dict[Stream, Series]:
        """The signals of these frames by their names in the database; streams without a wanted one are only counted."""
        pieces: dict[Stream, list[Series]] = {}
        for begin in range(0, len(frames), CHUNK):
            for stream, series in self._chunk(frames[begin : begin + CHUNK]):
                pieces.setdefault(stream, []).append(series)
        return {stream: joined(parts) for stream, parts in pieces.items()}

    def _chunk(self, frames: Frames) -> Iterator[tuple[Stream, Series]]:
        self.statistics.frames += len(frames)
        frames = self._data_frames(self._stamps.straightened(frames))
        numbers = self._router.numbers(frames)
        order = np.argsort(numbers, kind="stable")
        ends = np.cumsum(np.bincount(numbers + 1, minlength=len(self._columns) + 1))
        channel, time, length = frames.channel[order], frames.time[order], frames.length[order]
        data, tick = frames.data.take(order, axis=0), smallest_step(frames.time)
        self._count_unknown(frames[order[: ends[0]]])
        for number, (begin, end) in enumerate(pairwise(ends.tolist())):
            for own, rows in _by_value(channel, begin, end):
                stream, reader = self._reader(number, own)
                series = reader.read(time[rows], length[rows], data[rows], tick)
                if len(series) and series.values:
                    yield stream, series

    def _reader(self, number: int, channel: int) -> tuple[Stream, MessageReader]:
        key = number, channel
        if key not in self._readers:
            message, name = self._router.messages[number], channel_name(channel, self._channels)
            reader = MessageReader(message, self._columns[number], self.statistics)
            self._readers[key] = Stream(message.name, name), reader
        return self._readers[key]

    def _data_frames(self, frames: Frames) -> Frames:
        special = frames.flags & np.uint8(Flag.ERROR | Flag.REMOTE)
        if not special.any():
            return frames
        errors = frames.has(Flag.ERROR)
        self.statistics.errors += int(np.count_nonzero(errors))
        self.statistics.remotes += int(np.count_nonzero(frames.has(Flag.REMOTE) & ~errors))
        return frames[special == 0]

    def _count_unknown(self, frames: Frames) -> None:
        extended = frames.has(Flag.EXTENDED)
        for kind, chosen in ((False, ~extended), (True, extended)):
            for identifier, count in zip(*np.unique(frames.id[chosen], return_counts=True), strict=True):
                self.statistics.add_unknown(int(identifier), kind, int(count))


@dataclass(frozen=True)
class Decoded:
    """A log as a trace.

    Attributes:
        trace: all signals that are in the log, over time from 0 at the first frame [s]; NaN until first seen.
        start: stamp of the first frame [s].
        series: stream -> its series, over the same time.
        names: of the streams' signals in the trace.
        schedules: of the streams whose stamps were put on one.
    """

    trace: Trace
    start: float
    statistics: FrameStatistics
    series: Mapping[Stream, Series]
    names: SignalNames
    schedules: tuple[Schedule, ...] = ()


def trace(
    frames: Iterable[Frames],
    log: LogDatabase,
    signals: Sequence[str] | None = None,
    interpolated: Collection[str] = (),
    channel: int | None = None,
    steady: Collection[str] = (),
    name: str = "can",
    channels: Mapping[int, str] | None = None,
) -> Decoded:
    """A whole log in memory: rows at all stamps.

    Args:
        interpolated: signals that run linearly between their frames (measured quantities) instead of being held.
        channel: only frames of this channel.
        steady: messages whose frames get the stamps of the even schedule that their sender kept.
        channels: names of the channels' interfaces; see `Decoder`.

    Raises:
        DatabaseError: a signal or message is not in the database.
        TraceError: none of the signals is in the log, one that was named is not, or a steady message has no counter.
    """
    counters = {message: counter_of(log, message) for message in steady}
    added = [counter.name for counter in counters.values()]
    decoder = Decoder(log, None if signals is None else [*signals, *added], channels)
    pieces: dict[Stream, list[Series]] = {}
    for batch in frames:
        chosen = batch if channel is None else batch[batch.channel == channel]
        for stream, part in decoder.feed(chosen).items():
            pieces.setdefault(stream, []).append(part)
    start = decoder.start or 0.0
    series = {stream: _from(start, joined(parts)) for stream, parts in pieces.items()}
    schedules = []
    for stream in [stream for stream in series if stream.message in counters]:
        own, counter = series[stream], counters[stream.message]
        series[stream], found = on_schedule(own, stream.message, own.values[counter.name], counter.modulus)
        schedules.append(found)
    names = decoder.names()
    named = {stream: own.renamed(partial(names.name, stream)) for stream, own in series.items()}
    there = {name for own in named.values() for name, values in own.values.items() if np.isfinite(values).any()}
    linear = {own for signal in interpolated for own in names.of(signal)}
    merger = Merger(names.chosen(signals, there, name), 0.0, 0.0, linear, name, decoder.statistics)
    return Decoded(merger.feed(named), start, decoder.statistics, series, names, tuple(schedules))


def _by_value(channel: Bytes, begin: int, end: int) -> Iterator[tuple[int, slice | NDArray[np.intp]]]:
    """The rows from `begin` to `end` of each channel."""
    own = channel[begin:end]
    if not len(own):
        return
    if own.min() == own.max():
        yield int(own[0]), slice(begin, end)
        return
    for value in np.unique(own).tolist():
        yield value, np.flatnonzero(own == value) + begin


def _from(start: float, series: Series) -> Series:
    """The series with stamps from `start` on, ascending."""
    return ascending(Series(series.time - start, series.values, series.units))
