"""Outputs of components on their way to frames, one message at a time.

A value that does not fit its signal is limited. One that is not finite puts its signal to the safe value, or, where
there is none, keeps its message from being sent. All are counted. Counter and checksum of a message are filled in.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass

import can

from orchestrator.can.codec.fields import longest, raw_limits, resting
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import checksum
from orchestrator.can.statistics import FrameStatistics, add
from orchestrator.crossing import Crossing


@dataclass(frozen=True, eq=False)
class SentSignal:
    """How a signal takes an output.

    Attributes:
        output: component.output.
        place: its number among the outputs that are read.
        crossing: from the output's unit to the signal's.
        safe: value that is sent while it rests [unit of the output].
        needs: inputs without which it rests.
        magnitude: largest amount; change: largest one from frame to frame, but to the safe value [unit of the output].
    """

    spec: SignalSpec
    output: str
    place: int
    crossing: Crossing
    safe: float | None
    needs: frozenset[str] = frozenset()
    magnitude: float = math.inf
    change: float = math.inf


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
        self._last: dict[SentSignal, float] = {}
        self._seal, self._length = _seal(spec), longest(spec)

    @property
    def others(self) -> list[str]:
        """Signals that rest, since nothing is sent in them."""
        protection = self.spec.protection
        filled = {signal.spec.name for signal in self.signals}
        filled |= {protection.counter, protection.checksum} if protection else set()
        return [signal.name for signal in self.spec.signals if signal.name not in filled]

    @property
    def guarded(self) -> list[SentSignal]:
        """Signals with a safe value."""
        return [signal for signal in self.signals if signal.safe is not None]

    def frame(self, outputs: Sequence[float], resting: Collection[SentSignal] = ()) -> can.Message | None:
        """The next frame, with these values of the outputs that are read; None where it cannot have all of them.

        Args:
            resting: signals that have their safe values.
        """
        whole = True
        for signal, limits in self._limits:
            value = outputs[signal.place]
            finite = math.isfinite(value)
            self._statistics.not_finite.update([] if finite else [signal.spec.name])
            if signal.safe is not None and (signal in resting or not finite):
                self._fill(signal, limits, signal.safe)
            elif finite:
                self._fill(signal, limits, self._limited(signal, value))
            else:
                whole = False
        return self._sealed() if whole else None

    def safe_frame(self) -> can.Message | None:
        """The frame with the safe values, and what was sent last in signals without one; None without any."""
        if not self.guarded:
            return None
        for signal, limits in self._limits:
            if signal.safe is not None:
                self._fill(signal, limits, signal.safe)
        return self._sealed()

    def _limited(self, signal: SentSignal, value: float) -> float:
        """The value within what was asked for of it."""
        limited = min(max(value, -signal.magnitude), signal.magnitude)
        last = self._last.get(signal)
        if last is not None:
            limited = min(max(limited, last - signal.change), last + signal.change)
        add(self._statistics.limited, signal.spec.name, int(limited != value))
        return limited

    def _fill(self, sent: SentSignal, limits: tuple[float, float], value: float) -> None:
        self._last[sent] = value
        signal, converted, (low, high) = sent.spec, sent.crossing.conversion(value), limits
        raw = (converted - signal.offset) / signal.scale
        self._raw[signal.name] = _raw(signal, limits, converted)
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
