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
from orchestrator.can.checks import checksum
from orchestrator.can.database import MessageSpec, SignalSpec, checksum_byte

_LARGEST = {16: 65504.0, 32: 3.4028234663852886e38, 64: 1.7976931348623157e308}  # of floats, by their bits


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

    def __init__(self, message: MessageSpec, discharges: Sequence[Discharge], every: int, census: Census,
                 switched: bool = False) -> None:  # fmt: skip
        self.message, self.discharges, self.every = message, tuple(discharges), every
        self._census, self._switched = census, switched
        self._raw = {each.name: _resting(each) for each in message.signals} | dict.fromkeys(message.left_out, 0)
        self._scales = [(each, _limits(each.signal)) for each in discharges]
        self._seal = _seal(message)

    @property
    def others(self) -> list[str]:
        """Signals that rest, since nothing is sent in them."""
        protection = self.message.protection
        filled = {each.signal.name for each in self.discharges}
        filled |= {protection.counter, protection.checksum} if protection else set()
        return [each.name for each in self.message.signals if each.name not in filled]

    def frame(self, outputs: Sequence[float]) -> can.Message:
        """The next frame, with these values of the outputs that are read."""
        for each, limits in self._scales:
            self._fill(each.signal, limits, outputs[each.place] * each.factor)
        return self._sealed()

    def last_frame(self) -> can.Message | None:
        """The frame with the safe values, and what was sent last in signals without one; None without any."""
        if all(each.safe is None for each in self.discharges):
            return None
        for each, limits in self._scales:
            if each.safe is not None:
                self._fill(each.signal, limits, each.safe * each.factor)
        return self._sealed()

    def _fill(self, signal: SignalSpec, limits: tuple[float, float], value: float) -> None:
        raw, (low, high) = (value - signal.offset) / signal.scale, limits
        if low <= raw <= high:
            self._raw[signal.name] = raw if signal.is_float else round(raw)
        elif math.isnan(raw):
            self._census.not_finite[signal.name] += 1
        else:
            self._raw[signal.name] = low if raw < low else high
            if max(low - raw, raw - high) > 0.5 or signal.is_float:  # less is lost by rounding anyway
                self._census.saturated[signal.name] += 1

    def _sealed(self) -> can.Message:
        protection = self.message.protection
        if protection is not None and protection.counter:
            self._raw[protection.counter] = (int(self._raw[protection.counter]) + 1) % protection.modulus
        data = self.message.raw.encode(self._raw, scaling=False, strict=False)
        self._census.messages[self.message.name] += 1
        return can.Message(
            arbitration_id=self.message.id, is_extended_id=self.message.extended, is_fd=self.message.fd,
            bitrate_switch=self.message.fd and self._switched, is_rx=False,
            data=data if self._seal is None else self._seal(data),
        )  # fmt: skip


def _resting(signal: SignalSpec) -> float:
    """The raw value that a signal has before it is given one: its initial value, else that nearest to zero."""
    low, high = _limits(signal)
    raw = ((signal.initial or 0.0) - signal.offset) / signal.scale
    raw = min(max(raw, low), high)
    return raw if signal.is_float else round(raw)


def _limits(signal: SignalSpec) -> tuple[float, float]:
    """Lowest and highest raw value: what the bits hold, within the signal's range where one is declared."""
    if signal.is_float:
        low, high = -_LARGEST[signal.length], _LARGEST[signal.length]
    else:
        low = -(1 << signal.length - 1) if signal.is_signed else 0
        high = low + (1 << signal.length) - 1
    least, most = low, high
    ends = [None if end is None else (end - signal.offset) / signal.scale for end in (signal.minimum, signal.maximum)]
    if None not in ends and ends[0] == ends[1]:
        return low, high
    first, last = ends if signal.scale > 0 else reversed(ends)
    if first is not None:
        low = max(low, first if signal.is_float else math.ceil(first - 1e-6))
    if last is not None:
        high = min(high, last if signal.is_float else math.floor(last + 1e-6))
    return (low, high) if low <= high else (least, most)


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
