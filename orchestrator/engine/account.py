"""What stepping a run took: which loop did it, how many steps, how long, and whose time it was."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from orchestrator.engine.compiled import Engine
from orchestrator.engine.iterated import TakenSteps
from orchestrator.engine.loop import Statistics


@dataclass(frozen=True)
class Account:
    """How a run was stepped.

    Attributes:
        engine: the loop that did it, Python's or the compiled one.
        reason: why it was not the compiled one; nothing where it was.
        steps: communication steps taken.
        step: communication step [s].
        start: time at which the run began [s].
        reached: time up to which all components have stepped [s].
        seconds: wall time from the first step to the last row of the record [s].
        taken: what steps were taken inside communication steps; None where there were none.
    """

    engine: Engine
    reason: str
    steps: int
    step: float
    start: float
    reached: float
    seconds: float
    taken: TakenSteps | None = None

    @property
    def real_time_factor(self) -> float:
        """Simulated time over wall time."""
        return (self.reached - self.start) / max(self.seconds, 1e-9)


@dataclass(frozen=True)
class Share:
    """Whose time it was: a component's, or with None as its name the loop's own (values passed on, rows, progress).

    Attributes:
        calls: steps of the component, or communication steps of the loop.
        seconds: wall time [s].
        percent: of the time of all.
    """

    name: str | None
    calls: int
    seconds: float
    percent: float

    @property
    def microseconds(self) -> float:
        """Time of a call [µs]."""
        return 1e6 * self.seconds / max(self.calls, 1)


def shares(runs: Iterable[tuple[Account, Mapping[str, Statistics]]]) -> list[Share]:
    """Each component's share of the time of some runs of a system, the loop's own last; they sum to 100 %.

    The times of short steps are estimates, so that they may exceed the wall time: the loop's own is then 0.
    """
    calls: dict[str | None, int] = defaultdict(int)
    seconds: dict[str | None, float] = defaultdict(float)
    for account, statistics in runs:
        for name, component in statistics.items():
            calls[name] += component.calls
            seconds[name] += component.seconds
        calls[None] += account.steps
        seconds[None] += account.seconds
    inside = sum(spent for name, spent in seconds.items() if name is not None)
    own = max(seconds.pop(None, 0.0) - inside, 0.0)
    parts = {**seconds, None: own}
    whole = max(inside + own, 1e-9)
    return [Share(name, calls[name], spent, 100 * spent / whole) for name, spent in parts.items()]
