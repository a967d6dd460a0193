"""What carries operations between nodes as a component of a system, which steps after those that it carries.

A node is given at a communication instant what has arrived until then; when it has sent something is exact, and when
that has arrived, too.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from fmus.errors import FmuError
from orchestrator.can.frames import Frames, empty
from orchestrator.can.ls_bus.ideal_bus import IdealBus
from orchestrator.fmi.interface import Interface, Port, Value
from orchestrator.network.bus_spec import BusSpec
from orchestrator.network.nodes import BusNode

LOG = logging.getLogger("servotwin.network")
_OUTPUTS = {
    "load": ("1", "Share of the latest step in which a frame was on the bus"),
    "frames": ("1", "Frames that got through until now"),
    "waiting": ("1", "Frames that have not begun"),
}


def interface(spec: BusSpec) -> Interface:
    """What such a component shows."""
    shown = {} if spec.direct else _OUTPUTS
    ports = {
        name: Port(name, number, "Float64", "output", unit, description=text, variability="discrete")
        for number, (name, (unit, text)) in enumerate(shown.items())
    }
    kind = "wire" if spec.direct else "CAN bus"
    return Interface(kind, "3.0", ports, {name: frozenset() for name in ports})


@dataclass(frozen=True)
class BusRecord:
    """What a bus has carried.

    Attributes:
        load: share of the time in which a frame was on it.
        remarks: what was out of the ordinary, a line each.
    """

    frames: Frames = field(default_factory=empty)
    load: float = 0.0
    remarks: tuple[str, ...] = ()


class Carrier:
    """A component that carries; see `Component` for the methods."""

    warnings = 0

    def __init__(self, name: str, spec: BusSpec, nodes: Sequence[BusNode]) -> None:
        self.name, self.interface, self.spec, self._nodes = name, interface(spec), spec, tuple(nodes)
        self._outputs: Sequence[str] = ()
        self._values: dict[str, float] = {}
        self._start = 0.0

    @property
    def texts(self) -> Mapping[str, tuple[str, ...]]:
        return {}

    def set(self, values: Mapping[str, Value]) -> None:
        """It has nothing that can be set."""

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._start, self._values = start, dict.fromkeys(self.interface.ports, 0.0)
        for node in self._nodes:
            node.reset()

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._outputs = outputs

    def write(self, values: Sequence[float]) -> None:
        """It has no inputs."""

    def read(self) -> Sequence[float]:
        return [self._values[name] for name in self._outputs]

    def run(self) -> None:
        """Nothing is initialised."""

    def get(self, name: str) -> Value:
        return self._values[name]

    def step(self, time: float, duration: float) -> None:
        """Carry what the nodes have sent, each kind in its own way."""
        raise NotImplementedError

    def tune(self, name: str, value: Value) -> Value:
        raise FmuError(f"{self.name}.{name}", "cannot be set", "remove it")

    def save(self) -> Any:
        raise FmuError(self.name, "cannot go back", "remove `order` and `cycles`")

    def restore(self, state: Any) -> None:
        self.save()

    def drop(self, state: Any) -> None:
        """Nothing is held."""

    def reset(self) -> bool:
        return False

    def terminate(self) -> None:
        """Nothing ends."""

    def close(self) -> None:
        """Nothing is held."""


class CanBus(Carrier):
    """A bus that arbitrates, between any number of nodes."""

    def __init__(self, name: str, spec: BusSpec, nodes: Sequence[BusNode]) -> None:
        super().__init__(name, spec, nodes)
        self._bus = self._between(self._nodes)

    def _between(self, nodes: Sequence[BusNode]) -> IdealBus:
        return IdealBus(self.name, [node.name for node in nodes], self.spec.bitrate, self.spec.data_bitrate)

    @contextmanager
    def joined(self, node: BusNode) -> Iterator[None]:
        """Have one more node on the bus, between runs."""
        before = self._nodes, self._bus
        self._nodes = (*self._nodes, node)
        self._bus = self._between(self._nodes)
        try:
            yield
        finally:
            self._nodes, self._bus = before

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        super().begin(start, stop, tolerance)
        self._bus.reset()
        self._reached = start

    def step(self, time: float, duration: float) -> None:
        bus, end = self._bus, time + duration
        for number, node in enumerate(self._nodes):
            bus.nodes[number].notified = node.notified
            for stamp, data in node.sent(time):
                bus.take(number, stamp, data)
        before = bus.busy(time)
        bus.run(end)
        for inbox, node in zip(bus.nodes, self._nodes, strict=True):
            if inbox.inbox:
                node.deliver(inbox.inbox)
                inbox.inbox = []
        self._reached = end
        self._values = {
            "load": (bus.busy(end) - before) / duration,
            "frames": float(bus.carried),
            "waiting": float(bus.waiting),
        }

    def carried(self) -> BusRecord:
        """What it has carried until now."""
        span = self._reached - self._start
        remarks = [f"{count:,} {what}" for what, count in self._bus.counts.items()]
        remarks += [f"{self._bus.waiting:,} frames were still waiting at the end"] if self._bus.waiting else []
        own = [line for node in self._nodes for line in node.remarks()]
        load = self._bus.busy(self._reached) / span if span > 0 else 0.0
        return BusRecord(self._bus.frames(), load, (*remarks, *own))

    def terminate(self) -> None:
        for line in self.carried().remarks:
            LOG.warning("%s: %s", self.name, line)


class DirectWire(Carrier):
    """A wire between two nodes: what one sends the other has at the next communication instant, as it is."""

    def step(self, time: float, duration: float) -> None:
        one, other = self._nodes
        sent = [data for _, data in one.sent(time)], [data for _, data in other.sent(time)]
        for node, received in ((other, sent[0]), (one, sent[1])):
            if received:
                node.deliver(received)
