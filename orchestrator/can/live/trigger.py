"""From when to when frames of a bus are recorded: conditions on signals, and a time before the first of them."""

from __future__ import annotations

import math
import operator
import re
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import can

from fmus.errors import DatabaseError, InputError
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database

MOST = 1 << 20  # frames that are kept of the time before
_COMPARISONS: Mapping[str, Callable[[float, float], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_FORM = re.compile(r"\s*([^<>=!]*[^<>=!\s])\s*(<=|>=|==|!=|<|>)\s*(\S+)\s*")


@dataclass(frozen=True)
class RecordingLimits:
    """From when to when is recorded.

    Attributes:
        start, stop: conditions as `speed > 10`, in the signal's unit; None without.
        before: how long before `start` holds frames are kept [s].
    """

    start: str | None = None
    stop: str | None = None
    before: float = 0.0


EVERYTHING = RecordingLimits()


class TriggerCondition:
    """A comparison of a signal with a number, as `State.angle >= 0.5`; frames without the signal do not meet it.

    Raises:
        InputError: it is not of that form.
        DatabaseError: no database of the channels has such a signal.
    """

    def __init__(self, text: str, log: LogDatabase, channels: Sequence[str]) -> None:
        self._name, self._compare, self._number = _parsed(text)
        self._decoders: dict[tuple[int, int, bool], tuple[SingleDecoder, str]] = {}
        problem: DatabaseError | None = None
        for number, channel in enumerate(channels):
            database = log.of(number, channel)
            try:
                if database is not None:
                    self._add(number, database)
            except DatabaseError as error:
                problem = error
        if not self._decoders:
            raise problem or InputError(text, "is of a channel without a database", "give --dbc")

    def holds(self, message: can.Message) -> bool:
        """Whether the frame has the signal, with such a value."""
        found = self._decoders.get((message.channel, message.arbitration_id, message.is_extended_id))  # type: ignore[arg-type]
        if found is None:
            return False
        decoder, name = found
        value = (decoder.decode(message) or {}).get(name)
        return value is not None and self._compare(value, self._number)

    def _add(self, channel: int, database: Database) -> None:
        message, signal = database.signal(self._name)
        if message.of_any_sender:
            problem = f"its identifier 0x{message.id:X} lacks the sender's address, so no frame has it"
            raise DatabaseError(f"message {message.name}", problem, "give a database with the address")
        name = database.public_name(message, signal)
        self._decoders[channel, message.id, message.extended] = SingleDecoder(database, [name]), name


class Trigger:
    """Lets frames pass from one that meets a condition to a later one that meets another.

    Attributes:
        limits: the conditions.
        started, stopped: stamps of these frames [s], None before; `started` is that of the first frame where no
            condition is waited for.
        watched: frames that came before it started.
        overrun: of these, frames of the time before that were too many to be kept.
    """

    KEYS = ("limits.start", "limits.stop", "limits.before", "started", "stopped", "watched", "overrun")

    def __init__(self, limits: RecordingLimits, log: LogDatabase | None, channels: Sequence[str]) -> None:
        """Raises InputError or DatabaseError where a condition cannot be understood."""
        self.limits = limits
        if not 0 <= limits.before < math.inf:
            raise InputError("--pre", f"is {limits.before:g}", "give a number of seconds")
        if limits.before and not limits.start:
            raise InputError("--pre", "is the time before a condition, and there is none", "give --start-when, too")
        self._start, self._stop = (_condition(text, log, channels) for text in (limits.start, limits.stop))
        self._ring: deque[can.Message] = deque()
        self.started: float | None = None
        self.stopped: float | None = None
        self.watched = self.overrun = 0

    @property
    def waiting(self) -> bool:
        """Whether the condition to start has not held yet."""
        return self._start is not None and self.started is None

    def passed(self, messages: Sequence[can.Message]) -> list[can.Message]:
        """What of these frames, and of those before, is to be recorded."""
        found: list[can.Message] = []
        for message in messages:
            if self.stopped is not None:
                break
            if not self.waiting:
                found.append(message)
                self.started = message.timestamp if self.started is None else self.started
                if self._stop is not None and self._stop.holds(message):
                    self.stopped = message.timestamp
            elif self._starts(message):
                self.started = message.timestamp
                found += self._ring
                self._ring.clear()
        return found

    def _starts(self, message: can.Message) -> bool:
        """Keep the frame; whether it is the first that meets the condition."""
        assert self._start is not None
        ring = self._ring
        ring.append(message)
        while ring[0].timestamp < message.timestamp - self.limits.before:
            ring.popleft()
        if len(ring) > MOST:
            ring.popleft()
            self.overrun += 1
        starts = self._start.holds(message)
        self.watched += not starts
        return starts

    def remarks(self) -> list[str]:
        """What somebody should know, a line each."""
        told = {
            f"'{self.limits.stop}' held, which ended it": self.stopped is not None,
            f"'{self.limits.start}' has never held in {self.watched:,} frames, so none was recorded": self.waiting,
            f"of the time before the start {self.overrun:,} frames were too many to be kept": self.overrun,
        }
        return [line for line, holds in told.items() if holds]


def _condition(text: str | None, log: LogDatabase | None, channels: Sequence[str]) -> TriggerCondition | None:
    if text is None:
        return None
    if log is None:
        raise InputError(text, "is of a signal, and there is no database", "give --dbc")
    return TriggerCondition(text, log, channels)


def _parsed(text: str) -> tuple[str, Callable[[float, float], bool], float]:
    match = _FORM.fullmatch(text)
    try:
        if match is not None and not math.isnan(number := float(match[3])):
            return match[1].strip(), _COMPARISONS[match[2]], number
    except ValueError:  # no number
        pass
    raise InputError(f"condition '{text}'", "is not understood", "write SIGNAL < NUMBER, or <=, >, >=, ==, !=")
