"""What goals measure of a run: the move that begins with the last change of the reference."""

from __future__ import annotations

import numpy as np

from fmus.errors import IdentificationError
from identification.tuning.goals.goal import Goal, StepTest
from orchestrator.trace import FloatArray, Trace

REST = 1e-9  # of the reference's size, by which it may change at rest
LEAST = 10  # samples of a move


class Move:
    """One loop's move, as measures of responses take it: N is 1.

    What is tracked, and its target, count from where it was as the move began.

    Raises:
        IdentificationError: the reference does not come to rest, or asks for no move.
    """

    def __init__(self, place: str, trace: Trace, reference: str, tracked: str, band: float, limit: float) -> None:
        asked = trace[reference]
        changes = np.flatnonzero(np.abs(np.diff(asked)) > REST * np.abs(asked).max(initial=0.0)) + 1
        begin = int(changes[-1]) if len(changes) else 0
        if len(asked) - begin < LEAST:
            raise IdentificationError(place, f"{reference} changes until the end", "let it rest after its last step")
        self._trace, self._begin, self._tracked = trace, begin, tracked
        self._start = float(trace[tracked][begin])
        height = float(asked[-1]) - self._start
        if height == 0:
            raise IdentificationError(place, f"{reference} asks for no move of {tracked}", "let it step")
        self.test = StepTest(height, len(asked) - begin, limit=limit, band=band)

    @property
    def band(self) -> float:
        """Within which of its end the move has settled [unit of the reference]."""
        return self.test.band * abs(self.test.height)

    def time(self, goal: Goal) -> FloatArray:
        """(K,) [s], from the beginning of the move."""
        return np.asarray(self._trace.time[self._begin :] - self._trace.time[self._begin])

    def signal(self, goal: Goal) -> FloatArray:
        """(1, K) the goal's signal."""
        assert goal.signal is not None
        return self._of(goal.signal.name)

    def tracked(self, goal: Goal) -> FloatArray:
        """(1, K) what is tracked."""
        return self._of(self._tracked)

    def target(self, goal: Goal) -> float:
        """Where the goal's signal is to be: at the reference where it is tracked, at 0 otherwise."""
        return self.test.height if goal.signal is not None and goal.signal.name == self._tracked else 0.0

    def aim(self, goal: Goal) -> float:
        """Where what is tracked is to be."""
        return self.test.height

    def _of(self, name: str) -> FloatArray:
        values = self._trace[name][self._begin :]
        return np.asarray(values - self._start if name == self._tracked else values)[None]
