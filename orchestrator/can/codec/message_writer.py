"""Signals to the frames of one message, many at once, with its counter and its checksum."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from orchestrator.can.codec import bits
from orchestrator.can.codec.fields import check_sendable, field_of, longest, raw_limits, resting, unfit
from orchestrator.can.codec.multiplexing import Presence, pages, whole
from orchestrator.can.database import protection as checks
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.frames import CLASSIC, LONGEST, Flag, Frames
from orchestrator.can.statistics import FrameStatistics, add
from orchestrator.trace import Bytes, FloatArray


class MessageWriter:
    """Encodes one message, batch after batch.

    Signals that are not sent rest at their initial value, or at the one nearest to zero. A multiplexer that is not
    sent itself takes in turn the values that bring every sent signal into some frame.

    Args:
        sent: signals that are sent: name in the message -> name of their column.

    Raises:
        DatabaseError: the message cannot be sent.
    """

    def __init__(self, spec: MessageSpec, sent: Mapping[str, str], statistics: FrameStatistics) -> None:
        self.spec, self._sent, self._statistics = spec, dict(sent), statistics
        check_sendable(spec)
        self._width = CLASSIC if longest(spec) <= CLASSIC else LONGEST
        self._pages = pages(spec, self._sent)
        self._count = 0  # frames so far

    def write(self, time: FloatArray, columns: Mapping[str, FloatArray]) -> Frames:
        """A frame at each stamp (K,), with the values of the columns (K,)."""
        count, spec = len(time), self.spec
        words = {big: np.zeros((count, self._width // 8), dtype=np.uint64) for big in (False, True)}
        raws: dict[str, bits.Words] = {}
        presence = Presence(spec, lambda signal: whole(field_of(signal), self._raw(signal, columns, count, raws)))
        for signal in spec.signals:
            there, raw = presence.of(signal), self._raw(signal, columns, count, raws)
            field_of(signal).put(words[signal.big_endian], raw if there is None else np.where(there, raw, 0))
        data = words[False].astype(bits.LITTLE).view(np.uint8) | words[True].astype(bits.BIG).view(np.uint8)
        self._seal(data)
        self._count += count
        self._statistics.frames += count
        self._statistics.messages[spec.name] += count
        flags = Flag.EXTENDED * spec.extended | Flag.FD * spec.fd
        identifier, length = np.full(count, spec.id, np.uint32), np.full(count, longest(spec), np.uint8)
        return Frames(time, identifier, np.full(count, flags, np.uint8), np.zeros(count, np.uint8), length, data)

    def _raw(
        self, signal: SignalSpec, columns: Mapping[str, FloatArray], count: int, raws: dict[str, bits.Words]
    ) -> bits.Words:
        """(count,) the signal's bits, found once."""
        if signal.name not in raws:
            raws[signal.name] = self._found(signal, columns, count)
        return raws[signal.name]

    def _found(self, signal: SignalSpec, columns: Mapping[str, FloatArray], count: int) -> bits.Words:
        protection = self.spec.protection
        number = np.arange(self._count, self._count + count)
        if protection and signal.name == protection.counter:
            return (number % protection.modulus).astype(np.uint64)
        if protection and signal.name == protection.checksum:
            return np.zeros(count, dtype=np.uint64)
        if signal.name in self._sent:
            raw, limited = field_of(signal).encoded(columns[self._sent[signal.name]], *raw_limits(signal))
            add(self._statistics.saturated, self._sent[signal.name], int(np.count_nonzero(limited)))
            return raw
        rest = resting(signal)
        add(self._statistics.unfit, f"{self.spec.name}.{signal.name}", count if unfit(signal) else 0)
        values = np.array([page.get(signal.name, rest) for page in self._pages], dtype=np.float64)
        return field_of(signal).encoded(values, *raw_limits(signal))[0][number % len(self._pages)]

    def _seal(self, data: Bytes) -> None:
        """Fill in the checksums."""
        protection = self.spec.protection
        if protection and protection.checksum:
            byte = checksum_byte(self.spec.signal(protection.checksum))
            assert byte is not None
            held = data[:, : self.spec.length]
            data[:, byte] = checks.checksums(held, protection.algorithm, byte, protection.data_id)
