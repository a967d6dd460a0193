"""Streams of a log: the frames of one message that come over one channel from one sender; and what signals are called.

A signal goes by its name in the database where one stream has it, else led by what tells its streams apart:
`can1.speed` comes over channel 1, `sa03.speed` from the sender with the J1939 source address 03.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass

from fmus.errors import DatabaseError
from fmus.words import listed
from orchestrator.can.codec.absence import AbsentError
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.statistics import FrameStatistics


@dataclass(frozen=True)
class FrameStream:
    """Whose frames they are: message, the channel's name, the sender's ("" for messages that have one sender)."""

    message: str
    channel: str
    sender: str = ""


@dataclass(frozen=True)
class Wanted:
    """A signal that is asked for.

    Attributes:
        text: how it is asked for.
        spec: its message.
        name: public name in the database.
        labels: channel or sender that it must come from.
    """

    text: str
    spec: MessageSpec
    name: str
    labels: frozenset[str] = frozenset()

    @property
    def message(self) -> str:
        """Name of its message."""
        return self.spec.name

    def fits(self, stream: FrameStream) -> bool:
        """Whether it may come from there."""
        return stream.message == self.message and self.labels <= {*stream.channel.split("."), stream.sender}


def wanted(log: LogDatabase, names: Iterable[str]) -> list[Wanted]:
    """What these names may mean, in each of the databases.

    Raises:
        DatabaseError: no database has such a signal, or the name is that of several.
    """
    return [found for name in dict.fromkeys(names) for found in _meanings(log, name)]


def channel_name(channel: int, names: Mapping[int, str]) -> str:
    """The name of the channel's interface where the log has one, else `can` and its number."""
    return names.get(channel, f"can{channel}")


class SignalNames:
    """What the signals of the streams in a log are called.

    Args:
        streams: those that are in it -> public names of their signals in the database.
        statistics: of its frames.
        silent: channels that have a database of their own, and no frame.
    """

    def __init__(
        self,
        log: LogDatabase,
        streams: Mapping[FrameStream, Collection[str]],
        statistics: FrameStatistics,
        silent: Sequence[str] = (),
    ) -> None:
        self._log, self._statistics, self._silent = log, statistics, tuple(silent)
        self._streams: dict[str, list[FrameStream]] = {}
        for stream, signals in streams.items():
            for signal in signals:
                self._streams.setdefault(signal, []).append(stream)

    def name(self, stream: FrameStream, signal: str) -> str:
        """The name of a stream's signal."""
        others = self._streams[signal]
        lead = [stream.channel] if len({other.channel for other in others}) > 1 else []
        lead += [stream.sender] if len({other.sender for other in others}) > 1 else []
        return ".".join([*lead, signal])

    def of(self, text: str) -> list[str]:
        """The names of all that somebody may mean who asks for a signal in this way.

        Raises:
            DatabaseError: there is no such signal, or the name is that of several.
        """
        found = (
            self.name(stream, asked.name)
            for asked in wanted(self._log, [text])
            for stream in self._streams.get(asked.name, ())
            if asked.fits(stream)
        )
        return list(dict.fromkeys(found))  # databases of several channels may be one

    def chosen(self, signals: Iterable[str] | None, there: Collection[str], place: str) -> list[str]:
        """The names of these signals, by default of all, of which there are samples.

        Args:
            there: names of signals that have a value in the log.

        Raises:
            AbsentError: there are none, or one that was asked for has none.
        """
        if signals is None:
            messages = [message for database in self._log.databases for message in database.messages]
            names = [self.name(stream, name) for name, streams in self._streams.items() for stream in streams]
            if not (found := [name for name in names if name in there]):
                raise AbsentError(
                    place, "holds no frame of the database", messages=messages, statistics=self._statistics
                )
            return found
        means = {text: [name for name in self.of(text) if name in there] for text in signals}
        if missing := [text for text, names in means.items() if not names]:
            messages = [asked.spec for asked in wanted(self._log, missing)]
            problem = f"holds no frame with the signal {', '.join(missing)}"
            raise AbsentError(place, problem, messages=list(dict.fromkeys(messages)), statistics=self._statistics)
        return list(dict.fromkeys(name for names in means.values() for name in names))

    def notes(self) -> list[str]:
        """Channels without frames, and messages that come in several streams, a line each."""
        told: dict[str, str] = {}
        for signal, streams in self._streams.items():
            names = [self.name(stream, signal) for stream in streams]
            if len(names) > 1 and streams[0].message not in told:
                origins = listed([name.removesuffix(f".{signal}") for name in names], 5, " and ")
                told[streams[0].message] = f"comes from {origins}, which are kept apart as {names[0]}, {names[1]}"
        idle = [f"no frame comes over channel {channel}, which has a database of its own" for channel in self._silent]
        return [*idle, *(f"message {message} {text}" for message, text in told.items())]


def _meanings(log: LogDatabase, text: str) -> list[Wanted]:
    found, problems = [], []
    for database in log.databases:
        try:
            found.append(_meaning(database, text))
        except DatabaseError as problem:
            problems.append(problem)
    if not found:
        raise problems[0]
    return found


def _meaning(database: Database, text: str) -> Wanted:
    """What a name means in a database; what leads it beyond that may be a channel and a sender."""
    parts, problems = text.split("."), []
    for count in range(min(len(parts), 3)):
        try:
            message, signal = database.signal(".".join(parts[count:]))
        except DatabaseError as problem:
            problems.append(problem)
        else:
            return Wanted(text, message, database.public_name(message, signal), frozenset(parts[:count]))
    raise next((problem for problem in problems if "has no signal" not in problem.problem), problems[0])
