"""Frames of a live bus to signals, one by one, through cantools; what is wrong with them is counted."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import can
import cantools

from orchestrator.can.codec.fields import longest
from orchestrator.can.codec.message_reader import SignalColumn, columns
from orchestrator.can.database import protection as checks
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec, checksum_byte
from orchestrator.can.statistics import FrameStatistics, add


class SingleDecoder:
    """Decodes frames one by one.

    Attributes:
        statistics: what was found so far; of the stamps only that they are as far apart as the cycle time says.
        fault: why the latest frame is not to be trusted, "" where it is.
        not_finite: public names of its signals that are not finite.
    """

    def __init__(self, database: Database, signals: Sequence[str] | None = None) -> None:
        self.statistics = FrameStatistics()
        self.fault, self.not_finite = "", list[str]()
        names = None if signals is None else {database.public_name(*database.signal(signal)) for signal in signals}
        self._readers = {
            (message.id, message.extended): _MessageReader(
                message,
                [column for column in columns(database, message) if names is None or column.name in names],
                self.statistics,
            )
            for message in database.messages
        }

    def decode(self, message: can.Message) -> dict[str, float] | None:
        """Public name -> value of the finite signals in the frame; None for a frame that cannot be decoded."""
        self.statistics.frames += 1
        self.fault, self.not_finite = "", []
        if message.is_error_frame or message.is_remote_frame:
            self.statistics.errors += message.is_error_frame
            self.statistics.remotes += not message.is_error_frame
            return None
        reader = self._readers.get((message.arbitration_id, message.is_extended_id))
        if reader is None:
            self.statistics.add_unknown(message.arbitration_id, message.is_extended_id)
            return None
        values = reader.read(message)
        self.fault, self.not_finite = reader.fault, reader.not_finite
        return values


class _MessageReader:
    """One message's frames.

    Attributes:
        fault: what the latest one cannot be trusted for; not_finite: its signals that are not.
    """

    def __init__(self, spec: MessageSpec, wanted: Sequence[SignalColumn], statistics: FrameStatistics) -> None:
        self._spec, self._wanted, self._statistics, self._longest = spec, wanted, statistics, longest(spec)
        self.fault, self.not_finite = "", list[str]()
        self._last_time: float | None = None
        self._last_count: int | None = None
        self._last_right: int | None = None  # of a frame that its checksum does not tell to be damaged

    def read(self, message: can.Message) -> dict[str, float] | None:
        name, statistics, size = self._spec.name, self._statistics, len(message.data)
        statistics.messages[name] += 1
        self.fault, self.not_finite = "", []
        if size < self._spec.length:
            statistics.short[name] += 1
            self.fault = "too short"
            return None
        add(statistics.long, name, int(size > self._longest))
        try:
            decoded = self._spec.raw.decode_simple(bytes(message.data), decode_choices=False)
        except cantools.database.DecodeError:
            statistics.multiplexers[name] += 1
            self.fault = "unknown multiplexer value"
            return None
        self._check(message, decoded)
        return self._inspected(decoded)

    def _inspected(self, decoded: Mapping[str, float]) -> dict[str, float]:
        values = {}
        for column in self._wanted:
            value = decoded.get(column.spec.name)
            if value is None:
                continue
            if not math.isfinite(value):
                self._statistics.not_finite[column.name] += 1
                self.not_finite.append(column.name)
                continue
            outside = (column.low is not None and value < column.low) or (
                column.high is not None and value > column.high
            )
            add(self._statistics.out_of_range, column.name, int(outside))
            values[column.name] = float(value)
        return values

    def _check(self, message: can.Message, decoded: Mapping[str, float]) -> None:
        protection, name = self._spec.protection, self._spec.name
        if protection and protection.counter:
            self._check_counter(int(decoded[protection.counter]), protection.modulus)
        elif self._spec.cycle and self._last_time is not None:
            cycles = (message.timestamp - self._last_time) / self._spec.cycle
            add(self._statistics.missing, name, round(cycles) - 1 if cycles > 1.5 else 0)
        self._last_time = message.timestamp
        if protection and protection.checksum:
            byte = checksum_byte(self._spec.signal(protection.checksum))
            right = checks.checksum(message.data[: self._spec.length], protection.algorithm, byte, protection.data_id)
            wrong = decoded[protection.checksum] != right
            add(self._statistics.checksums, name, int(wrong))
            self.fault = "wrong checksum" if wrong else self.fault
        if protection and protection.counter and self.fault != "wrong checksum":
            count = int(decoded[protection.counter])
            self.fault = self.fault or ("the counter stands still" if count == self._last_right else "")
            self._last_right = count

    def _check_counter(self, count: int, modulus: int) -> None:
        if self._last_count is not None:
            step = (count - self._last_count) % modulus
            wrong = step != 1 or count >= modulus
            add(self._statistics.missing, self._spec.name, max(step - 1, 0) if wrong else 0)
            add(self._statistics.counters, self._spec.name, int(wrong))
        self.fault = f"its counter is {count}" if count >= modulus else self.fault
        self._last_count = count
