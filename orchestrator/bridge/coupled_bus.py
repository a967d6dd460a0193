"""A bus of a scenario coupled to a real or virtual one in real time: what is on one is on the other, too.

The real bus is one more node of the simulated one. What comes from it goes over the simulated bus again, in the step
after it came; what got through there is given to the adapter when the step is over. Nothing passes in steps that are
too late, nor to an adapter that is full: frames are dropped and counted, not sent when they are old. Steps that are too
late for long, and those that do not end, end it: nobody knows values that would be safe to send.
"""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial

from fmus.errors import BusError, InputError
from orchestrator.bridge.safety.resting import usual_lateness
from orchestrator.can.live.backlog import Backlog
from orchestrator.can.live.bus import BusSettings
from orchestrator.can.live.line import SendingLine
from orchestrator.can.live.link import linked
from orchestrator.can.live.news import News
from orchestrator.can.live.receiver import Receiver
from orchestrator.can.ls_bus.messages import message_of, operation_of
from orchestrator.can.ls_bus.operations import Transmit, TransmitFd, decoded, encoded
from orchestrator.engine import Result, Run, Simulation, Sink
from orchestrator.live.paced import Paced
from orchestrator.network.carriers import CanBus
from orchestrator.processes import last_words

LOG = logging.getLogger("servotwin.can")
_QUEUE = 4096  # frames that wait to be taken at most
UNSAFE = "network FMUs send here, and have no safe values: if they hear nothing, what they send is theirs to know"
_LOOKS = 20  # in the time in which a step has to end
_REFUSING = 0.1  # for which an adapter may refuse all frames where nothing is received [s]
_ROOM = 0.005  # for which an adapter may have no room, once; until it takes a frame again it is not waited for [s]


class RealNode:
    """A real bus as a node of a simulated one; see `BusNode` for the methods.

    Args:
        most_late: by how much a step may be late [s]; give_up: by how much until this ends [s].

    Attributes:
        late: by how much the step is that is being taken [s].
    """

    notified = False

    def __init__(self, bus: BusSettings, most_late: float, give_up: float, stack: ExitStack) -> None:
        self.name, self._settings, self._most_late, self.late = bus.place, bus, most_late, 0.0
        self._give_up = give_up
        link = stack.enter_context(linked(bus, _REFUSING, lambda line: LOG.warning("%s", line)))
        receiver = stack.enter_context(Receiver(link, _QUEUE, most_late=most_late))
        self._line = SendingLine(link, receiver, Backlog(bus), most_late, self.name)
        self._odd, self._crowded, self._begun = Counter[str](), False, False
        self._news = News(lambda line: LOG.warning("%s: %s", self.name, line))

    def reset(self) -> None:
        """What is on a bus goes on."""

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        frames = self._line.take()
        good = [frame for frame in frames if not frame.is_error_frame]
        self._count(len(frames) - len(good), "error frames were not passed on")
        if self._is_late:
            self._count(len(good), "frames were dropped: they came before steps that were too late")
            return []
        return [(time, encoded([operation_of(frame)])) for frame in good]

    def deliver(self, operations: Sequence[bytes]) -> None:
        for operation in (one for data in operations for one in decoded(data)):
            if isinstance(operation, TransmitFd) and not self._settings.fd:
                self._count(1, "CAN FD frames were not sent: the bus has none")
            elif isinstance(operation, Transmit | TransmitFd):
                self._give(operation)

    def remarks(self) -> list[str]:
        return [f"{self.name}: {count:,} {what}" for what, count in self._counts().items() if count]

    def begin(self, late: float) -> None:
        """A step begins that is so late [s].

        Raises:
            BusError: the bus is lost, or the step is too late.
        """
        now, line = time.monotonic(), self._line
        self.late = late
        line.fills(now)
        self._news.look(now, self._counts)
        if not self._begun:
            self._begun = True
            self._count(len(line.take()), "frames were left out: they came before the first step")
        if trouble := line.link.trouble or str(line.receiver.failure or ""):
            raise BusError(self.name, f"is lost ({trouble})", "see to the adapter and the wiring")
        if late > self._give_up:
            raise BusError(self.name, f"steps are {late:.3g} s late", "give it a faster machine, or a longer step")

    @property
    def _is_late(self) -> bool:
        return self.late > self._most_late

    def _give(self, operation: Transmit | TransmitFd) -> None:
        if self._is_late:
            self._count(1, "frames were not sent: steps were too late")
        elif self._line.full:
            self._line.blocked += 1
        else:
            patience = 0.0 if self._crowded else _ROOM
            self._crowded = not self._line.give(message_of(operation), time.monotonic(), patience)

    def _counts(self) -> dict[str, int]:
        line, receiver = self._line, self._line.receiver
        return self._odd | {
            "frames were dropped: they came faster than they could be taken": receiver.dropped,
            "frames were dropped: they came while this computer did not look": receiver.late,
            "frames were not sent: the adapter had no room": line.link.no_room,
            "frames were not sent: the bus was full": line.blocked,
            "frames were not sent: the bus was lost": line.link.unsent,
            "frames and commands that the adapter refused": line.link.refused,
        }

    def _count(self, count: int, what: str) -> None:
        self._odd[what] += count


@dataclass(frozen=True)
class Coupled:
    """Runs simulations in real time with their buses, in their order, on these."""

    paced: Paced
    buses: tuple[BusSettings, ...]

    def execute(self, simulation: Simulation, run: Run, sink: Sink | None = None) -> Result:
        """The result of a run; see `Paced`.

        Raises:
            InputError: there are more buses than the scenario has.
            BusError: an adapter does not open.
        """
        own = [one for one in simulation.components.values() if isinstance(one, CanBus)]
        if len(own) != len(self.buses):
            places, names = ", ".join(bus.place for bus in self.buses), ", ".join(one.name for one in own)
            problem = f"{len(self.buses)} buses for {len(own)} of the scenario ({names})"
            if not own:
                problem = "the scenario has only direct wires, which are not coupled to a real bus"
            raise InputError(places, problem, "give one each" if own else "join the nodes by a bus without `direct`")
        with ExitStack() as stack:
            usual, nodes = usual_lateness(float(simulation.timing.step)), []
            for carrier, bus in zip(own, self.buses, strict=True):
                spec = carrier.spec
                nodes.append(RealNode(bus, spec.most_late or usual, spec.give_up, stack))
                stack.enter_context(carrier.joined(nodes[-1]))
                LOG.warning("%s: %s", bus.place, UNSAFE)
            patience = 2 * min(carrier.spec.give_up for carrier in own)
            return replace(self.paced, stepping=partial(_stepping, nodes, patience)).execute(simulation, run, sink)


@contextmanager
def _stepping(nodes: Sequence[RealNode], patience: float) -> Iterator[Callable[[float], None]]:
    """Tell the nodes of steps; kill this process where none begins for so long while it runs [s]."""
    begun, over = threading.Event(), threading.Event()

    def begin(late: float) -> None:
        begun.set()
        for node in nodes:
            node.begin(late)

    if sys.platform != "win32":

        def watch() -> None:
            looks = 0
            while not over.wait(patience / _LOOKS):  # a computer that stood still has not looked
                looks = 0 if begun.is_set() else looks + 1
                begun.clear()
                if looks > _LOOKS:
                    last_words.own().say(last_words.KILLED, f"no step has ended for {patience:g} s")
                    os.kill(os.getpid(), signal.SIGKILL)

        threading.Thread(target=watch, name="watch over steps", daemon=True).start()
    try:
        yield begin
    finally:
        over.set()
