"""What an adapter has been given and has answered to: which frames it took, and whether it still takes any."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress

Key = tuple[int, bool]  # identifier, and whether it is an extended one

STALL = 0.1  # for which an adapter may answer nothing while it owes answers [s]
REPEATED = 0.05  # ... while it owes those to two frames of the message that is to be sent: these are old commands [s]


class Flow:
    """Frames on their way into an adapter that answers to each, in order; times are those of one clock [s].

    Attributes:
        answers: whether it answers to frames at all; some adapters never do.
        taken: identifier -> frames that it took.
        refused: frames that it did not take (BEL).
        refusing: since when it has refused all frames, None while it takes them.
        settled: how often nothing more was to be expected of what was before; lost: frames that were owed then, of
            which nobody knows whether it took them; doubtful: whether the latest frame is among these.
        given, heard: when it was given a frame last, and when it answered last.
    """

    def __init__(self) -> None:
        self.answers = False
        self.taken: Counter[Key] = Counter()
        self.refused = self.settled = self.lost = 0
        self.refusing: float | None = None
        self.doubtful = False
        self._owed: deque[tuple[float, Key]] = deque()
        self.given = self.heard = 0.0

    @property
    def owed(self) -> int:
        """Frames that it has not answered to yet."""
        return len(self._owed)

    @contextmanager
    def giving(self, key: Key, now: float) -> Iterator[None]:
        """A frame is written in the block, which fails where it is not; another thread may see its answer by then."""
        owed = now, key
        self._owed.append(owed)
        self.given, self.doubtful = now, False
        try:
            yield
        except Exception:
            with suppress(ValueError):  # all may have been dropped meanwhile
                self._owed.remove(owed)
            raise

    def answered(self, taken: bool, now: float) -> bool:
        """The answer to the oldest frame; whether there was one."""
        self.heard = now
        if not self._owed:
            return False
        self.answers = True
        _, key = self._owed.popleft()
        if taken:
            self.taken[key] += 1
            self.refusing = None
        else:
            self.refused += 1
            self.refusing = now if self.refusing is None else self.refusing
        return True

    def settle(self) -> None:
        """What has not been answered to by now never will be."""
        self.lost += len(self._owed)
        self.doubtful = self.doubtful or bool(self._owed)
        self._owed.clear()
        self.settled += 1

    def stalled(self, now: float, key: Key) -> bool:
        """Whether it has stopped answering: a frame that is written now would wait behind what is old already."""
        if not self.answers or not self._owed:
            return False
        silent = now - max(self._owed[0][0], self.heard)
        return silent > STALL or (silent > REPEATED and sum(owed == key for _, owed in list(self._owed)) > 1)
