"""What carries between nodes, without FMUs."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from orchestrator.can.ls_bus.operations import Transmit, encoded
from orchestrator.network.bus_spec import BusSpec
from orchestrator.network.carriers import CanBus


@dataclass
class Talker:
    """A node that sends a frame a step."""

    name: str
    heard: list[bytes] = field(default_factory=list)
    notified: bool = False

    def reset(self) -> None:
        self.heard.clear()

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        return [(time, encoded([Transmit(1, False, False, 1, b"\1")]))]

    def deliver(self, operations: Sequence[bytes]) -> None:
        self.heard += operations

    def remarks(self) -> list[str]:
        return []


def test_a_bus_carries_between_its_own_again_once_a_guest_has_left() -> None:
    own, guest = [Talker("a"), Talker("b")], Talker("guest")
    bus = CanBus("can0", BusSpec(("a.Can", "b.Can"), 500_000), own)
    bus.bind((), ("frames",))
    for there, frames in ((False, 2.0), (True, 3.0), (False, 2.0)):
        if there:
            with bus.joined(guest):
                bus.begin(0.0, None)
                bus.step(0.0, 0.01)
        else:
            bus.begin(0.0, None)
            bus.step(0.0, 0.01)
        assert list(bus.read()) == [frames]
    assert guest.heard and own[0].heard
