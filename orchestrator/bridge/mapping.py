"""From a scenario's `can` block to the messages that are received and sent, checked against system and database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from fmus.errors import WiringError
from orchestrator.bridge.inputs import Inlet, Intake, Inward
from orchestrator.bridge.outputs import Discharge, Outlet
from orchestrator.can.census import Census
from orchestrator.can.database.database import Database, MessageSpec, SignalSpec
from orchestrator.can.frames import LONGEST
from orchestrator.fmi.interface import Port
from orchestrator.rational import multiples, seconds
from orchestrator.scenario.can_block import CanBlock, ReceivedBlock
from orchestrator.system import Endpoint, System, check_bounds, require, unit_factor, with_article

_WHOLE = ("Boolean", "Enumeration")


@dataclass(frozen=True)
class Coupling:
    """What passes between a system and a bus.

    Attributes:
        outputs: component.output of the values that are sent.
        sent: what was found in sending them.
    """

    inward: Inward
    outlets: tuple[Outlet, ...]
    outputs: tuple[str, ...]
    sent: Census

    def notes(self) -> list[str]:
        """What is sent without having been asked for."""
        return [
            f"{each.message.name}: {', '.join(each.others)} rest{'s' if len(each.others) == 1 else ''} at the initial "
            "value, or zero, since nothing is sent there"
            for each in self.outlets
            if each.others
        ]


def coupled(block: CanBlock, system: System, database: Database, step: Fraction, switched: bool = False) -> Coupling:
    """The coupling of a system that steps by `step` [s].

    Args:
        switched: whether CAN FD frames switch to the data bit rate.

    Raises:
        WiringError: a name, unit, type, safe value or period does not fit.
        DatabaseError: a message or signal is not in the database.
    """
    sent = Census()
    outputs = tuple(dict.fromkeys(each.source for each in block.send.values()))
    inlets = _inlets(block, system, database)
    outlets = _outlets(block, system, database, outputs, step, sent, switched)
    both = {each.message.name for each in inlets} & {each.message.name for each in outlets}
    if both:
        raise WiringError(f"can: {min(both)}", "is both received and sent", "a message has one sender")
    return Coupling(Inward(database, inlets), outlets, outputs, sent)


def _inlets(block: CanBlock, system: System, database: Database) -> tuple[Inlet, ...]:
    places = {name: place for place, name in enumerate(sorted(map(str, system.stimulated)))}
    messages: dict[str, MessageSpec] = {}
    intakes: dict[str, list[Intake]] = {}
    silences: dict[str, set[float]] = {}
    for name, each in block.receive.items():
        message, signal = database.signal(each.signal)
        public = database.public_name(message, signal)
        intake = _intake(system, name, each, signal, public, places[str(Endpoint.parse(name))])
        messages[message.name] = message
        intakes.setdefault(message.name, []).append(intake)
        silences.setdefault(message.name, set()).update([each.silence] if each.silence else [])
        if len(silences[message.name]) > 1:
            raise WiringError(
                f"can.receive.{name}.silence",
                f"differs from that of another signal of {message.name}",
                "they come and go together; give one",
            )
    return tuple(
        Inlet(message, tuple(intakes[name]), next(iter(silences[name]), block.silence))
        for name, message in messages.items()
    )


def _intake(system: System, name: str, block: ReceivedBlock, signal: SignalSpec, public: str, place: int) -> Intake:
    where = f"can.receive.{name}"
    port = require(system, Endpoint.parse(name), "input", "can be received", where)
    if not port.numeric:
        raise WiringError(where, f"{with_article(port.type)} cannot be received", "set it as a start value")
    check_bounds(f"{where}.safe", port, block.safe)
    if _whole(port) and not _counts(signal):
        raise WiringError(where, f"{signal.name} cannot drive {with_article(port.type)}", "it takes whole numbers")
    if _whole(port) and block.safe != int(block.safe):
        raise WiringError(f"{where}.safe", f"{block.safe:g} is not whole", f"it is {with_article(port.type)}")
    return Intake(public, name, place, unit_factor(where, signal.unit, port.unit), block.safe)


def _whole(port: Port) -> bool:
    return port.type in _WHOLE or "Int" in port.type


def _counts(signal: SignalSpec) -> bool:
    """Whether its values are whole numbers."""
    return not signal.is_float and signal.scale == int(signal.scale) and signal.offset == int(signal.offset)


def _outlets(
    block: CanBlock,
    system: System,
    database: Database,
    outputs: Sequence[str],
    step: Fraction,
    census: Census,
    switched: bool,
) -> tuple[Outlet, ...]:
    messages: dict[str, MessageSpec] = {}
    discharges: dict[str, list[Discharge]] = {}
    for name, each in block.send.items():
        where = f"can.send.{name}"
        message, signal = database.signal(name)
        _check_free(where, message, signal, discharges.get(message.name, []))
        port = require(system, Endpoint.parse(each.source, where), "output", "can be sent", where)
        if not port.numeric:
            raise WiringError(where, f"{with_article(port.type)} cannot be sent", "send a number")
        if each.safe is not None:
            check_bounds(f"{where}.safe", port, each.safe)
        factor = unit_factor(where, port.unit, signal.unit)
        messages[message.name] = message
        discharge = Discharge(signal, each.source, outputs.index(each.source), factor, each.safe)
        discharges.setdefault(message.name, []).append(discharge)
    idle = sorted(set(block.every) - set(messages))
    if idle:
        raise WiringError(f"can.every.{idle[0]}", "no signal is sent in it", f"there are {', '.join(messages)}")
    return tuple(
        Outlet(message, discharges[name], _period(message, block.every.get(name), step), census, switched)
        for name, message in messages.items()
    )


def _check_free(where: str, message: MessageSpec, signal: SignalSpec, others: Sequence[Discharge]) -> None:
    """See that something can be sent in this signal."""
    if any(each.signal.name == signal.name for each in others):
        raise WiringError(where, f"{message.name}.{signal.name} is sent twice", "remove one")
    if message.length > LONGEST:
        raise WiringError(where, f"{message.name} is longer than a frame", "use a message of its own")
    if any(each.scale == 0 for each in message.signals):
        raise WiringError(where, f"{message.name} has a signal with the scale 0", "correct the database")
    if any(each.is_multiplexer for each in message.signals):
        raise WiringError(where, f"{message.name} is multiplexed, which cannot be sent", "use a message of its own")
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
