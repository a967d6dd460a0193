"""Instances of FMUs as nodes of a bus: what they send as operations, and operations as what they receive."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import Protocol

import can

from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.ls_bus.operations import Transmit, TransmitFd, decoded, encoded
from orchestrator.can.statistics import FrameStatistics
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.interface import Value
from orchestrator.network.high_cut import CarriedFrame, HighCut, by_identifier
from orchestrator.network.low_cut import LowCut


class BusNode(Protocol):
    """Who is on a bus."""

    name: str

    @property
    def notified(self) -> bool:
        """Whether it is told what becomes of its frames."""

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        """Times [s] and operations of what it has sent since the last call, for the step that begins at a time."""

    def deliver(self, operations: Sequence[bytes]) -> None:
        """Have it receive operations when its next step begins."""

    def remarks(self) -> list[str]:
        """What it could not send or receive as it is, a line each."""


class LowCutNode:
    """One that exchanges operations itself."""

    def __init__(self, name: str, slave: ClockedSlave, terminal: LowCut) -> None:
        self.name, self._slave, self._terminal = name, slave, terminal

    @property
    def notified(self) -> bool:
        return bool(self._terminal.notifications and self._slave.begins_with(self._terminal.notifications))

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        posts = self._slave.fetched((self._terminal.tx_clock,))
        return [(post.time, bytes.fromhex(str(post.values[0]))) for post in posts if post.values[0]]

    def deliver(self, operations: Sequence[bytes]) -> None:
        for whole in _packed(operations, self._terminal.most):
            self._slave.deliver(self._terminal.rx_clock, [whole.hex()])

    def remarks(self) -> list[str]:
        return []


class HighCutNode:
    """One that exchanges signals, which this puts into frames and takes out of them."""

    notified = False

    def __init__(self, name: str, slave: ClockedSlave, terminal: HighCut) -> None:
        self.name, self._slave = name, slave
        sent = [frame for frame in terminal.frames if frame.sent]
        self._received, self._statistics = by_identifier(terminal.frames), FrameStatistics()
        self._encoders = {
            frame.clock: (frame, SingleEncoder(frame.message, self._statistics, switched=True)) for frame in sent
        }
        self._decoder, self._database = SingleDecoder(terminal.database), terminal.database
        self._latest: dict[str, Value] = {}  # of multiplexed signals, which are not in every frame

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        for post in self._slave.fetched(self._encoders):
            frame, encoder = self._encoders[post.clock]
            odd = [one.signal.name for one, value in zip(frame.signals, post.values, strict=True) if not _finite(value)]
            self._statistics.not_finite.update(odd)
            for signal, value in zip(frame.signals, post.values, strict=True) if not odd else ():
                encoder.set(signal.signal, float(signal.crossing.conversion(float(value))))
            message = encoder.frame() if not odd else None
            if message is not None:
                yield post.time, encoded([operation_of(message)])

    def deliver(self, operations: Sequence[bytes]) -> None:
        for operation in (one for data in operations for one in decoded(data)):
            if isinstance(operation, Transmit | TransmitFd):
                frame = self._received.get((operation.id, operation.extended))
                values = self._decoder.decode(message_of(operation)) if frame is not None else None
                if frame is not None and values is not None:
                    self._slave.deliver(frame.clock, self._values(frame, values))

    def remarks(self) -> list[str]:
        return [f"{self.name}: {line}" for line in [*self._statistics.lines(), *self._decoder.statistics.lines()]]

    def _values(self, frame: CarriedFrame, values: dict[str, float]) -> list[Value]:
        for signal in frame.signals:
            public = self._database.public_name(frame.message, signal.signal)
            if public in values:
                self._latest[signal.variable] = float(signal.crossing.conversion(values[public]))
            elif signal.variable not in self._latest:
                self._latest[signal.variable] = self._slave.get(signal.variable)
        return [self._latest[variable] for variable in frame.variables]


def operation_of(message: can.Message) -> Transmit | TransmitFd:
    """A frame of python-can as an operation."""
    who = message.arbitration_id, message.is_extended_id
    if message.is_fd:
        return TransmitFd(*who, message.bitrate_switch, message.error_state_indicator, bytes(message.data))
    return Transmit(*who, message.is_remote_frame, message.dlc, bytes(message.data))


def message_of(frame: Transmit | TransmitFd, time: float = 0.0) -> can.Message:
    """An operation as a frame of python-can, which was sent at a time [s]."""
    if isinstance(frame, TransmitFd):
        return can.Message(
            timestamp=time,
            arbitration_id=frame.id,
            is_extended_id=frame.extended,
            is_fd=True,
            bitrate_switch=frame.switched,
            error_state_indicator=frame.error_state,
            data=frame.data,
        )
    return can.Message(
        timestamp=time,
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        dlc=frame.length,
        data=frame.data,
    )


def _finite(value: Value) -> bool:
    return math.isfinite(float(value))


def _packed(operations: Sequence[bytes], most: int | None) -> Iterable[bytes]:
    """The operations side by side, as many as the FMU takes at once."""
    found: list[bytes] = []
    size = 0
    for one in operations:
        if found and most is not None and size + len(one) > most:
            yield b"".join(found)
            found, size = [], 0
        found.append(one)
        size += len(one)
    if found:
        yield b"".join(found)
