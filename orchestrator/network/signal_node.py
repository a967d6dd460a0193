"""A node that exchanges signals, which a database puts into frames."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.ls_bus.messages import message_of, operation_of
from orchestrator.can.ls_bus.operations import Transmit, TransmitFd, decoded, encoded
from orchestrator.can.statistics import FrameStatistics
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.interface import Value
from orchestrator.network.high_cut import CarriedFrame, HighCut, by_identifier


class HighCutNode:
    """One that exchanges signals, which this puts into frames and takes out of them."""

    notified = False

    def __init__(self, name: str, slave: ClockedSlave, terminal: HighCut) -> None:
        self.name, self._slave, self._database = name, slave, terminal.database
        self._sent = [frame for frame in terminal.frames if frame.sent]
        self._received = by_identifier(terminal.frames)
        self.reset()

    def reset(self) -> None:
        self._statistics, self._decoder = FrameStatistics(), SingleDecoder(self._database)
        self._encoders = {
            frame.clock: (frame, SingleEncoder(frame.message, self._statistics, switched=True)) for frame in self._sent
        }
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
                if frame is not None and values is not None and not self._decoder.fault:
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


def _finite(value: Value) -> bool:
    return math.isfinite(float(value))
