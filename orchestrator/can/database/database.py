"""A CAN database: which messages there are, and what signals lie in their bytes.

Any file that cantools reads, with what is sound in it; what is not is left out and told. AUTOSAR's container messages
are not taken apart: a container has no signals of its own.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.errors import DatabaseError
from orchestrator.can.database import addressing, reading
from orchestrator.can.database.addressing import CANOPEN, Addressing
from orchestrator.can.database.interpretation import specification
from orchestrator.can.database.message import LeftOut, MessageSpec, SignalSpec, instead
from orchestrator.can.database.sources import file_and_bus


class Database:
    """Messages by name and identifier, signals by name.

    Of messages with one identifier the first is used. Of different ones with one name the later are called by name and
    identifier, as `State_101`.

    Attributes:
        path: the file, or what stands for several in messages.
        left_out: messages and signals that are not used.
        read_notes: what else came up in reading, a line each.
    """

    def __init__(
        self,
        path: Path | str,
        messages: Iterable[MessageSpec],
        left_out: Sequence[LeftOut] = (),
        notes: Sequence[str] = (),
    ) -> None:
        self.path = path
        self._by_name: dict[str, MessageSpec] = {}
        self._by_id: dict[tuple[int, bool], MessageSpec] = {}
        self._owners: dict[str, list[MessageSpec]] = {}
        self.left_out, self.read_notes = [*left_out], [*notes]
        for message in messages:
            self._add(message)
        self.messages = tuple(self._by_name.values())

    @property
    def notes(self) -> tuple[str, ...]:
        """What is not as in the file, a line each."""
        place = self.path.name if isinstance(self.path, Path) else self.path
        found = [*self.read_notes, *map(str, self.left_out)]
        for message in self.messages:
            found += [f"signal {message.name}.{name} is left out: {why}" for name, why in message.left_out.items()]
            found += [f"message {message.name}: {note}" for note in message.notes]
        return tuple(f"{place}: {note}" for note in found)

    def message(self, name: str) -> MessageSpec:
        """The message of that name.

        Raises:
            DatabaseError: there is none; close names are listed.
        """
        if name not in self._by_name:
            if lost := next((lost for lost in self.left_out if lost.message == name), None):
                raise DatabaseError(self.path, str(lost), "correct the database")
            raise DatabaseError(self.path, f"has no message '{name}'", instead(name, self._by_name))
        return self._by_name[name]

    def signal(self, name: str) -> tuple[MessageSpec, SignalSpec]:
        """A signal by its own name where that is unique, or as Message.signal.

        Raises:
            DatabaseError: there is none, or the name alone is that of signals in several messages.
        """
        owner, dot, own = name.rpartition(".")
        if dot and owner in self._by_name:
            if lost := self._lost(name):
                raise lost
            return self._by_name[owner], self._own(self._by_name[owner], own)
        owners = self._owners.get(name, [])
        if len(owners) > 1:
            full = " or ".join(f"'{owner.name}.{name}'" for owner in owners[:5])
            raise DatabaseError(self.path, f"signal '{name}' is in {len(owners)} messages", f"write {full}")
        if not owners:
            raise self._missing(name)
        return owners[0], owners[0].signal(name)

    def public_name(self, message: MessageSpec, signal: SignalSpec) -> str:
        """The signal's own name where no other message has it, else Message.signal."""
        return signal.name if len(self._owners[signal.name]) == 1 else f"{message.name}.{signal.name}"

    def changed(self, messages: Iterable[MessageSpec]) -> Database:
        """The same database with other messages."""
        return Database(self.path, messages, self.left_out, self.read_notes)

    def _add(self, message: MessageSpec) -> None:
        identity = (message.id, message.extended)
        same = self._by_id.get(identity)
        if same is not None:
            if not same.is_like(message):
                why = f"it has the identifier 0x{message.id:X} of {same.name}, which is used"
                self.left_out.append(LeftOut(message.name, why, tuple(signal.name for signal in message.signals)))
            return
        if message.name in self._by_name:
            other = f"{message.name}_{message.id:X}"
            self.read_notes.append(f"message {message.name} of the identifier 0x{message.id:X} is called {other} here")
            message = replace(message, name=other)
        self._by_name[message.name] = self._by_id[identity] = message
        for signal in message.signals:
            self._owners.setdefault(signal.name, []).append(message)

    def _lost(self, name: str) -> DatabaseError | None:
        """Why there is no such signal any more, where there was one."""
        for lost in self.left_out:
            if name in lost.signals or name in {f"{lost.message}.{signal}" for signal in lost.signals}:
                why = str(lost) if not lost.whole else f"signal '{name}' is in {lost}"
                return DatabaseError(
                    self.path, why.replace(" is left out", ", which is left out"), "correct the database"
                )
        return None

    def _missing(self, name: str) -> DatabaseError:
        if lost := self._lost(name):
            return lost
        for message in self.messages:
            if name in message.left_out:
                return DatabaseError(
                    f"{self.path}: {message.name}.{name}", f"is left out: {message.left_out[name]}", "correct it"
                )
        known = [*self._owners, *(f"{m.name}.{s.name}" for m in self.messages for s in m.signals)]
        return DatabaseError(self.path, f"has no signal '{name}'", instead(name, known))

    def _own(self, message: MessageSpec, name: str) -> SignalSpec:
        """The message's signal; without it the error names the file too."""
        try:
            return message.signal(name)
        except DatabaseError as error:
            raise DatabaseError(f"{self.path}: {error.place}", error.problem, error.fix) from None


def load(path: Path, *, encoding: str | None = None, j1939: bool = False) -> Database:
    """The database of a .dbc, .arxml, .kcd, .sym, .eds or .dcf file; its text in this `encoding`, or as it seems.

    Args:
        path: the file, or one bus of it, as `car.kcd#Body`.
        j1939: its extended identifiers are J1939's, also where the file does not say so.

    Raises:
        DatabaseError: it cannot be read, or defines no message; file and line are named.
    """
    path, bus = file_and_bus(Path(path))
    read = reading.of_bus(path, reading.read(path, encoding), bus)
    if not read.messages:
        why = "".join(f" that can be used: {lost}" for lost in read.left_out[:1])
        raise DatabaseError(path, f"defines no messages{why}", "export it again")
    messages, left_out = [], [*read.left_out]
    for message in read.messages:
        try:
            messages.append(specification(message, _addressing(message, read, j1939)))
        except (TypeError, ValueError, ArithmeticError) as problem:  # cantools has taken what is no name or number
            why = f"it is not defined as a message is ({problem})"
            left_out.append(LeftOut(str(message.name), why, tuple(str(signal.name) for signal in message.signals)))
    return Database(path, messages, left_out, read.notes)


def _addressing(message: Any, read: reading.Read, is_j1939: bool) -> Addressing | None:
    if message.name in read.of_any_node:
        return CANOPEN
    grouped = is_j1939 or read.j1939 or message.protocol == "j1939"
    return addressing.j1939(message.frame_id) if message.is_extended_frame and grouped else None


def merged(databases: Sequence[Database]) -> Database:
    """Several databases of one bus as one; what the first has the others do not change."""
    if len(databases) == 1:
        return databases[0]
    place = " and ".join(str(database.path) for database in databases)
    return Database(
        place,
        (message for database in databases for message in database.messages),
        [lost for database in databases for lost in database.left_out],
        [note for database in databases for note in database.read_notes],
    )
