"""Frames to signals, many at once: what logs need. Values equal those of cantools.

Everything in the stream that is not as it should be is counted in a statistics.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from orchestrator.can.codec.merging import Merger, Series, ascending, joined
from orchestrator.can.codec.message_reader import MessageReader, columns
from orchestrator.can.codec.routing import Group, Router, groups
from orchestrator.can.codec.schedule import MessageSchedule, counter_of, on_schedule
from orchestrator.can.codec.streams import FrameStream, SignalNames, channel_name, wanted
from orchestrator.can.codec.time_stamps import StampRepair, smallest_step
from orchestrator.can.codec.transport import Packet, Transport, frames_of, is_transport
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.frames import Flag, Frames, since
from orchestrator.can.statistics import FrameStatistics
from orchestrator.marks import Mark
from orchestrator.trace import BoolArray, Bytes, FloatArray, Trace

CHUNK = 1 << 16  # frames decoded at once: their columns stay in the processor's cache


class Decoder:
    """Decodes a stream of frames, batch after batch.

    Attributes:
        statistics: what was found so far.
    """

    def __init__(
        self,
        log: LogDatabase,
        signals: Sequence[str] | None = None,
        channels: Mapping[int, str] | None = None,
        source: int | None = None,
    ) -> None:
        """Decode these signals, all by default.

        Args:
            source: of messages that several may send only those of the sender with this address.
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
        self._readers: dict[tuple[int, int, int], tuple[FrameStream, MessageReader]] = {}
        self._source, self._transport = source, Transport()
        kinds = {message.addressing.kind for message in self._router.messages if message.addressing}
        self._has_groups = "J1939" in kinds
        self._stamps = StampRepair(self.statistics)

    @property
    def start(self) -> float | None:
        """Stamp of the first frame [s]; None before there was one."""
        return self._stamps.first

    def marks(self, series: Mapping[FrameStream, Series], start: float) -> dict[FrameStream, list[Mark]]:
        """What of these series, of all frames so far, from `start` on and ascending, is not to be trusted."""
        end = float(since(start, np.array([self._stamps.latest]))[0])
        readers = dict(self._readers.values())
        return {stream: readers[stream].marks(own, end) for stream, own in series.items()}

    def names(self) -> SignalNames:
        """What the signals of the streams so far are called."""
        streams = {stream: reader.signals for _, (stream, reader) in sorted(self._readers.items()) if reader.count}
        silent = [channel for channel in self._log.own if channel not in self._router.met]
        return SignalNames(self._log, streams, self.statistics, silent)

    def feed(self, frames: Frames) -> dict[FrameStream, Series]:
        """The signals of these frames by their names in the database; streams without a wanted one are only counted."""
        pieces: dict[FrameStream, list[Series]] = {}
        for begin in range(0, len(frames), CHUNK):
            for stream, series in self._chunk(frames[begin : begin + CHUNK]):
                pieces.setdefault(stream, []).append(series)
        return {stream: joined(parts) for stream, parts in pieces.items()}

    def _chunk(self, frames: Frames) -> Iterator[tuple[FrameStream, Series]]:
        self.statistics.frames += len(frames)
        frames = self._data_frames(self._stamps.straightened(frames))
        tick = smallest_step(frames.time)
        chosen, begins = self._sorted(frames, is_transport(frames) if self._has_groups else None)
        for group in groups(chosen, begins, self._router.messages):
            yield from self._read(group, chosen.time, chosen.length, chosen.data, tick)
        if self._has_groups and (packets := self._transport.feed(frames)):
            self.statistics.transported += len(packets)
            yield from self._put_together(packets, tick)
        self.statistics.broken = self._transport.broken + self._transport.unfinished

    def _put_together(self, packets: list[Packet], tick: float) -> Iterator[tuple[FrameStream, Series]]:
        """The signals of messages that came in parts."""
        size = np.array([len(packet.data) for packet in packets])
        width = -(-int(size.max()) // 8) * 8
        data = np.frombuffer(b"".join(packet.data.ljust(width, b"\0") for packet in packets), np.uint8)
        whole, begins = self._sorted(frames_of(packets, size, data.reshape(-1, width)))
        for group in groups(whole, begins, self._router.messages):
            yield from self._read(group, whole.time, whole.length, whole.data, tick)

    def _sorted(self, frames: Frames, known: BoolArray | None = None) -> tuple[Frames, list[int]]:
        """The frames of each message in a row, and where these begin; of others those not `known` are counted."""
        numbers = self._router.numbers(frames)
        order = np.argsort(numbers, kind="stable")
        begins = np.cumsum(np.bincount(numbers + 1, minlength=len(self._columns) + 1)).tolist()
        unknown = order[: begins[0]]
        self._count_unknown(frames[unknown if known is None else unknown[~known[unknown]]])
        return frames.taken(order), begins

    def _read(
        self, group: Group, time: FloatArray, length: Bytes, data: Bytes, tick: float
    ) -> Iterator[tuple[FrameStream, Series]]:
        message = self._router.messages[group.number]
        if message.addressing is not None and self._source not in (None, group.sender):
            self.statistics.other_sources[message.name] += len(time[group.rows])
            return
        stream, reader = self._reader(group)
        series = reader.read(time[group.rows], length[group.rows], data[group.rows], tick)
        if len(series) and series.values:
            yield stream, series

    def _reader(self, group: Group) -> tuple[FrameStream, MessageReader]:
        key = group[:3]
        if key not in self._readers:
            message, name = self._router.messages[group.number], channel_name(group.channel, self._channels)
            sender = message.addressing.label(group.sender) if message.addressing else ""
            reader = MessageReader(message, self._columns[group.number], self.statistics)
            self._readers[key] = FrameStream(message.name, name, sender), reader
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
class DecodedLog:
    """A log as a trace.

    Attributes:
        trace: all signals that are in the log, over time from 0 at the first frame [s]; NaN until first seen.
        start: stamp of the first frame [s].
        series: stream -> its series, over the same time.
        names: of the streams' signals in the trace.
        schedules: of the streams whose stamps were put on one.
        marks: what is not to be trusted of the signals in the trace.
    """

    trace: Trace
    start: float
    statistics: FrameStatistics
    series: Mapping[FrameStream, Series]
    names: SignalNames
    schedules: tuple[MessageSchedule, ...] = ()
    marks: tuple[Mark, ...] = ()


def trace(
    frames: Iterable[Frames],
    log: LogDatabase,
    signals: Sequence[str] | None = None,
    interpolated: Collection[str] = (),
    channel: int | None = None,
    steady: Collection[str] = (),
    name: str = "can",
    source: int | None = None,
    channels: Mapping[int, str] | None = None,
) -> DecodedLog:
    """A whole log in memory: rows at all stamps.

    Args:
        interpolated: signals that run linearly between their frames (measured quantities) instead of being held.
        channel: only frames of this channel.
        steady: messages whose frames get the stamps of the even schedule that their sender kept.
        source, channels: see `Decoder`.

    Raises:
        DatabaseError: a signal or message is not in the database.
        TraceError: none of the signals is in the log, one that was named is not, or a steady message has no counter.
    """
    counters = {message: counter_of(log, message) for message in steady}
    added = [counter.name for counter in counters.values()]
    decoder = Decoder(log, None if signals is None else [*signals, *added], channels, source)
    pieces: dict[FrameStream, list[Series]] = {}
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
    marks = tuple(
        replace(mark, signals=tuple(names.name(stream, signal) for signal in mark.signals))
        for stream, found in decoder.marks(series, start).items()
        for mark in found
    )
    return DecodedLog(merger.feed(named), start, decoder.statistics, series, names, tuple(schedules), marks)


def _from(start: float, series: Series) -> Series:
    """The series with stamps from `start` on, ascending."""
    return ascending(Series(since(start, series.time), series.values, series.units))
