"""Frames of one message to its signals, many at once; what is wrong with them is counted."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from orchestrator.can.codec import bits
from orchestrator.can.codec.fields import field_of, longest
from orchestrator.can.codec.merging import Series
from orchestrator.can.codec.multiplexing import Presence, whole
from orchestrator.can.codec.time_stamps import spread
from orchestrator.can.database import protection as checks
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.marking import Absences, FrameColumn, Rejections, marks
from orchestrator.can.statistics import FrameStatistics, add
from orchestrator.marks import Mark
from orchestrator.trace import BoolArray, Bytes, FloatArray


@dataclass(frozen=True, eq=False)
class MessageRows:
    """Frames of one message: stamps (K,) and data (K, n), and the data as words in either order."""

    time: FloatArray
    data: Bytes

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, rows: BoolArray) -> MessageRows:
        return MessageRows(self.time[rows], self.data[rows])

    @cached_property
    def little(self) -> bits.Words:
        return bits.words(self.data, bits.LITTLE)

    @cached_property
    def big(self) -> bits.Words:
        return bits.words(self.data, bits.BIG)

    def raw(self, place: bits.BitField) -> bits.Words:
        """(K,) the bits of the field."""
        return place.raw(self.big if place.big_endian else self.little)


@dataclass(frozen=True)
class SignalColumn:
    """A signal that is decoded.

    Attributes:
        name: public name.
        low, high: values beyond are out of range; None where the bits cannot hold such.
    """

    name: str
    spec: SignalSpec
    place: bits.BitField
    low: float | None
    high: float | None


def channel(name: str, spec: SignalSpec) -> SignalColumn:
    """The signal under its public name, with the limits that its values can break."""
    place = field_of(spec)
    slack = 1e-6 * abs(spec.scale)
    ends = [limit * spec.scale + spec.offset for limit in place.limits()]
    low = None if spec.minimum is None or min(ends) >= spec.minimum - slack else spec.minimum - slack
    high = None if spec.maximum is None or max(ends) <= spec.maximum + slack else spec.maximum + slack
    return SignalColumn(name, spec, place, low, high)


def columns(database: Database, message: MessageSpec) -> list[SignalColumn]:
    """All signals of a message."""
    return [channel(database.public_name(message, signal), signal) for signal in message.signals]


class MessageReader:
    """Decodes the frames of one message from one sender, batch after batch.

    Attributes:
        count: of the frames that were decoded.
        rejections: frames that a receiver rejects.
    """

    def __init__(self, spec: MessageSpec, signal_columns: Sequence[SignalColumn], statistics: FrameStatistics) -> None:
        self.spec, self._columns, self._statistics = spec, signal_columns, statistics
        self.count, self.rejections = 0, Rejections()
        self._absences = Absences(spec.cycle, spec.protection.modulus if spec.protection else 0)
        self._longest = longest(spec)
        self._units: Mapping[str, str] = {
            column.name: column.spec.unit for column in signal_columns if column.spec.unit
        }
        self._multiplexed = any(signal.multiplexer for signal in spec.signals)
        self._last: MessageRows | None = None
        self._last_count: int | None = None
        self._last_right: int | None = None  # of a frame that its checksum does not tell to be damaged
        self._latest: float | None = None

    @property
    def signals(self) -> list[str]:
        """Names of the columns."""
        return [column.name for column in self._columns]

    def read(self, time: FloatArray, length: Bytes, data: Bytes, tick: float = 0.0) -> Series:
        """The signals of these frames: stamps (K,), data bytes (K,), data (K, n).

        Args:
            tick: how far apart two stamps of the log are at least [s].
        """
        name = self.spec.name
        self._statistics.messages[name] += len(time)
        rows = MessageRows(time, data)
        add(self._statistics.long, name, int(np.count_nonzero(length > self._longest)))
        short = length < self.spec.length
        if short.any():
            add(self._statistics.short, name, int(np.count_nonzero(short)))
            rows = rows[~short]
        if len(rows):
            rows = self._without_duplicates(rows)
        if not len(rows):
            return Series(np.empty(0), {column.name: np.empty(0) for column in self._columns}, self._units)
        last, self._last = self._last, MessageRows(rows.time[-1:], rows.data[-1:])
        rows = self._spread(rows, last, tick)
        right = self._check(rows)
        self._latest = float(rows.time[-1])
        rows = rows if right.all() else rows[right]
        self.count += len(rows)
        return Series(rows.time, self._values(rows), self._units)

    def marks(self, series: Series, end: float) -> list[Mark]:
        """What of the series of all frames so far, ascending, is not to be trusted, in a recording until `end` [s]."""
        marked = [_marked(column, series.values[column.name]) for column in self._columns]
        return list(marks(series.time, marked, self.spec.cycle, self.rejections, end))

    def _spread(self, rows: MessageRows, last: MessageRows | None, tick: float) -> MessageRows:
        time, crowded = spread(rows.time, None if last is None else float(last.time[0]), self._latest, tick)
        add(self._statistics.crowded, self.spec.name, crowded)
        return MessageRows(time, rows.data) if crowded else rows

    def _without_duplicates(self, rows: MessageRows) -> MessageRows:
        before = self._last
        same = np.empty(len(rows), dtype=bool)
        same[0] = before is not None and rows.time[0] == before.time[0]
        np.equal(rows.time[1:], rows.time[:-1], out=same[1:])
        if not same.any():
            return rows
        same[1:] &= (rows.little[1:] == rows.little[:-1]).all(axis=1)
        same[0] &= before is not None and _trimmed(rows.data[0]) == _trimmed(before.data[0])
        add(self._statistics.duplicates, self.spec.name, int(np.count_nonzero(same)))
        return rows[~same]

    def _check(self, rows: MessageRows) -> BoolArray:
        """(K,) whether the checksum is right, once what it, the counter and the cycle time say is wrong is counted."""
        protection, moved, absent = self.spec.protection, np.ones(len(rows), np.bool_), np.zeros(len(rows))
        right = self._right(rows)
        if protection and protection.counter:
            counter = rows.raw(field_of(self.spec.signal(protection.counter))).astype(np.int64)
            went, wrong = checks.steps(counter, protection.modulus, self._last_count)
            self._last_count = int(counter[-1])
            add(self._statistics.counters, self.spec.name, int(np.count_nonzero(wrong)))
            absent = np.where(wrong, went - 1.0, 0.0)
            if right.any():
                moved[right] = checks.steps(counter[right], protection.modulus, self._last_right)[0] != 0
                self._last_right = int(counter[right][-1])
        self._statistics.add_missing(self.spec.name, self._absences.feed(rows.time, absent))
        self.rejections.note(self.count, right, moved)
        return right

    def _right(self, rows: MessageRows) -> BoolArray:
        """(K,) whether the checksum is right; wrong ones are counted."""
        protection = self.spec.protection
        if not (protection and protection.checksum):
            return np.ones(len(rows), np.bool_)
        signal = self.spec.signal(protection.checksum)
        data = rows.data[:, : self.spec.length]
        due = checks.checksums(data, protection.algorithm, checksum_byte(signal), protection.data_id)
        right = np.asarray(rows.raw(field_of(signal)) == due, np.bool_)
        add(self._statistics.checksums, self.spec.name, int(np.count_nonzero(~right)))
        return right

    def _values(self, rows: MessageRows) -> dict[str, FloatArray]:
        if not self._multiplexed:
            return {column.name: self._inspected(column, rows.raw(column.place)) for column in self._columns}
        presence = Presence(self.spec, lambda signal: whole(field_of(signal), rows.raw(field_of(signal))))
        add(self._statistics.multiplexers, self.spec.name, presence.unknown)
        values = {}
        for column in self._columns:
            there, raw = presence.of(column.spec), rows.raw(column.place)
            if there is None:
                values[column.name] = self._inspected(column, raw)
            else:
                values[column.name] = np.full(len(rows), np.nan)
                values[column.name][there] = self._inspected(column, raw[there])
        return values

    def _inspected(self, channel: SignalColumn, raw: bits.Words) -> FloatArray:
        """The values, once those that no one should send are counted."""
        values = channel.place.values(raw)
        if channel.place.is_float:
            add(self._statistics.not_finite, channel.name, int(np.count_nonzero(~np.isfinite(values))))
        outside = 0
        if channel.low is not None:
            outside += int(np.count_nonzero(values < channel.low))
        if channel.high is not None:
            outside += int(np.count_nonzero(values > channel.high))
        add(self._statistics.out_of_range, channel.name, outside)
        return values


def _marked(column: SignalColumn, values: FloatArray) -> FrameColumn:
    low = -np.inf if column.low is None else column.low
    high = np.inf if column.high is None else column.high
    return FrameColumn(column.name, values, (values < low) | (values > high), bool(column.spec.multiplexer))


def _trimmed(data: Bytes) -> bytes:
    """Data without the zeros after it, of which batches have different numbers."""
    return data.tobytes().rstrip(b"\0")
