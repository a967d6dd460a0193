"""Outputs of components on their way to frames, one message at a time.

A value that does not fit its signal is limited, one that is NaN leaves the last good one; both are counted. Counter
and checksum of a message are filled in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can

from orchestrator.can.census import Census
from orchestrator.can.codec.fields import longest, raw_limits, resting
from orchestrator.can.database.database import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import checksum


@dataclass(frozen=True)
class Discharge:
    """How a signal takes an output.

    Attributes:
        output: component.output.
        place: its number among the outputs that are read.
        factor: from the output's unit to the signal's.
        safe: value that is sent when the coupling ends [unit of the output].
    """

    signal: SignalSpec
    output: str
    place: int
    factor: float
    safe: float | None


class Outlet:
    """A message that is sent.

    Attributes:
        every: communication steps from one frame to the next.
    """

    def __init__(
        self, message: MessageSpec, discharges: Sequence[Discharge], every: int, census: Census, switched: bool = False
    ) -> None:
        self.message, self.discharges, self.every = message, tuple(discharges), every
        self._census, self._switched = census, switched
        self._raw = {each.name: _raw(each, raw_limits(each), resting(each)) for each in message.signals}
        self._raw |= dict.fromkeys(message.left_out, 0)
        self._limits = [(each, raw_limits(each.signal)) for each in discharges]
        self._seal, self._length = _seal(message), longest(message)

    @property
    def others(self) -> list[str]:
        """Signals that rest, since nothing is sent in them."""
        protection = self.message.protection
        filled = {each.signal.name for each in self.discharges}
        filled |= {protection.counter, protection.checksum} if protection else set()
        return [each.name for each in self.message.signals if each.name not in filled]

    def frame(self, outputs: Sequence[float]) -> can.Message:
        """The next frame, with these values of the outputs that are read."""
        for each, limits in self._limits:
            self._fill(each.signal, limits, outputs[each.place] * each.factor)
        return self._sealed()

    def last_frame(self) -> can.Message | None:
        """The frame with the safe values, and what was sent last in signals without one; None without any."""
        if all(each.safe is None for each in self.discharges):
            return None
        for each, limits in self._limits:
            if each.safe is not None:
                self._fill(each.signal, limits, each.safe * each.factor)
        return self._sealed()

    def _fill(self, signal: SignalSpec, limits: tuple[float, float], value: float) -> None:
        raw, (low, high) = (value - signal.offset) / signal.scale, limits
        if math.isnan(raw):
            self._census.not_finite[signal.name] += 1
            return
        self._raw[signal.name] = _raw(signal, limits, value)
        slack = 0.0 if signal.is_float else 0.5  # less is lost by rounding anyway
        if not low - slack <= raw <= high + slack:
            self._census.saturated[signal.name] += 1

    def _sealed(self) -> can.Message:
        protection = self.message.protection
        if protection is not None and protection.counter:
            self._raw[protection.counter] = (int(self._raw[protection.counter]) + 1) % protection.modulus
        data = self.message.raw.encode(self._raw, scaling=False, strict=False)
        data = data if self._seal is None else self._seal(data)
        self._census.messages[self.message.name] += 1
        return can.Message(
            arbitration_id=self.message.id,
            is_extended_id=self.message.extended,
            is_fd=self.message.fd,
            bitrate_switch=self.message.fd and self._switched,
            is_rx=False,
            data=data.ljust(self._length, b"\0"),
        )


def _raw(signal: SignalSpec, limits: tuple[float, float], value: float) -> float:
    """The raw number nearest to a value that is not NaN."""
    raw = min(max((value - signal.offset) / signal.scale, limits[0]), limits[1])
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
