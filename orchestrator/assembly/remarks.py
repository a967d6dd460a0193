"""What is left to itself in a component of a system."""

from __future__ import annotations

from collections.abc import Container, Iterator, Mapping
from fractions import Fraction

from fmus.words import listed
from orchestrator.fmi.interface import Interface, Value
from orchestrator.system import Endpoint, System

_SAMPLED_BY = "sample_time"  # what models of the library, and most of others that sample, call their period
_SAME = 1e-9  # of a ratio: periods are written with 10 digits or more


def remarks(system: System, component: str, given: Container[str]) -> list[str]:
    """What is left to itself in a component that has these values."""
    interface = system.parts[component].interface
    ticked = {link.target for link in system.clocks} | system.carried
    clocks = [
        clock.name
        for clock in interface.clocks.values()
        if clock.causality == "input" and Endpoint(component, clock.name) not in ticked
        if not (clock.timed and interface.event_mode)
    ]
    told = {link.target for link in system.texts} | system.carried
    binaries = [
        port.name
        for port in interface.of("input")
        if port.type == "Binary" and Endpoint(component, port.name) not in told
    ]
    driven = {link.target for link in (*system.connections, *system.settled)} | system.stimulated
    free = [
        port.name
        for port in (*interface.of("parameter"), *interface.of("input"))
        if port.array is not None and port.array.starts is None and port.name not in given
        if Endpoint(component, port.name) not in driven
    ]
    said = [f"nothing ticks its clocks ({listed(clocks)})"] if clocks else []
    if binaries:
        said.append(f"its binary inputs ({listed(binaries)}) keep what the FMU gives them")
    given_on = {link.source for link in system.connections if link.source.component == component}
    if local := sorted(end.variable for end in given_on if system.port(end).causality == "local"):
        said.append(f"{listed(local)} is local, which FMI keeps to an FMU; it is connected as an output would be")
    said += _other_items(system, component)
    if interface.left_out:
        said.append(f"leaves out {listed(list(interface.left_out))}: `servotwin info` says why")
    if free:
        said.append(f"{listed(free)} of arrays without start values of this size keep what the FMU gives them")
    doubts = [
        f"{name} {why}"
        for name, why in interface.doubts.items()
        if name not in given and Endpoint(component, name) not in driven
    ]
    return [*said, f"{listed(doubts, 3, '; ')} (`servotwin info` shows all)"] if doubts else said


def _other_items(system: System, component: str) -> Iterator[str]:
    """Where numbers that a component takes over mean other items of an enumeration than where they come from."""
    for link in (*system.connections, *system.settled):
        if link.target.component != component or (link.factor, link.offset) != (1.0, 0.0):
            continue
        here, there = (system.port(end).items or {} for end in (link.target, link.source))
        own = {number: f"'{item}'" for item, number in here.items()}
        others = [
            f"{number} is '{item}' there and {own.get(number, 'none')} here"
            for item, number in there.items()
            if here and own.get(number) != f"'{item}'"
        ]
        if others:
            yield f"{link.target.variable} takes the numbers of {link.source}, not its items: {listed(others, 3, '; ')}"


def sampling(interface: Interface, given: Mapping[str, Value], step: Fraction) -> str | None:
    """What a component makes of its sample period that is no whole number of its communication steps.

    Args:
        given: its parameters, the others have the FMU's defaults.
        step: its communication step [s].
    """
    port = interface.ports.get(_SAMPLED_BY)
    if port is None or port.causality != "parameter" or port.unit != "s":
        return None
    period = given.get(_SAMPLED_BY, float(port.start or 0))
    if not isinstance(period, float | int):
        return None  # refused where it is set
    steps = period / float(step)
    if steps <= 0 or (round(steps) >= 1 and abs(steps - round(steps)) <= _SAME * steps):
        return None
    return (
        f"samples every {period:.6g} s, which is no whole number of its steps of {float(step):.6g} s: what it reads"
        f" within a step is as old as the step's start; choose a step that divides {_SAMPLED_BY}"
    )
