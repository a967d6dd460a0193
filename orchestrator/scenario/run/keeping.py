"""How much of a run's record is kept, and where."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass
from pathlib import Path

from orchestrator.engine import Result, Run, RunProfile, Simulation, Sink

Execute = Callable[[Simulation, Run, Sink | None], Result]


@dataclass(frozen=True)
class Keeping:
    """How much of the record is kept, and where.

    Attributes:
        every: communication steps from one row to the next.
        stream: folder of a Parquet file a case, written while it runs; None keeps the record in memory.
        log: file that takes all that FMUs say.
        profile: what takes note of every step.
        execute: what runs a simulation instead of itself, at a pace of its own.
        first: number of the case among all of the scenario that is the first here.
    """

    every: int = 1
    stream: Path | None = None
    log: Path | None = None
    profile: RunProfile | None = None
    execute: Execute | None = None
    first: int = 0

    def run(
        self, simulation: Simulation, run: Run, progress: Callable[[float], None], sink: Sink | None = None
    ) -> Result:
        """The result of a run of the simulation."""
        if self.execute is None:
            return simulation.execute(run, progress, sink)
        return self.execute(simulation, run, sink)

    def span(self, name: str) -> AbstractContextManager[None]:
        """What has a block noted, where anything is."""
        return nullcontext() if self.profile is None else self.profile.span(name)

    def file(self, number: int) -> Path | None:
        """Where the record of the case with this number is written while it runs."""
        return None if self.stream is None else self.stream / f"{self.first + number}.parquet"
