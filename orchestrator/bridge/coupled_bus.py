"""A bus of a scenario coupled to a real or virtual one in real time: what is on one is on the other, too.

The real bus is one more node of the simulated one. What comes from it goes over the simulated bus again, in the step
after it came; what got through there is given to the adapter when the step is over.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass

from fmus.errors import InputError
from orchestrator.can.live.bus import BusSettings, opened, send
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.ls_bus.messages import message_of, operation_of
from orchestrator.can.ls_bus.operations import Transmit, TransmitFd, decoded, encoded
from orchestrator.engine import Result, Run, Simulation, Sink
from orchestrator.live.paced import Paced
from orchestrator.network.carriers import CanBus

_QUEUE = 4096  # frames that wait to be taken at most


class RealNode:
    """A real bus as a node of a simulated one; see `BusNode` for the methods."""

    notified = False

    def __init__(self, name: str, bus: BusSettings, stack: ExitStack) -> None:
        self.name, self._settings = name, bus
        self._bus = stack.enter_context(opened(bus))
        self._receiver = stack.enter_context(Receiver(self._bus, _QUEUE))
        self._odd = Counter[str]()

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        frames = [frame for frame in self._receiver.take() if not self._is_odd(frame.is_error_frame)]
        return [(time, encoded([operation_of(frame)])) for frame in frames]

    def deliver(self, operations: Sequence[bytes]) -> None:
        for operation in (one for data in operations for one in decoded(data)):
            if isinstance(operation, TransmitFd) and not self._settings.fd:
                self._odd["CAN FD frames were not sent: the bus has none"] += 1
            elif isinstance(operation, Transmit | TransmitFd):
                send(self._bus, message_of(operation))

    def remarks(self) -> list[str]:
        dropped = self._receiver.dropped
        lost = [f"{dropped:,} frames were dropped: they came faster than they could be taken"] if dropped else []
        return [f"{self.name}: {line}" for line in [*lost, *(f"{n:,} {what}" for what, n in self._odd.items())]]

    def _is_odd(self, error: bool) -> bool:
        self._odd.update(["error frames were not passed on"] if error else [])
        return error


@dataclass(frozen=True)
class Coupled:
    """Runs simulations in real time with their buses, in their order, on these."""

    paced: Paced
    buses: tuple[BusSettings, ...]

    def execute(self, simulation: Simulation, run: Run, sink: Sink | None = None) -> Result:
        """The result of a run; see `Paced`.

        Raises:
            InputError: there are more buses than the scenario has.
            BusError: an adapter does not open, or takes no more.
        """
        own = [one for one in simulation.components.values() if isinstance(one, CanBus)]
        if len(own) != len(self.buses):
            places, names = ", ".join(bus.place for bus in self.buses), ", ".join(one.name for one in own)
            raise InputError(
                places, f"{len(self.buses)} buses for {len(own)} of the scenario ({names})", "give one each"
            )
        with ExitStack() as stack:
            for carrier, bus in zip(own, self.buses, strict=True):
                node = RealNode(bus.place, bus, stack)
                stack.enter_context(carrier.joined(node))
            return self.paced.execute(simulation, run, sink)
