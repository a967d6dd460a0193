"""Signals to the frames of one message, one by one, through cantools: each signal stays as it is until it is set."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import can
from cantools.database.errors import EncodeError

from orchestrator.can.codec.fields import longest, raw_limits, resting, unfit
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import checksum
from orchestrator.can.statistics import FrameStatistics


class SingleEncoder:
    """Encodes one message; counter and checksum are filled in.

    Of a multiplexed message a frame holds the page that its multiplexer asks for.

    Args:
        switched: whether CAN FD frames switch to the data bit rate.
    """

    def __init__(self, spec: MessageSpec, statistics: FrameStatistics, switched: bool = False) -> None:
        self.spec, self._statistics, self._switched = spec, statistics, switched
        self._limits = {signal.name: raw_limits(signal) for signal in spec.signals}
        self._raw = {signal.name: self._nearest(signal, resting(signal)) for signal in spec.signals}
        protection = spec.protection
        filled = (protection.counter, protection.checksum) if protection else ()
        self._unfit = {signal.name for signal in spec.signals if signal.name not in filled and unfit(signal)}
        self._seal, self._length = _seal(spec), longest(spec)

    def set(self, signal: SignalSpec, value: float) -> None:
        """Set a signal to a value that is not NaN; one that does not fit is limited, which is counted."""
        raw, (low, high) = (value - signal.offset) / signal.scale, self._limits[signal.name]
        self._raw[signal.name] = self._nearest(signal, value)
        self._unfit.discard(signal.name)
        slack = 0.0 if signal.is_float else 0.5  # less is lost by rounding anyway
        if not low - slack <= raw <= high + slack:
            self._statistics.saturated[signal.name] += 1

    def raw(self, name: str) -> int:
        """The raw number of a whole signal."""
        return int(self._raw[name])

    def turn_to(self, page: Mapping[str, int]) -> None:
        """Set multiplexers."""
        self._raw |= page
        self._unfit -= page.keys()

    def resume(self, data: bytes) -> None:
        """Set all signals as they are in a frame of somebody else, so that the next one follows it."""
        self._raw |= self.spec.raw.decode_simple(data, decode_choices=False, scaling=False)
        self._unfit.clear()

    def leave_out(self, count: int) -> None:
        """Count frames that are due and not sent, so that whoever receives the next one sees that they are missing."""
        protection = self.spec.protection
        if protection is not None and protection.counter:
            self._raw[protection.counter] = (self.raw(protection.counter) + count) % protection.modulus

    def frame(self) -> can.Message | None:
        """The next frame; None (which is counted) where the multiplexer asks for a page that there is not."""
        spec, protection = self.spec, self.spec.protection
        raw = dict(self._raw)
        if protection is not None and protection.counter:
            raw[protection.counter] = (int(raw[protection.counter]) + 1) % protection.modulus
        try:
            data = spec.raw.encode(raw, scaling=False, strict=False)
        except EncodeError:
            self._statistics.multiplexers[spec.name] += 1
            return None
        self._raw = raw
        data = data if self._seal is None else self._seal(data)
        self._statistics.messages[spec.name] += 1
        self._statistics.unfit.update(f"{spec.name}.{name}" for name in self._unfit)
        return can.Message(
            arbitration_id=spec.id,
            is_extended_id=spec.extended,
            is_fd=spec.fd,
            bitrate_switch=spec.fd and self._switched,
            is_rx=False,
            data=data.ljust(self._length, b"\0"),
        )

    def _nearest(self, signal: SignalSpec, value: float) -> float:
        """The raw number nearest to a value."""
        low, high = self._limits[signal.name]
        raw = min(max((value - signal.offset) / signal.scale, low), high)
        return raw if signal.is_float else round(raw)


def _seal(message: MessageSpec) -> Callable[[bytes], bytes] | None:
    """What puts the checksum into a frame; None where the message has none."""
    protection = message.protection
    if protection is None or not protection.checksum:
        return None
    place = checksum_byte(message.signal(protection.checksum))
    assert place is not None

    def sealed(data: bytes) -> bytes:
        value = checksum(data, protection.algorithm, place, protection.data_id)
        return data[:place] + bytes([value]) + data[place + 1 :]

    return sealed
