"""On which bus a signal is: each channel has its database, and each message its channel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from fmus.errors import DatabaseError, WiringError
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec, SignalSpec


@dataclass(frozen=True)
class MessageLocation:
    """A message on a bus.

    Attributes:
        channel: number of the bus; None where there is only one.
    """

    channel: int | None
    message: MessageSpec

    @property
    def number(self) -> int:
        """Number of the bus."""
        return self.channel or 0

    @property
    def name(self) -> str:
        """The message's name; with that of its channel where there are several."""
        return self.message.name if self.channel is None else f"can{self.channel}.{self.message.name}"


class Locations:
    """Where signals are.

    Args:
        databases: of each channel, in their order.
        homes: message -> its channel; those without one are on the first whose database has them.

    Attributes:
        databases: of each channel.
    """

    def __init__(self, databases: Sequence[Database], homes: Mapping[str, int]) -> None:
        self.databases, self._homes = tuple(databases), dict(homes)
        for name, channel in homes.items():
            self._database(f"can.channel.{name}", channel).message(name)

    def find(self, where: str, name: str, channel: int | None = None) -> tuple[MessageLocation, SignalSpec]:
        """A signal by its name, on the channel that is given, or its message's.

        Raises:
            WiringError: there are not so many channels.
            DatabaseError: no database has it.
        """
        if channel is not None:
            return self._placed(channel, *self._database(where, channel).signal(name))
        problem: DatabaseError | None = None
        for number, database in enumerate(self.databases):
            try:
                message, signal = database.signal(name)
            except DatabaseError as error:
                problem = problem or error
                continue
            home = self._homes.get(message.name, number)
            if home == number:
                return self._placed(number, message, signal)
            problem = problem or DatabaseError(where, f"{message.name} is on channel {home}", "see to `channel`")
        assert problem is not None
        raise problem

    def _placed(self, channel: int, message: MessageSpec, signal: SignalSpec) -> tuple[MessageLocation, SignalSpec]:
        return MessageLocation(channel if len(self.databases) > 1 else None, message), signal

    def _database(self, where: str, channel: int) -> Database:
        count = len(self.databases)
        if channel >= count:
            there = "one is" if count == 1 else f"{count} are"
            problem = f"is on channel {channel}, and {there} given (they count from 0)"
            raise WiringError(where, problem, "give --channel once for each")
        return self.databases[channel]
