"""Looks after the peers: a signal that stays away puts its input to its safe value, and that is said."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass

from orchestrator.bridge.signals.inputs import ReceivedMessage, ReceivedSignal, TakenFrame
from orchestrator.trace import FloatArray

MOST = 1000  # events that are kept; beyond it they are only counted
SAID = 50  # events that are said


@dataclass(frozen=True)
class WatchdogEvent:
    """What the watchdog saw.

    Attributes:
        time: since the coupling began [s].
        name: message, or signal where others of its message go on.
        kind: "first", "silent" or "back" of what is received, "rests" or "runs" of what is sent, "alarm".
    """

    time: float
    name: str
    kind: str


@dataclass(frozen=True)
class PeerPresence:
    """How a message was there; times since the coupling began [s].

    Attributes:
        frames: that gave inputs values.
        first: when all its inputs had one, None where not all ever did.
        silence: how long no good value may come; silences: how often one of its inputs had none for longer.
        at_safe_values: how long one of its inputs had its safe value.
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
            return f"{name} never came{' whole' if self.frames else ''}; its inputs had their safe values"
        times = "once" if self.silences == 1 else f"{self.silences:,} times"
        return f"{name} was silent {times}; its inputs had their safe values for {self.at_safe_values:.3g} s in all"


@dataclass(frozen=True)
class WatchdogReport:
    """What was seen: messages by their names, and the first events of all that were counted."""

    messages: dict[str, PeerPresence]
    event_count: int
    events: list[WatchdogEvent]


@dataclass(eq=False)
class _Watch:
    """What is known of a signal.

    Attributes:
        heard: when its last good value came, or the coupling began [s].
        back: when the first one came after its last silence [s].
        since: since when its input has its safe value, None while it has received ones [s].
        silent: whether its silence was said.
        fault: what is wrong with the frames that come, "" while they are good or none come.
    """

    message: ReceivedMessage
    signal: ReceivedSignal
    heard: float = 0.0
    back: float = 0.0
    since: float | None = 0.0
    silent: bool = False
    first: float | None = None
    silences: int = 0
    at_safe: float = 0.0
    fault: str = ""

    @property
    def overdue(self) -> str:
        """What is said of it when it is silent."""
        limit = f"{self.message.silence:g} s"
        return f"no good value for {limit} ({self.fault})" if self.fault else f"no frame for {limit}"

    def at_safe_values(self, now: float) -> float:
        """For how long until now [s]."""
        return self.at_safe + (0.0 if self.since is None else max(now - self.since, 0.0))  # a frame may be older


