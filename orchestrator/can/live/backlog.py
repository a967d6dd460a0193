"""What was sent and still waits for a bus that others keep busy.

Adapters say that they have taken a frame, seldom that it has got out. What others send is heard, so that the time is
known which they leave; in that, frames get out. They are heard in bunches, and late: the time that was left at an
instant is what remains of it when all has been heard of that others sent by then, known but for the time between two
looks.
"""

from __future__ import annotations

import math
from collections import Counter, deque
from itertools import pairwise
from typing import NamedTuple

import can

from orchestrator.can.live.bus import BusSettings, occupied
from orchestrator.can.slcan.flow import Key

_HEARD = 0.1  # by when a frame has been heard after its end, where somebody looks [s]
_PAUSE = 0.03  # what counts of a time in which nobody looked [s]
_APART = 0.0005  # looks that are kept [s]


class _Waiting(NamedTuple):
    """A frame that was given at an instant, its time on the bus, and the free time at which it is out, once known."""

    key: Key
    given: float
    seconds: float
    out: float = math.inf


class _Look(NamedTuple):
    """An instant, and the attended and the free time until then."""

    instant: float
    attended: float
    free: float


class Backlog:
    """An estimate from the frames on a bus; none where its bit rate is not known.

    Times are those of one clock [s].
    """

    def __init__(self, settings: BusSettings) -> None:
        self._settings = settings
        self._now: float | None = None
        self._free = 0.0  # time that others have left until now, as far as heard
        self._attended = 0.0  # time in which somebody looked
        self._passing = 0.0  # the longest frame of others: the one that is just passing has not been heard
        self._left = self._until = 0.0  # ... for certain, and until when: `_HEARD` ago
        self._looks: deque[_Look] = deque()  # of the last `_HEARD`
        self._given: deque[_Waiting] = deque()  # since `_until`
        self._waiting: deque[_Waiting] = deque()  # those before
        self._done = 0.0  # the free time at which the last of those is out

    def sent(self, frame: can.Message, now: float) -> None:
        """A frame of ours was taken."""
        if seconds := occupied(frame, self._settings):
            key = frame.arbitration_id, frame.is_extended_id
            self._given.append(_Waiting(key, now, seconds))

    def heard(self, frame: can.Message) -> None:
        """Somebody else's frame has passed."""
        seconds = occupied(frame, self._settings)
        self._free -= seconds
        self._passing = max(self._passing, seconds)

    def look(self, now: float) -> None:
        """Let out what there was time for until now."""
        if self._now is None:
            self._free, self._now = 0.0, now
        self._free = max(self._left - self._passing, self._free + now - self._now)
        self._attended += min(now - self._now, _PAUSE)
        self._now = now
        self._keep(now)
        self._until, self._left = self._looks[0].instant, max(self._left, min(look.free for look in self._looks))
        self._let_out()

    def empty(self) -> bool:
        """Whether all has got out."""
        return not self._waiting and not self._given

    def age(self) -> float:
        """For how long something has waited, as far as all has been heard."""
        return self._until - self._waiting[0].given if self._waiting else 0.0

    def waiting(self) -> Counter[Key]:
        """Identifier -> frames that have not got out."""
        return Counter(frame.key for frame in (*self._waiting, *self._given))

    def clear(self) -> None:
        """Nothing waits any more: the adapter has forgotten it."""
        self._waiting.clear()
        self._given.clear()
        self._done = self._left

    def _keep(self, now: float) -> None:
        """Keep the looks since `_HEARD` ago, and the last one before."""
        if len(self._looks) > 1 and now - self._looks[-1].instant < _APART:
            look = self._looks.pop()
            self._looks.append(look._replace(free=min(look.free, self._free)))
        else:
            self._looks.append(_Look(now, self._attended, self._free))
        while len(self._looks) > 1 and self._looks[1].attended <= self._attended - _HEARD:
            self._looks.popleft()

    def _let_out(self) -> None:
        while self._given and self._given[0].given <= self._until:
            frame = self._given.popleft()
            self._done = max(self._left, self._done) + frame.seconds
            self._waiting.append(frame._replace(given=self._until, out=self._done))
        gaps = [b.attended - a.attended for a, b in pairwise(self._looks)]
        apart = max((gap for gap in gaps if gap < 0.99 * _PAUSE), default=_PAUSE)  # but for pauses
        while self._waiting and self._waiting[0].out <= self._left - self._passing - apart:
            self._waiting.popleft()
