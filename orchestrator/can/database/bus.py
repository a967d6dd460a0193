"""What the frames of a whole log mean: the databases of its channels."""

from __future__ import annotations

from collections.abc import Mapping

from orchestrator.can.database.database import Database, load, merged
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.database.sources import ALL, DatabaseFiles, by_channel

MOST = 20  # notes


class LogDatabase:
    """The databases of a log.

    Attributes:
        everywhere: of all channels that have none of their own; None where those have none.
        own: of single channels, by number or interface name.
    """

    def __init__(self, everywhere: Database | None, own: Mapping[str, Database] | None = None) -> None:
        self.everywhere, self.own = everywhere, dict(own or {})

    @property
    def databases(self) -> list[Database]:
        """All of them."""
        return [*self.own.values(), *([self.everywhere] if self.everywhere else [])]

    @property
    def notes(self) -> list[str]:
        """What is not as in the files, a line each."""
        found = list(dict.fromkeys(note for database in self.databases for note in database.notes))
        return found[:MOST] + (
            [f"and {len(found) - MOST} more that is not as in the databases"] if found[MOST:] else []
        )

    def message(self, name: str) -> tuple[Database, MessageSpec]:
        """The message of that name, of the first database that has it.

        Raises:
            DatabaseError: there is none.
        """
        own = next((base for base in self.databases if any(name == message.name for message in base.messages)), None)
        database = own or self.databases[0]
        return database, database.message(name)

    def of(self, channel: int, name: str) -> Database | None:
        """That of a channel, which has this number from 0 and this name."""
        return self.own.get(name) or self.own.get(str(channel)) or self.everywhere


def load_all(files: DatabaseFiles, encoding: str | None = None, j1939: bool = False) -> LogDatabase:
    """The databases in these files; a channel's own go before those of all channels.

    Args:
        encoding, j1939: of all of them; see `load`.

    Raises:
        DatabaseError: one cannot be read.
    """
    read = {
        channel: [load(path, encoding=encoding, j1939=j1939) for path in own]
        for channel, own in by_channel(files).items()
    }
    everywhere = read.pop(ALL, [])
    own = {channel: merged([*given, *everywhere]) for channel, given in read.items()}
    return LogDatabase(merged(everywhere) if everywhere else None, own)
