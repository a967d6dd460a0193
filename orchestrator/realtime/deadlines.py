"""How well the steps of a coupling kept their deadlines, in memory that does not grow."""

from __future__ import annotations

from orchestrator.realtime.lateness import Lateness

LATE = 1e-3  # a step that begins later than this after its deadline is a late one [s]


class Deadlines:
    """Statistics of steps that were to begin at given times.

    Attributes:
        late: steps that began more than 1 ms after their deadline.
        overrun: steps that began more than a whole step after it; they were made up for.
        lateness: from the deadline to the beginning; work: from there to the end of what is done in a step.
        step: between two deadlines [s].
    """

    KEYS = (
        "steps=lateness.count",
        "step",
        "late",
        "on_time",
        "overrun",
        "lateness=lateness.figures",
        "work=work.figures",
    )

    def __init__(self, step: float) -> None:
        self.step = step
        self.late = self.overrun = 0
        self.lateness, self.work = Lateness(), Lateness()

    def begun(self, lateness: float) -> None:
        """Count a step that begins so long after its deadline [s]."""
        self.lateness.add(lateness)
        self.late += lateness > LATE
        self.overrun += lateness > self.step

    @property
    def on_time(self) -> float:
        """Share of the steps that were not late; 1 before the first."""
        return round(1 - self.late / max(self.lateness.count, 1), 6)

    def going(self, simulated: float, elapsed: float, whole: float | None) -> dict[str, float]:
        """How a run goes that is at `simulated` of `whole` after so long, for people who watch it; times [s].

        Args:
            whole: None where it has no end.
        """
        factor = simulated / elapsed if simulated > 0 < elapsed else 1.0
        left = {} if whole is None else {"seconds left": round((whole - simulated) / max(factor, 1e-3), 1)}
        return {"times real time": round(factor, 3), **left}

    def sentence(self) -> str:
        """How the deadlines were kept, for people."""
        late, work = self.lateness.figures, self.work.figures
        half, most, last = (1e6 * late["median"], 1e6 * late["p99_9"], 1e6 * late["worst"])
        return (
            f"{self.lateness.count:,} steps of {self.step:g} s, {100 * self.on_time:.4g} % of them begun within 1 ms "
            f"of their deadline ({self.late:,} late, {self.overrun:,} by more than a step). Half began within "
            f"{half:.0f} µs, 99.9 % within {most:.0f} µs, the last after {last:.0f} µs. "
            f"Half took up to {1e6 * work['median']:.0f} µs, 99.9 % up to {1e6 * work['p99_9']:.0f} µs."
        )
