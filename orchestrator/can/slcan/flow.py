"""What an adapter has been given and has answered to: which frames it took, and whether it still takes any."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

Key = tuple[int, bool]  # identifier, and whether it is an extended one

STALL = 0.1  # for which an adapter may answer nothing while it owes answers [s]
LATE = 0.05  # ... while it owes one to a frame of the message that is to be sent, which is an old command, at most [s]
_PROMPT, _TIMES = 0.02, 3.0  # at least [s], and in between so many times as long as it takes on average
_SHARE = 0.05  # of the latest answer in that average
_KEPT = 1 << 16  # frames without an answer; one that never answers takes no more memory


class Flow:
    """Frames on their way into an adapter that answers to each, in order; times are those of one clock [s].

    Attributes:
        answers: whether it answers to frames, which is expected of one that answers to questions; some never do.
        taken: identifier -> frames that it took.
        refused: frames that it did not take (BEL).
        refusing: since when it has refused all frames, None while it takes them.
        settled: how often nothing more was to be expected of what was before; lost: frames that were owed then, of
            which nobody knows whether it took them.
        given, heard: when it was given a frame last, and when it answered last.
    """

    def __init__(self, answers: bool = False) -> None:
        self.answers = answers
        self.taken: Counter[Key] = Counter()
        self.refused = self.settled = self.lost = 0
        self.refusing: float | None = None
        self._owed: deque[tuple[float, Key]] = deque(maxlen=_KEPT)
        self._usual = LATE / _TIMES  # for which an answer takes [s]
        self._count = self._asked = 0  # frames that it was given in all, and by when it was asked last
        self.given = self.heard = 0.0

    @property
    def owed(self) -> int:
        """Frames that it has not answered to yet."""
        return len(self._owed)

    @property
    def failed(self) -> int:
        """Frames that it did not take, or of which nobody knows."""
        return self.refused + self.lost

    @contextmanager
    def giving(self, key: Key, now: float) -> Iterator[None]:
        """A frame is written in the block, which fails where it is not; another thread may see its answer by then."""
        owed = now, key
        self._owed.append(owed)
        self._count += 1
        self.given = now
        try:
            yield
        except Exception:
            with suppress(ValueError):  # all may have been dropped meanwhile
                self._owed.remove(owed)
                self._count -= 1
            raise

    def answered(self, taken: bool, now: float) -> bool:
        """The answer to the oldest frame; whether there was one."""
        self.heard = now
        if not self._owed:
            return False
        self.answers = True
        given, key = self._owed.popleft()
        self._usual += _SHARE * (min(now - given, LATE) - self._usual)
        if taken:
            self.taken[key] += 1
            self.refusing = None
        else:
            self.refused += 1
            self.refusing = now if self.refusing is None else self.refusing
        return True

    def ask(self) -> None:
        """It is asked something behind the frames of until now."""
        self._asked = self._count

    def spoke(self) -> None:
        """It has answered to that; one that has answered to no frame by then never does."""
        before = max(self._asked - self._count + len(self._owed), 0)
        self.answers = self.answers and not (before and self.taken.total() + self.refused == 0)
        self.settle(before)

    def settle(self, count: int = _KEPT) -> None:
        """The first so many frames that it has not answered to by now it never will."""
        count = min(count, len(self._owed))
        self.lost += count * self.answers
        with suppress(IndexError):  # another thread may have seen answers to them
            for _ in range(count):
                self._owed.popleft()
        self.settled += 1

    def stalled(self, now: float, key: Key) -> bool:
        """Whether it has stopped answering: a frame that is written now would wait behind what is old already."""
        if not self.answers or not self._owed:
            return False
        silent = now - max(self._owed[0][0], self.heard)
        patience = min(max(_PROMPT, _TIMES * self._usual), LATE)
        return silent > STALL or (silent > patience and any(owed == key for _, owed in list(self._owed)))
