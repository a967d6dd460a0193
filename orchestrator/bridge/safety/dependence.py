"""Which received inputs a sent output may depend on: those from which the wiring leads to it, through any component."""

from __future__ import annotations

from collections.abc import Sequence

from fmus.errors import WiringError
from orchestrator.bridge.signals.inputs import ReceivedMessage
from orchestrator.scenario.can_block import SentBlock
from orchestrator.system import Endpoint, System

STOP = "can.stop"  # what takes the stop signal; every output rests without it


def needs(
    where: str, block: SentBlock, component: str, system: System, received: Sequence[ReceivedMessage]
) -> frozenset[str]:
    """The inputs without which an output of the component rests.

    Raises:
        WiringError: `while` names what is not received.
    """
    if block.while_ is None:
        above = _upstream(system, component)
        inputs = (signal.input for message in received for signal in message.signals)
        return frozenset(name for name in inputs if name == STOP or Endpoint.parse(name).component in above)
    named = {STOP} & {signal.input for message in received for signal in message.signals}
    for name in block.while_:
        meant = {
            signal.input
            for message in received
            for signal in message.signals
            if name
            in (message.name, message.spec.name, signal.name, signal.input, f"{message.spec.name}.{signal.name}")
        }
        if not meant:
            there = ", ".join(message.name for message in received) or "nothing"
            raise WiringError(f"{where}.while", f"'{name}' is not received", f"there is {there}")
        named |= meant
    return frozenset(named)


def _upstream(system: System, component: str) -> set[str]:
    """The component and all from which connections lead to it."""
    found, fresh = set[str](), {component}
    while fresh:
        found |= fresh
        fresh = {link.source.component for link in system.links if link.target.component in fresh} - found
    return found
