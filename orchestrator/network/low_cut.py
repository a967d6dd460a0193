"""Nodes that exchange operations, FMI-LS-BUS' network abstraction ("low cut"): what their terminal must be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from fmus.errors import FmuFileError
from orchestrator.can.ls_bus.operations import MIME_TYPE
from orchestrator.fmi.clocks.declared import TickInterval
from orchestrator.fmi.file import FmuDescription
from orchestrator.fmi.terminals import Binaries, FmuTerminal, binaries

KIND = "org.fmi-ls-bus.network-terminal"
RULE = "org.fmi-ls-bus.transceiver"
_OLD_NOTIFICATIONS = "org.fmi_standard.fmi_ls_bus.Can_BusNotifications"  # before 1.0
_MEMBERS = {"Tx_Data": "output", "Tx_Clock": "", "Rx_Data": "input", "Rx_Clock": "input"}  # "": as its kind has it


@dataclass(frozen=True)
class LowCut:
    """The variables of a terminal; `most` bytes that the FMU takes at once, None for any number.

    Attributes:
        notifications: parameter that says whether the node wants to be told what becomes of its frames, "" without.
    """

    tx_data: str
    tx_clock: str
    rx_data: str
    rx_clock: str
    notifications: str
    most: int | None

    @property
    def carried(self) -> frozenset[str]:
        """What the bus sees to."""
        return frozenset({self.tx_data, self.tx_clock, self.rx_data, self.rx_clock})


def low_cut(place: str, fmu: FmuDescription, terminal: FmuTerminal) -> LowCut:
    """The variables of a terminal for operations of CAN.

    Raises:
        FmuFileError: it is none; the message names `place`.
    """
    if terminal.rule != RULE:
        problem = f"is to be connected by the rule '{terminal.rule}', not '{RULE}'"
        raise FmuFileError(place, problem, "ask its supplier for a terminal after FMI-LS-BUS")
    written = binaries(fmu.path)
    for member, causality in _MEMBERS.items():
        _check(place, fmu, terminal, member, causality, written)
    tx_data, tx_clock, rx_data, rx_clock = (terminal.members[member] for member in _MEMBERS)
    if fmu.interface.clocks[rx_clock].kind is not TickInterval.TRIGGERED:
        raise FmuFileError(f"{place}: {rx_clock}", "is no triggered clock", "correct its description")
    for data, clock in ((tx_data, tx_clock), (rx_data, rx_clock)):
        if clock not in fmu.interface.clocked.get(data, ()):
            raise FmuFileError(f"{place}: {data}", f"does not belong to the clock {clock}", "correct its description")
    return LowCut(tx_data, tx_clock, rx_data, rx_clock, _notifications(fmu, terminal), _most(written[rx_data]))


def _check(
    place: str, fmu: FmuDescription, terminal: FmuTerminal, member: str, causality: str, written: Binaries
) -> None:
    """See that a member is there, of its type and causality; data have to be of CAN."""
    port = fmu.interface.ports.get(terminal.members.get(member, ""))
    if port is None:
        raise FmuFileError(place, f"has no member {member} that is a variable", "correct its terminal")
    kind = member.partition("_")[2].replace("Data", "Binary")
    if port.type != kind or (causality and port.causality != causality):
        wanted = f"{kind}, {causality}" if causality else kind
        problem = f"is {port.type}, {port.causality}, not {wanted} as {member} is"
        raise FmuFileError(f"{place}: {port.name}", problem, "correct its terminal")
    mime = written.get(port.name, {}).get("mimeType") or MIME_TYPE
    if mime.partition(";")[0].strip() != MIME_TYPE:
        raise FmuFileError(f"{place}: {port.name}", f"carries {mime}, not {MIME_TYPE}", "put it on a bus of its kind")


def _notifications(fmu: FmuDescription, terminal: FmuTerminal) -> str:
    inner = terminal.inner.get("Configuration")
    name = inner.members.get("BusNotifications", "") if inner else ""
    return next((one for one in (name, _OLD_NOTIFICATIONS) if one in fmu.interface.ports), "")


def _most(written: Mapping[str, str]) -> int | None:
    most = written.get("maxSize", "")
    return int(most) if most.isdigit() else None