class Watchdog:
    """Watches the signals that are received.

    Args:
        say: takes lines for people.

    Attributes:
        resting: inputs that have their safe values.
        events: the first `MOST`; `event_count` counts all.
    """

    def __init__(self, messages: Sequence[ReceivedMessage], say: Callable[[str], None]) -> None:
        self._watches = {signal: _Watch(message, signal) for message in messages for signal in message.signals}
        self._messages, self._frames = tuple(messages), dict.fromkeys((message.name for message in messages), 0)
        self._say = say
        self.resting = {signal.input for signal in self._watches}
        self.events: list[WatchdogEvent] = []
        self.event_count = 0

    def took(self, taken: TakenFrame, now: float) -> None:
        """Note what came of a frame."""
        for signal, fault in taken.faults.items():
            self._watches[signal].fault = fault
        self._frames[taken.message.name] += bool(taken.good)
        recovered = []
        for watch in map(self._watches.__getitem__, taken.good):
            watch.heard, watch.fault = now, ""
            if watch.since is not None:
                recovered.append(watch)
        if recovered:
            self._recovered(recovered, now)

    def check(self, now: float, inputs: FloatArray) -> bool:
        """Put every input whose signal has become silent to its safe value; whether one had been there before."""
        overdue = [
            watch for watch in self._watches.values() if not watch.silent and now - watch.heard > watch.message.silence
        ]
        for why, group in _alike(overdue, lambda watch: watch.overdue):
            self._silent(group, now, why, inputs)
        return any(watch.first is not None for watch in overdue)

    def proven(self, inputs: Collection[str], after: float) -> bool:
        """Whether from the first good value of each of these inputs since its last silence to its latest one it was so
        long [s]."""
        watches = (watch for watch in self._watches.values() if watch.signal.input in inputs)
        return all(watch.heard - watch.back >= after for watch in watches)

    def lost(self, now: float, why: str, inputs: FloatArray, bus: int = 0) -> None:
        """Put all inputs of a bus to their safe values at once."""
        watches = [watch for watch in self._watches.values() if watch.message.place.number == bus]
        for watch in watches:
            inputs[watch.signal.place] = watch.signal.safe
        for _, group in _alike([watch for watch in watches if not watch.silent], lambda watch: why):
            self._silent(group, now, why, inputs)

    def report(self, now: float) -> WatchdogReport:
        """What was seen up to now [s since the coupling began]."""
        messages = {message.name: self._presence(message, now) for message in self._messages}
        return WatchdogReport(messages, self.event_count, list(self.events))

    def note(self, now: float, name: str, kind: str, line: str) -> None:
        """Keep an event, and say it where there is a line."""
        self.event_count += 1
        if len(self.events) < MOST:
            self.events.append(WatchdogEvent(round(now, 6), name, kind))
        if line and self.event_count <= SAID:
            self._say(f"t = {now:.3f} s: {line}")
            if self.event_count == SAID:
                self._say("the watchdog says no more; all is counted in the manifest")

    def _presence(self, message: ReceivedMessage, now: float) -> PeerPresence:
        watches = [self._watches[signal] for signal in message.signals]
        firsts = [watch.first for watch in watches if watch.first is not None]
        return PeerPresence(
            self._frames[message.name],
            max(firsts) if len(firsts) == len(watches) else None,
            message.silence,
            max(watch.silences for watch in watches),
            round(max(watch.at_safe_values(now) for watch in watches), 6),
            {signal.input: signal.safe for signal in message.signals},
        )

    def _recovered(self, watches: list[_Watch], now: float) -> None:
        back = [watch for watch in watches if watch.first is not None]
        first = [watch for watch in watches if watch.first is None]
        said = [watch for watch in first if watch.silent]
        for watch in watches:
            watch.at_safe, watch.since = watch.at_safe_values(now), None
            watch.first = now if watch.first is None else watch.first
            watch.back = now
            watch.silent = False
            self.resting.discard(watch.signal.input)
        if first:
            self.note(now, _name(first), "first", f"{_name(first)} is there" if said else "")
        if back:
            self.note(now, _name(back), "back", f"{_name(back)} is back")

    def _silent(self, watches: list[_Watch], now: float, why: str, inputs: FloatArray) -> None:
        for watch in watches:
            watch.silent = True
            watch.silences += 1
            watch.since = now if watch.since is None else watch.since
            inputs[watch.signal.place] = watch.signal.safe
            self.resting.add(watch.signal.input)
        safe = ", ".join(f"{watch.signal.input} = {watch.signal.safe:g}" for watch in watches)
        self.note(now, _name(watches), "silent", f"{_name(watches)}: {why}; safe values: {safe}")


def _alike(watches: Iterable[_Watch], of: Callable[[_Watch], str]) -> Iterator[tuple[str, list[_Watch]]]:
    """Watches of one message with the same text."""
    groups: dict[tuple[str, str], list[_Watch]] = {}
    for watch in watches:
        groups.setdefault((watch.message.name, of(watch)), []).append(watch)
    return ((text, group) for (_, text), group in groups.items())


def _name(watches: Sequence[_Watch]) -> str:
    """The message of these, or the signals where they are not all of it."""
    message = watches[0].message
    whole = len(watches) == len(message.signals)
    return message.name if whole else ", ".join(watch.signal.name for watch in watches)
