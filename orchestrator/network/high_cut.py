"""Nodes that exchange signals, FMI-LS-BUS' physical signal abstraction ("high cut"): their frames by a database.

A terminal of the FMU stands for a bus, one within it for a frame, with the clock that sends or receives it, and one in
that for its signals.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from fmus.errors import FmuFileError
from orchestrator.can.database.database import Database, load
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.crossing import Crossing, crossing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.terminals import FmuTerminal

FRAME = "org.fmi-ls-bus.frame-terminal"
FOLDER = "extra/org.fmi-standard.fmi-ls-bus"


@dataclass(frozen=True)
class CarriedSignal:
    """A variable and the signal that it is.

    Attributes:
        crossing: from the unit of what gives it to that of what takes it.
    """

    variable: str
    signal: SignalSpec
    crossing: Crossing


@dataclass(frozen=True)
class CarriedFrame:
    """A frame that goes out, or comes in, when a clock ticks."""

    message: MessageSpec
    clock: str
    sent: bool
    signals: tuple[CarriedSignal, ...]

    @property
    def variables(self) -> list[str]:
        """Of its signals."""
        return [signal.variable for signal in self.signals]


@dataclass(frozen=True)
class HighCut:
    """The frames of a terminal, and the database that they are in."""

    frames: tuple[CarriedFrame, ...]
    database: Database

    @property
    def carried(self) -> frozenset[str]:
        """What the bus sees to."""
        return frozenset(name for frame in self.frames for name in (frame.clock, *frame.variables))


def high_cut(place: str, fmu: FmuFile, terminal: FmuTerminal, given: Path | None) -> HighCut:
    """The frames of a terminal.

    Args:
        given: the database of the bus; without one the FMU has to bring its own along.

    Raises:
        FmuFileError: it is no such terminal, or does not fit the database; the message names `place`.
        DatabaseError: the database cannot be read, or the FMU's own is another than the bus'.
    """
    own = fmu.folder / FOLDER / f"{terminal.name}.dbc"
    if given is None and not own.is_file():
        problem = f"exchanges signals, and brings no {terminal.name}.dbc that says how they lie in frames"
        raise FmuFileError(place, problem, "give the bus a `database`")
    database = load(given or own)
    frames = [inner for inner in terminal.inner.values() if inner.kind == FRAME]
    if not frames:
        raise FmuFileError(place, "has no frames", "ask its supplier for a terminal after FMI-LS-BUS")
    if given is not None and own.is_file():
        _agree(place, database, load(own), [frame.name for frame in frames])
    return HighCut(tuple(_frame(place, fmu, frame, database) for frame in frames), database)


def _agree(place: str, database: Database, own: Database, names: Sequence[str]) -> None:
    """See that frames are the same in both databases."""
    for name in names:
        one, other = database.message(name), own.message(name)
        if not one.is_like(other) or (one.id, one.extended) != (other.id, other.extended):
            problem = f"lies otherwise in {database.path} than in the FMU's own {Path(own.path).name}"
            raise FmuFileError(f"{place}: {name}", problem, "give the bus the database that the FMU was made for")


def _frame(place: str, fmu: FmuFile, terminal: FmuTerminal, database: Database) -> CarriedFrame:
    place = f"{place}: {terminal.name}"
    message, interface = database.message(terminal.name), fmu.interface
    clocks = [interface.clocks[name] for name in terminal.members.values() if name in interface.clocks]
    if len(clocks) != 1:
        raise FmuFileError(place, f"has {len(clocks)} clocks, and a frame has one", "correct its terminal")
    members = {name: variable for pdu in terminal.inner.values() for name, variable in pdu.members.items()}
    if missing := sorted({signal.name for signal in message.signals} ^ members.keys()):
        whose = "its terminal" if missing[0] not in members else database.path
        raise FmuFileError(f"{place}.{missing[0]}", f"is not in {whose}", "have terminal and database agree")
    sent = clocks[0].causality == "output"
    signals = [_signal(place, fmu, message.signal(name), variable, sent) for name, variable in members.items()]
    return CarriedFrame(message, clocks[0].name, sent, tuple(signals))


def _signal(place: str, fmu: FmuFile, signal: SignalSpec, variable: str, sent: bool) -> CarriedSignal:
    port = fmu.interface.ports.get(variable)
    causality = "output" if sent else "input"
    if port is None or not port.numeric or port.causality != causality:
        found = "no variable" if port is None else f"{port.type}, {port.causality}"
        raise FmuFileError(f"{place}.{signal.name}", f"is {found}, not an {causality} that is a number", "correct it")
    ends = port.measure, port.meaning(signal.unit)
    return CarriedSignal(variable, signal, crossing(f"{place}.{signal.name}", *(ends if sent else ends[::-1])))


def by_identifier(frames: Sequence[CarriedFrame]) -> Mapping[tuple[int, bool], CarriedFrame]:
    """Those that are received, by their identifier and whether that is an extended one."""
    return {(frame.message.id, frame.message.extended): frame for frame in frames if not frame.sent}
