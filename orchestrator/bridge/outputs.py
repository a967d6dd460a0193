"""Outputs of components on their way to frames, one message at a time.

A value that does not fit its signal is limited, one that is NaN leaves the last good one; both are counted. Counter
and checksum of a message are filled in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import can

from orchestrator.can.codec.fields import longest, raw_limits, resting
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import checksum
from orchestrator.can.statistics import FrameStatistics
from orchestrator.crossing import Crossing


@dataclass(frozen=True)
class SentSignal:
    """How a signal takes an output.

    Attributes:
        output: component.output.
        place: its number among the outputs that are read.
        crossing: from the output's unit to the signal's.
        safe: value that is sent when the coupling ends [unit of the output].
    """

    spec: SignalSpec
    output: str
    place: int
    crossing: Crossing
    safe: float | None


class SentMessage:
    """A message that is sent.

    Attributes:
        every: communication steps from one frame to the next.
    """

    def __init__(
        self,
        spec: MessageSpec,
        signals: Sequence[SentSignal],
        every: int,
        statistics: FrameStatistics,
        switched: bool = False,
    ) -> None:
        self.spec, self.signals, self.every = spec, tuple(signals), every
        self._statistics, self._switched = statistics, switched
        self._raw = {signal.name: _raw(signal, raw_limits(signal), resting(signal)) for signal in spec.signals}
        self._limits = [(signal, raw_limits(signal.spec)) for signal in signals]
        self._seal, self._length = _seal(spec), longest(spec)

    @property
    def others(self) -> list[str]:
        """Signals that rest, since nothing is sent in them."""
        protection = self.spec.protection
        filled = {signal.spec.name for signal in self.signals}
        filled |= {protection.counter, protection.checksum} if protection else set()
        return [signal.name for signal in self.spec.signals if signal.name not in filled]

    def frame(self, outputs: Sequence[float]) -> can.Message:
        """The next frame, with these values of the outputs that are read."""
        for signal, limits in self._limits:
            self._fill(signal.spec, limits, signal.crossing.conversion(outputs[signal.place]))
        return self._sealed()

    def safe_frame(self) -> can.Message | None:
        """The frame with the safe values, and what was sent last in signals without one; None without any."""
        if all(signal.safe is None for signal in self.signals):
            return None
        for signal, limits in self._limits:
            if signal.safe is not None:
                self._fill(signal.spec, limits, signal.crossing.conversion(signal.safe))
        return self._sealed()

    def _fill(self, signal: SignalSpec, limits: tuple[float, float], value: float) -> None:
        raw, (low, high) = (value - signal.offset) / signal.scale, limits
        if math.isnan(raw):
            self._statistics.not_finite[signal.name] += 1
            return
        self._raw[signal.name] = _raw(signal, limits, value)
        slack = 0.0 if signal.is_float else 0.5  # less is lost by rounding anyway
        if not low - slack <= raw <= high + slack:
            self._statistics.saturated[signal.name] += 1

    def _sealed(self) -> can.Message:
        spec, protection = self.spec, self.spec.protection
        if protection is not None and protection.counter:
            self._raw[protection.counter] = (int(self._raw[protection.counter]) + 1) % protection.modulus
        data = spec.raw.encode(self._raw, scaling=False, strict=False)
        data = data if self._seal is None else self._seal(data)
        self._statistics.messages[spec.name] += 1
        return can.Message(
            arbitration_id=spec.id,
            is_extended_id=spec.extended,
            is_fd=spec.fd,
            bitrate_switch=spec.fd and self._switched,
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
