"""A CAN bus without noise between nodes that exchange operations of FMI-LS-BUS: who sends when, and who hears of it.

Of the frames that wait when the bus is free, or come within a bit of that, the one with the lowest arbitration field
goes first. It takes its bits, at the nominal and at the data bit rate; the others have it when its last bit but those
of the gap is through, and then the sender has its confirmation.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from heapq import heapify, heappop, heappush

import numpy as np

from fmus.errors import BusError
from orchestrator.can import frame_time
from orchestrator.can.frames import CLASSIC, LONGEST, Flag, Frames
from orchestrator.can.ls_bus import stuffing
from orchestrator.can.ls_bus.operations import (
    ArbitrationLost,
    BusSetting,
    Configuration,
    Confirm,
    FormatError,
    Malformed,
    NodeState,
    Operation,
    Status,
    Transmit,
    TransmitFd,
    Wakeup,
    WhenLost,
    decoded,
    encoded,
    taken_apart,
)

_GAP = 3  # bits between two frames
_RATES = {BusSetting.BITRATE: "bitrate", BusSetting.DATA_BITRATE: "data_bitrate"}
Frame = Transmit | TransmitFd
Request = tuple[float, int, int, Frame, bytes]  # time [s], running number, node, frame, as the operation that it is


@dataclass
class IdealBusNode:
    """Who is on the bus.

    Attributes:
        notified: whether it is told what becomes of its frames.
        inbox: operations that it has still to be given, in order.
        discards: whether its frames are given back when they lose arbitration.
        off: since when it has been off the bus [s].
    """

    name: str
    notified: bool = False
    inbox: list[bytes] = field(default_factory=list)
    discards: bool = False
    state: NodeState = NodeState.ERROR_ACTIVE
    off: float = math.inf


class IdealBus:
    """The bus; times in seconds.

    Args:
        name: what messages call it.
        bitrate, data_bitrate: None: what the nodes configure [bit/s].

    Attributes:
        nodes: known to `take` by their numbers.
        counts: what is out of the ordinary, in words -> how often.
        carried: number of frames that got through.

    Raises (on taking and running):
        BusError: nodes want other bit rates than the bus has, or nobody says which it has.
    """

    def __init__(self, name: str, nodes: Sequence[str], bitrate: int | None, data_bitrate: int | None) -> None:
        self.name, self._names, self._given = name, nodes, {"bitrate": bitrate, "data_bitrate": data_bitrate}
        self.reset()

    def reset(self) -> None:
        """Nothing is on the bus, and all nodes are as they begin."""
        self.nodes = [IdealBusNode(name) for name in self._names]
        self.counts, self.carried = Counter[str](), 0
        self._rates = {what: (rate, "the bus") for what, rate in self._given.items() if rate}
        self._arrivals: list[Request] = []
        self._ready: list[tuple[bool, int, Request]] = []
        self._number, self._giving_back = 0, False
        self._under_way: Request | None = None
        self._origin = self._received = self._free = -math.inf  # of frames without a pause between, and of the latest
        self._bits = 0, 0  # since then, at the nominal and at the data bit rate
        self._busy = 0.0
        self._record: tuple[list[float], list[bytes]] = [], []  # stamps and operations

    def take(self, number: int, time: float, data: bytes) -> None:
        """Take what a node gave at a time."""
        for operation, own in taken_apart(data):
            if isinstance(operation, Transmit | TransmitFd):
                self._request(number, time, operation, own)
            else:
                self._obey(number, time, operation)

    def run(self, until: float) -> None:
        """Go on to a time, up to which all that nodes have given has been taken."""
        arrivals, ready = self._arrivals, self._ready
        speed: tuple[int, int] | None = None
        while True:
            if self._under_way is not None:
                if self._received > until:
                    return
                self._arrive(self._under_way)
            if not arrivals and not ready:
                return
            rate, data_rate = speed = speed or self._speed()
            begin = self._free if ready else max(self._free, arrivals[0][0])
            bit_over = begin + 1.0 / rate
            if bit_over > until:
                return
            while arrivals and arrivals[0][0] < bit_over:
                self._line_up(heappop(arrivals))
            request = heappop(ready)[-1]
            if self._is_off(request[2], begin):
                continue
            self._begin(begin, request, rate, data_rate)
            self._give_back(begin)

    def busy(self, until: float) -> float:
        """For how long frames have been on the bus up to a time that it has run to."""
        return self._busy - max(0.0, self._free - until)

    @property
    def waiting(self) -> int:
        """How many frames have not begun."""
        return len(self._arrivals) + len(self._ready)

    def frames(self) -> Frames:
        """What got through; each frame is stamped when it had been received, its channel is 0."""
        stamps, operations = self._record
        sent = [frame for frame in decoded(b"".join(operations)) if isinstance(frame, Transmit | TransmitFd)]
        width = LONGEST if any(len(frame.data) > CLASSIC for frame in sent) else CLASSIC
        data = b"".join(frame.data.ljust(width, b"\0") for frame in sent)
        return Frames(
            np.array(stamps, dtype=np.float64),
            np.array([frame.id for frame in sent], dtype=np.uint32),
            np.array([_flags(frame) for frame in sent], dtype=np.uint8),
            np.zeros(len(sent), dtype=np.uint8),
            np.array([_size(frame) for frame in sent], dtype=np.uint8),
            np.frombuffer(data, dtype=np.uint8).reshape(len(sent), width).copy(),
        )

    def _speed(self) -> tuple[int, int]:
        """The nominal and the data bit rate."""
        if "bitrate" not in self._rates:
            raise BusError(
                self.name,
                "has no bit rate, and no node has configured one before the first frame",
                "give it a `bitrate`",
            )
        return self._rates["bitrate"][0], self._rates.get("data_bitrate", self._rates["bitrate"])[0]

    def _request(self, number: int, time: float, frame: Frame, operation: bytes) -> None:
        if self._is_off(number, time):
            return
        self._number += 1
        heappush(self._arrivals, (time, self._number, number, frame, operation))

    def _is_off(self, number: int, time: float) -> bool:
        """Whether a node that has a frame to send is off the bus at a time, which is counted."""
        node = self.nodes[number]
        if time < node.off:
            return False
        self.counts[f"frames of {node.name}, which is off the bus"] += 1
        return True

    def _line_up(self, request: Request) -> None:
        """Have a frame take part in arbitration; who is error passive comes after the others."""
        _, _, number, frame, _ = request
        passive = self.nodes[number].state is NodeState.ERROR_PASSIVE
        remote = isinstance(frame, Transmit) and frame.remote
        field = frame_time.priority(frame.id, frame.extended, remote)
        heappush(self._ready, (passive, field, request))  # of one identifier, who came first

    def _begin(self, begin: float, request: Request, rate: int, data_rate: int) -> None:
        """Have a frame on the wire from a time on, not before the bus is free."""
        nominal, data = _bits(request[3])
        if data and "data_bitrate" not in self._rates:
            name = self.nodes[request[2]].name
            self.counts[f"frames of {name} that switch to a data bit rate, which nobody gives: sent at the other"] += 1
        if begin > self._free:
            self._origin, self._bits = begin, (0, 0)
        nominal, data = self._bits[0] + nominal, self._bits[1] + data
        self._bits = nominal, data
        self._received = self._origin + (nominal - _GAP) / rate + data / data_rate
        self._free = self._origin + nominal / rate + data / data_rate
        self._busy += self._free - begin
        self._under_way = request

    def _arrive(self, request: Request) -> None:
        """Have a frame received, and confirmed where somebody has received it."""
        self._under_way = None
        _, _, number, frame, operation = request
        sender, heard = self.nodes[number], False
        for node in self.nodes:
            if node is not sender and self._received < node.off:
                node.inbox.append(operation)
                heard = True
        self.carried += 1
        self._record[0].append(self._received)
        self._record[1].append(operation)
        if not heard:
            self.counts[f"frames of {sender.name} that nobody acknowledged"] += 1
        elif sender.notified:
            sender.inbox.append(encoded([Confirm(frame.id)]))

    def _give_back(self, begin: float) -> None:
        """Give those frames back that have lost and are not to wait."""
        if not (self._giving_back and self._ready):
            return
        lost = [entry for entry in self._ready if self.nodes[entry[-1][2]].discards]
        self._ready[:] = [entry for entry in self._ready if entry not in lost]
        heapify(self._ready)
        for _, _, (_, _, number, frame, _) in sorted(lost):
            node = self.nodes[number]
            self.counts[f"frames of {node.name} that lost arbitration and were given back"] += 1
            if node.notified:
                node.inbox.append(encoded([ArbitrationLost(frame.id)]))

    def _obey(self, number: int, time: float, operation: Operation | Malformed) -> None:
        """Do what a node wants that is no frame; what it cannot want is counted."""
        node = self.nodes[number]
        if isinstance(operation, Configuration):
            self._configure(node, operation)
        elif isinstance(operation, Status):
            node.state = operation.state
            node.off = time if operation.state is NodeState.BUS_OFF else math.inf
        elif isinstance(operation, Wakeup):
            for other in self.nodes:
                other.inbox += [] if other is node else [encoded([operation])]
        elif isinstance(operation, Malformed):
            self.counts[f"operations of {node.name} that are malformed: one {operation.why}"] += 1
            node.inbox.append(encoded([FormatError(operation.data[:0xFFFF])]))
        else:
            self.counts[f"operations of {node.name} that the bus does not carry: {type(operation).__name__}"] += 1

    def _configure(self, node: IdealBusNode, wanted: Configuration) -> None:
        if wanted.setting is BusSetting.ARBITRATION_LOST:
            node.discards = wanted.value == WhenLost.DISCARD_AND_NOTIFY
            self._giving_back = any(one.discards for one in self.nodes)
        elif (what := _RATES.get(wanted.setting)) is None:
            self.counts[f"configurations of {node.name} that the bus does not need: {wanted.setting.name}"] += 1
        elif wanted.value == 0 or self._rates.setdefault(what, (wanted.value, node.name))[0] != wanted.value:
            known, by = self._rates.get(what, (0, node.name))
            problem = f"is configured to {wanted.value} bit/s by {node.name} and to {known} bit/s by {by}"
            raise BusError(f"{self.name}.{what}", problem, "give all that are on one bus the same")


def _bits(frame: Frame) -> tuple[int, int]:
    """Bits of a frame at the nominal and at the data bit rate, with the gap to the next one; of CAN FD the most that
    it can have."""
    if isinstance(frame, Transmit):
        return stuffing.bits(*frame), 0
    nominal, data = frame_time.bits(len(frame.data), frame.extended, fd=True)
    return (nominal, data) if frame.switched else (nominal + data, 0)


def _size(frame: Frame) -> int:
    return frame.length if isinstance(frame, Transmit) else len(frame.data)


def _flags(frame: Frame) -> int:
    plain = Flag.EXTENDED * frame.extended
    if isinstance(frame, Transmit):
        return plain | Flag.REMOTE * frame.remote
    return plain | Flag.FD | Flag.BITRATE_SWITCH * frame.switched | Flag.ERROR_STATE * frame.error_state
