"""From a scenario's `can` block to the messages that are received and sent, checked against system and database."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from fmus.errors import DatabaseError, WiringError
from fmus.words import with_article
from orchestrator.bridge.safety.dependence import STOP, needs
from orchestrator.bridge.safety.resting import Rules, usual_lateness
from orchestrator.bridge.signals.inputs import ReceivedMessage, ReceivedSignal, Reception
from orchestrator.bridge.signals.location import Locations, MessageLocation
from orchestrator.bridge.signals.outputs import SentMessage, SentSignal
from orchestrator.can.codec.fields import check_sendable, outside
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.can.statistics import FrameStatistics
from orchestrator.crossing import Crossing, NamedUnit, crossing
from orchestrator.fmi.interface import Port
from orchestrator.rational import multiples, seconds
from orchestrator.scenario.can_block import CanBlock, ReceivedBlock
from orchestrator.settable import check_bounds
from orchestrator.system import Endpoint, System, drivable, require

_WHOLE = ("Boolean", "Enumeration")


@dataclass(frozen=True)
class Coupling:
    """What passes between a system and a bus.

    Attributes:
        outputs: component.output of the values that are sent.
        width: values that are received, one a stimulated input and one for the stop signal, which is the last.
        rules: when outputs rest and go on again.
        sent_statistics: what was found in sending them.
    """

    reception: Reception
    sent: tuple[SentMessage, ...]
    outputs: tuple[str, ...]
    width: int
    rules: Rules
    sent_statistics: FrameStatistics

    @property
    def crossings(self) -> list[Crossing]:
        """How values pass between signals and variables."""
        signals = [signal for message in self.reception.messages for signal in message.signals]
        received = [signal.crossing for signal in signals if signal.input != STOP]
        return received + [signal.crossing for message in self.sent for signal in message.signals]

    def notes(self) -> list[str]:
        """What is sent without having been asked for, and what nothing puts to rest."""
        endless = [
            f"{message.name}: no `safe` value for {', '.join(names)}: whatever happens, the last value is the last"
            for message in self.sent
            if (names := [signal.spec.name for signal in message.signals if signal.safe is None])
        ]
        return [*endless, *(note for message in self.sent for note in message.notes())]


def coupled(
    block: CanBlock, system: System, databases: Sequence[Database], step: Fraction, switched: bool = False
) -> Coupling:
    """The coupling of a system that steps by `step` [s].

    Args:
        databases: of each channel.
        switched: whether CAN FD frames switch to the data bit rate.

    Raises:
        WiringError: a name, unit, type, safe value or period does not fit.
        DatabaseError: a message or signal is not in the database.
    """
    statistics = FrameStatistics()
    outputs = tuple(dict.fromkeys(signal.source for signal in block.send.values()))
    places = Locations(databases, block.channel)
    received = _received(block, system, places)
    periods, signals = _sent(block, system, places, outputs, step, received)
    sent = tuple(SentMessage(place, signals[place], period, statistics, switched) for place, period in periods.items())
    both = {message.name for message in received} & {message.name for message in sent}
    if both:
        raise WiringError(f"can: {min(both)}", "is both received and sent", "a message has one sender")
    for spec in [*(message.spec for message in received), *(message.spec for message in sent)]:
        if spec.of_any_sender:
            problem = f"the identifier 0x{spec.id:X} has no sender's address, so no frame of the bus has it"
            raise WiringError(f"can: {spec.name}", problem, "give a database with the address (of CANopen a DCF)")
    rules = Rules(
        block.resume == "latch",
        block.after,
        block.on_silence == "end",
        block.most_late or usual_lateness(float(step)),
        block.give_up,
        block.reconnect,
    )
    return Coupling(Reception(databases, received), sent, outputs, len(system.stimulated) + 1, rules, statistics)


def _received(block: CanBlock, system: System, locations: Locations) -> tuple[ReceivedMessage, ...]:
    places = {name: place for place, name in enumerate(sorted(map(str, system.stimulated)))}
    messages: dict[MessageLocation, list[ReceivedSignal]] = {}
    silences: dict[MessageLocation, set[float]] = {}
    for name, wanted in block.receive.items():
        message, signal = locations.find(f"can.receive.{name}", wanted.signal, wanted.channel)
        public = locations.databases[message.number].public_name(message.message, signal)
        taken = _received_signal(system, name, wanted, signal, public, places[str(Endpoint.parse(name))])
        messages.setdefault(message, []).append(taken)
        silences.setdefault(message, set()).update([wanted.silence] if wanted.silence else [])
        if len(silences[message]) > 1:
            raise WiringError(
                f"can.receive.{name}.silence",
                f"differs from that of another signal of {message.name}",
                "they come and go together; give one",
            )
    if block.stop is not None:
        message, signal = locations.find("can.stop", block.stop)
        public, nothing = locations.databases[message.number].public_name(message.message, signal), NamedUnit()
        halting = ReceivedSignal(public, STOP, len(places), crossing(STOP, nothing, nothing), 0.0)
        messages.setdefault(message, []).append(halting)
    return tuple(
        ReceivedMessage(message, tuple(signals), _silence(message.message, silences.get(message, set()), block.silence))
        for message, signals in messages.items()
    )


def _silence(message: MessageSpec, given: set[float], usual: float) -> float:
    """How long no frame of the message may come [s]."""
    silence = next(iter(given), usual)
    if message.cycle is not None and silence <= message.cycle:
        problem = f"is {silence:g} s, and {message.name} comes every {message.cycle:g} s"
        raise WiringError("can: silence", problem, "allow some periods")
    return silence


def _received_signal(
    system: System, name: str, block: ReceivedBlock, signal: SignalSpec, public: str, place: int
) -> ReceivedSignal:
    where = f"can.receive.{name}"
    port = drivable(system, Endpoint.parse(name), "can be received", where)
    if not port.numeric:
        raise WiringError(where, f"{with_article(port.type)} cannot be received", "set it as a start value")
    safe = port.number(f"{where}.safe", block.safe)
    check_bounds(f"{where}.safe", port, safe)
    if _whole(port) and not _counts(signal):
        raise WiringError(where, f"{signal.name} cannot drive {with_article(port.type)}", "it takes whole numbers")
    if _whole(port) and safe != int(safe):
        raise WiringError(f"{where}.safe", f"{safe:g} is not whole", f"it is {with_article(port.type)}")
    crossed = crossing(where, port.meaning(signal.unit), port.measure)
    low, high = _range(signal, port, crossed)
    if not low <= safe <= high:
        problem = f"is {safe:g}, and {signal.name} is in [{low:g}, {high:g}]"
        raise WiringError(f"{where}.safe", problem, "choose a value inside")
    return ReceivedSignal(public, name, place, crossed, safe, low, high, block.range == "reject")


def _range(signal: SignalSpec, port: Port, crossed: Crossing) -> tuple[float, float]:
    """What a received value may be by its signal and by its input [unit of the input]."""
    ends = (signal.minimum, signal.maximum)
    ends = ends[::-1] if crossed.conversion.factor < 0 else ends
    found = [None if end is None else float(crossed.conversion(end)) for end in ends]
    low = max(-math.inf if end is None else end for end in (found[0], port.minimum))
    high = min(math.inf if end is None else end for end in (found[1], port.maximum))
    if low > high:
        raise WiringError(crossed.place, f"no value of {signal.name} fits the input's bounds", "see to both ranges")
    return low, high


def _whole(port: Port) -> bool:
    return port.type in _WHOLE or "Int" in port.type


def _counts(signal: SignalSpec) -> bool:
    """Whether its values are whole numbers."""
    return not signal.is_float and signal.scale == int(signal.scale) and signal.offset == int(signal.offset)


def _sent(
    block: CanBlock,
    system: System,
    locations: Locations,
    outputs: Sequence[str],
    step: Fraction,
    received: Sequence[ReceivedMessage],
) -> tuple[dict[MessageLocation, int], dict[MessageLocation, list[SentSignal]]]:
    """Periods in steps, and the signals that are sent, by their message."""
    messages: dict[MessageLocation, list[SentSignal]] = {}
    periods: dict[MessageLocation, int] = {}
    for name, wanted in block.send.items():
        where = f"can.send.{name}"
        place, signal = locations.find(where, name, wanted.channel)
        message = place.message
        _check_free(where, message, signal, messages.get(place, []))
        source = Endpoint.parse(wanted.source, where)
        port = require(system, source, "output", "can be sent", where)
        if not port.numeric:
            raise WiringError(where, f"{with_article(port.type)} cannot be sent", "send a number")
        crossed = crossing(where, port.measure, port.meaning(signal.unit))
        safe = None if wanted.safe is None else port.number(f"{where}.safe", wanted.safe)
        if safe is not None:
            check_bounds(f"{where}.safe", port, safe)
            _check_range(f"{where}.safe", signal, crossed, safe)
        largest = wanted.limit.magnitude
        periods[place] = _period(message, block.every.get(message.name), step)
        given = SentSignal(
            signal,
            wanted.source,
            outputs.index(wanted.source),
            crossed,
            safe,
            needs(where, wanted, source.component, system, received),
            math.inf if largest is None else port.number(f"{where}.limit.magnitude", largest),
            math.inf if wanted.limit.rate is None else wanted.limit.rate * float(periods[place] * step),
        )
        messages.setdefault(place, []).append(given)
    sent = [place.message.name for place in messages]
    idle = sorted(set(block.every) - set(sent))
    if idle:
        raise WiringError(f"can.every.{idle[0]}", "no signal is sent in it", f"there are {', '.join(sent)}")
    return periods, messages


def _check_range(where: str, signal: SignalSpec, crossed: Crossing, value: float) -> None:
    """See that a value that is to be sent fits its signal."""
    sent = crossed.conversion(value)
    if limits := outside(signal, sent):
        number = f"is {sent:g} {signal.unit}".rstrip()
        raise WiringError(where, f"{number} on the bus, and {limits}", "choose a value inside")


def _check_free(where: str, message: MessageSpec, signal: SignalSpec, others: Sequence[SentSignal]) -> None:
    """See that something can be sent in this signal."""
    if any(other.spec.name == signal.name for other in others):
        raise WiringError(where, f"{message.name}.{signal.name} is sent twice", "remove one")
    try:
        check_sendable(message)
    except DatabaseError as error:
        raise WiringError(where, f"{error.place} {error.problem}", error.fix) from None
    protection = message.protection
    if protection is not None and signal.name in (protection.counter, protection.checksum):
        raise WiringError(where, f"protects {message.name} and is filled in by itself", "remove it")


def _period(message: MessageSpec, given: Fraction | None, step: Fraction) -> int:
    """Communication steps from one frame to the next."""
    where = f"can.every.{message.name}"
    if given is None and message.cycle is None:
        raise WiringError(where, "is not given, and the database has no cycle time of it", "give a period in seconds")
    period = seconds(message.cycle, where) if given is None and message.cycle is not None else given
    assert period is not None
    return multiples(period, step, where)
