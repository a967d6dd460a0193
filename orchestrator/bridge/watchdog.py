"""Looks after the peers: a message that stays away puts its inputs to their safe values, and that is said."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from orchestrator.bridge.inputs import Inlet
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


@dataclass
class _Watch:
    """What is known of a message.

    Attributes:
        heard: when its last frame came, or the coupling began [s].
        since: since when its inputs have their safe values, None while they have received ones [s].
        silent: whether its silence was said.
    """

    inlet: Inlet
    heard: float = 0.0
    since: float | None = 0.0
    silent: bool = False
    first: float | None = None
    frames: int = 0
    silences: int = 0
    at_safe: float = 0.0


class Watchdog:
    """Watches the messages that are received.

    Args:
        say: takes lines for people.

    Attributes:
        events: the first `MOST`; `event_count` counts all.
    """

    def __init__(self, inlets: Sequence[Inlet], say: Callable[[str], None]) -> None:
        self._watches = {each.key: _Watch(each) for each in inlets}
        self._say = say
        self.events: list[Event] = []
        self.event_count = 0

    def heard(self, inlet: Inlet, now: float) -> None:
        """Note a frame that gave its inputs values."""
        watch = self._watches[inlet.key]
        watch.heard = now
        watch.frames += 1
        if watch.since is not None:
            self._recovered(watch, now)

    def check(self, now: float, given: FloatArray) -> None:
        """Put the inputs of every message that has become silent to their safe values."""
        for watch in self._watches.values():
            if not watch.silent and now - watch.heard > watch.inlet.silence:
                self._silent(watch, now, f"no frame for {watch.inlet.silence:g} s")
                watch.inlet.rest(given)

    def lost(self, now: float, why: str, given: FloatArray) -> None:
        """Put the inputs of all messages to their safe values at once."""
        for watch in self._watches.values():
            watch.inlet.rest(given)
            if not watch.silent:
                self._silent(watch, now, why)

    def document(self, now: float) -> dict[str, Any]:
        """What was seen up to now, as plain values; times in seconds since the coupling began."""
        messages = {
            watch.inlet.message.name: {
                "frames": watch.frames,
                "first": watch.first,
                "silence": watch.inlet.silence,
                "silences": watch.silences,
                "at_safe_values": round(watch.at_safe + (0.0 if watch.since is None else now - watch.since), 6),
                "safe": {each.input: each.safe for each in watch.inlet.intakes},
            }
            for watch in self._watches.values()
        }
        return {"messages": messages, "event_count": self.event_count, "events": [asdict(each) for each in self.events]}

    def _recovered(self, watch: _Watch, now: float) -> None:
        assert watch.since is not None
        watch.at_safe += now - watch.since
        watch.since = None
        if watch.first is None:
            watch.first = now
            self._note(watch, now, "first", f"{watch.inlet.message.name} is there" if watch.silent else "")
        else:
            self._note(watch, now, "back", f"{watch.inlet.message.name} is back")
        watch.silent = False

    def _silent(self, watch: _Watch, now: float, why: str) -> None:
        watch.silent = True
        watch.silences += 1
        watch.since = now if watch.since is None else watch.since
        safe = ", ".join(f"{each.input} = {each.safe:g}" for each in watch.inlet.intakes)
        self._note(watch, now, "silent", f"{watch.inlet.message.name}: {why}; safe values: {safe}")

    def _note(self, watch: _Watch, now: float, kind: str, line: str) -> None:
        self.event_count += 1
        if len(self.events) < MOST:
            self.events.append(Event(round(now, 6), watch.inlet.message.name, kind))
        if line and self.event_count <= SAID:
            self._say(f"t = {now:.3f} s: {line}")
            if self.event_count == SAID:
                self._say("the watchdog says no more; all is counted in the manifest")
