"""Looks after the peers: a message that stays away puts its inputs to their safe values, and that is said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.bridge.inputs import ReceivedMessage
from orchestrator.trace import FloatArray

MOST = 1000  # events that are kept; beyond it they are only counted
SAID = 50  # events that are said


@dataclass(frozen=True)
class Event:
    """What the watchdog saw.

    Attributes:
        time: since the coupling began [s].
        kind: "first", "silent" or "back".
    """

    time: float
    message: str
    kind: str


@dataclass(frozen=True)
class PeerPresence:
    """How a message was there; times since the coupling began [s].

    Attributes:
        frames: that gave inputs values.
        first: when the first of them came, None where none did.
        silence: how long no frame may come; silences: how often none came for longer.
        at_safe_values: how long its inputs had their safe values.
        safe: component.input -> its safe value [unit of the input].
    """

    frames: int
    first: float | None
    silence: float
    silences: int
    at_safe_values: float
    safe: dict[str, float]

    def remark(self, name: str) -> str:
        """What somebody should know about the silence of the message of this name."""
        if self.first is None:
            return f"{name} never came; its inputs had their safe values"
        times = "once" if self.silences == 1 else f"{self.silences:,} times"
        return f"{name} was silent {times}; its inputs had their safe values for {self.at_safe_values:.3g} s in all"


@dataclass(frozen=True)
class WatchdogReport:
    """What was seen: messages by their names, and the first events of all that were counted."""

    messages: dict[str, PeerPresence]
    event_count: int
    events: list[Event]


@dataclass
class _Watch:
    """What is known of a message.

    Attributes:
        heard: when its last frame came, or the coupling began [s].
        since: since when its inputs have their safe values, None while they have received ones [s].
        silent: whether its silence was said.
    """

    message: ReceivedMessage
    heard: float = 0.0
    since: float | None = 0.0
    silent: bool = False
    first: float | None = None
    frames: int = 0
    silences: int = 0
    at_safe: float = 0.0

    @property
    def name(self) -> str:
        return self.message.spec.name

    def presence(self, now: float) -> PeerPresence:
        """What there is to be told of it now [s]."""
        at_safe = round(self.at_safe + (0.0 if self.since is None else now - self.since), 6)
        safe = {signal.input: signal.safe for signal in self.message.signals}
        return PeerPresence(self.frames, self.first, self.message.silence, self.silences, at_safe, safe)


class Watchdog:
    """Watches the messages that are received.

    Args:
        say: takes lines for people.

    Attributes:
        events: the first `MOST`; `event_count` counts all.
    """

    def __init__(self, messages: Sequence[ReceivedMessage], say: Callable[[str], None]) -> None:
        self._watches = {message.key: _Watch(message) for message in messages}
        self._say = say
        self.events: list[Event] = []
        self.event_count = 0

    def heard(self, message: ReceivedMessage, now: float) -> None:
        """Note a frame that gave its inputs values."""
        watch = self._watches[message.key]
        watch.heard = now
        watch.frames += 1
        if watch.since is not None:
            self._recovered(watch, now)

    def check(self, now: float, inputs: FloatArray) -> None:
        """Put the inputs of every message that has become silent to their safe values."""
        for watch in self._watches.values():
            if not watch.silent and now - watch.heard > watch.message.silence:
                self._silent(watch, now, f"no frame for {watch.message.silence:g} s")
                watch.message.give_safe_values(inputs)

    def lost(self, now: float, why: str, inputs: FloatArray) -> None:
        """Put the inputs of all messages to their safe values at once."""
        for watch in self._watches.values():
            watch.message.give_safe_values(inputs)
            if not watch.silent:
                self._silent(watch, now, why)

    def report(self, now: float) -> WatchdogReport:
        """What was seen up to now [s since the coupling began]."""
        messages = {watch.name: watch.presence(now) for watch in self._watches.values()}
        return WatchdogReport(messages, self.event_count, list(self.events))

    def _recovered(self, watch: _Watch, now: float) -> None:
        assert watch.since is not None
        watch.at_safe += now - watch.since
        watch.since = None
        if watch.first is None:
            watch.first = now
            self._note(watch, now, "first", f"{watch.name} is there" if watch.silent else "")
        else:
            self._note(watch, now, "back", f"{watch.name} is back")
        watch.silent = False

    def _silent(self, watch: _Watch, now: float, why: str) -> None:
        watch.silent = True
        watch.silences += 1
        watch.since = now if watch.since is None else watch.since
        safe = ", ".join(f"{signal.input} = {signal.safe:g}" for signal in watch.message.signals)
        self._note(watch, now, "silent", f"{watch.name}: {why}; safe values: {safe}")

    def _note(self, watch: _Watch, now: float, kind: str, line: str) -> None:
        self.event_count += 1
        if len(self.events) < MOST:
            self.events.append(Event(round(now, 6), watch.name, kind))
        if line and self.event_count <= SAID:
            self._say(f"t = {now:.3f} s: {line}")
            if self.event_count == SAID:
                self._say("the watchdog says no more; all is counted in the manifest")
