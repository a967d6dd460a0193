"""From the buses of a system to what its components exchange with them, checked against their FMUs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from fmus.errors import WiringError
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.terminals import read
from orchestrator.network.bus_spec import BusSpec
from orchestrator.network.carriers import CanBus, Carrier, DirectWire
from orchestrator.network.low_cut import KIND, RULE, LowCut, low_cut
from orchestrator.network.nodes import BusNode, LowCutNode

if TYPE_CHECKING:
    from orchestrator.network.high_cut import HighCut


@dataclass(frozen=True)
class Joined:
    """A bus and its terminals.

    Attributes:
        terminals: component and terminal -> what it exchanges, in the order of the nodes.
    """

    spec: BusSpec
    terminals: Mapping[tuple[str, str], LowCut | HighCut] = field(default_factory=dict)

    @property
    def components(self) -> tuple[str, ...]:
        """Those on the bus."""
        return tuple(dict.fromkeys(component for component, _ in self.terminals))

    def carrier(self, name: str, slaves: Mapping[str, ClockedSlave]) -> Carrier:
        """What carries for these instances."""
        nodes = [_node(f"{one}.{own}", slaves[one], found) for (one, own), found in self.terminals.items()]
        return (DirectWire if self.spec.direct else CanBus)(name, self.spec, nodes)


def joined(buses: Mapping[str, BusSpec], files: Mapping[str, FmuFile]) -> dict[str, Joined]:
    """The buses by their names, of components with these files.

    Raises:
        WiringError: a bus is called as a component, or too few are on it; there is no such component or terminal, or
            the terminal is on another bus, too.
        FmuFileError: a terminal does not fit, or its FMU has no event mode.
        DatabaseError: a database cannot be read.
    """
    found: dict[str, Joined] = {}
    taken: dict[str, str] = {}
    for name, spec in buses.items():
        if name in files:
            raise WiringError(f"buses.{name}", "is the name of a component, too", "give it another")
        if spec.direct and len(spec.nodes) != 2:
            raise WiringError(f"buses.{name}", f"is direct and has {len(spec.nodes)} nodes", "give it two")
        for node in spec.nodes:
            if node in taken:
                raise WiringError(f"buses.{name}", f"{node} is on {taken[node]} already", "a terminal has one bus")
            taken[node] = name
        found[name] = Joined(spec, dict(_terminal(f"buses.{name}", spec, node, files) for node in spec.nodes))
    return found


def exchanged(buses: Mapping[str, Joined], component: str) -> list[LowCut | HighCut]:
    """What a component exchanges, over all buses."""
    return [found for bus in buses.values() for (one, _), found in bus.terminals.items() if one == component]


def have_exchange(slave: ClockedSlave, terminals: list[LowCut | HighCut]) -> None:
    """Have an instance exchange what its terminals have."""
    outgoing, incoming = dict[str, list[str]](), dict[str, list[str]]()
    for terminal in terminals:
        if isinstance(terminal, LowCut):
            outgoing[terminal.tx_clock], incoming[terminal.rx_clock] = [terminal.tx_data], [terminal.rx_data]
        else:
            for frame in terminal.frames:
                (outgoing if frame.sent else incoming)[frame.clock] = frame.variables
    slave.exchange(outgoing, incoming)


def _terminal(
    place: str, spec: BusSpec, node: str, files: Mapping[str, FmuFile]
) -> tuple[tuple[str, str], LowCut | HighCut]:
    component, dot, name = node.partition(".")
    if not dot or component not in files:
        problem = f"'{node}' names no component and terminal"
        raise WiringError(place, problem, f"write component.Terminal; components are {', '.join(files)}")
    fmu = files[component]
    terminals = {own: terminal for own, terminal in read(fmu.path).items() if terminal.kind == KIND}
    if name not in terminals:
        known = f"it has {', '.join(terminals)}" if terminals else "its FMU has none after FMI-LS-BUS"
        raise WiringError(place, f"{component} has no bus terminal '{name}'", known)
    where = f"{fmu.path}: terminal {name}"
    if not fmu.interface.ticks:
        raise WiringError(f"{place}: {node}", "is of an FMU without event mode", "export it with hasEventMode")
    found: LowCut | HighCut
    if terminals[name].rule == RULE:
        found = low_cut(where, fmu, terminals[name])
    else:
        from orchestrator.network.high_cut import high_cut  # noqa: PLC0415 - brings along what reads databases

        found = high_cut(where, fmu, terminals[name], spec.database)
    if spec.direct and not isinstance(found, LowCut):
        raise WiringError(
            f"{place}: {node}", "exchanges signals, which a direct wire does not carry", "remove `direct`"
        )
    return (component, name), found


def _node(name: str, slave: ClockedSlave, terminal: LowCut | HighCut) -> BusNode:
    if isinstance(terminal, LowCut):
        return LowCutNode(name, slave, terminal)
    from orchestrator.network.signal_node import HighCutNode  # noqa: PLC0415 - brings along what reads databases

    return HighCutNode(name, slave, terminal)
