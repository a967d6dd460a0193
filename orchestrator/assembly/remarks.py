"""What is left to itself in a component of a system."""

from __future__ import annotations

from collections.abc import Container

from fmus.words import listed
from orchestrator.system import Endpoint, System


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
    driven = {link.target for link in system.connections} | system.stimulated
    free = [
        port.name
        for port in (*interface.of("parameter"), *interface.of("input"))
        if port.array is not None and port.array.starts is None and port.name not in given
        if Endpoint(component, port.name) not in driven
    ]
    said = [f"nothing ticks its clocks ({listed(clocks)})"] if clocks else []
    if binaries:
        said.append(f"its binary inputs ({listed(binaries)}) keep what the FMU gives them")
    if interface.left_out:
        said.append(f"leaves out {listed(list(interface.left_out))}: `servotwin info` says why")
    if free:
        said.append(f"{listed(free)} of arrays without start values of this size keep what the FMU gives them")
    return said
