"""What a process needs to run points of a sweep: systems, cases, what is asked of them, as plain values that travel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from orchestrator.assembly.assembly import Assembled
from orchestrator.assembly.stimulus import Stimulus
from orchestrator.batch.sweep.points.factors import Space
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.scenario import Scenario
from orchestrator.trace import FloatArray

Numbers = NDArray[np.int64]


@dataclass(frozen=True)
class Asked:
    """A column of figures: what is asked of each run.

    Attributes:
        name: of the column with the figure; that of the verdict ends in `_held`, that of the margin in `_margin`.
        text: in words.
        unit: of figure and margin, "" where they have none.
        counts: whether a run passes only where it holds.
    """

    name: str
    text: str
    unit: str = ""
    counts: bool = True


@dataclass(frozen=True)
class Variant:
    """A system, and the cases that are run with it.

    Attributes:
        assembled: its FMUs.
        scenario: with these cases alone, in the units of the system.
        cases: their numbers among all of the sweep.
        asked: case -> for each of its expectations the number of its column.
    """

    assembled: Assembled
    scenario: Scenario
    cases: tuple[int, ...]
    asked: tuple[tuple[int, ...], ...]

    @property
    def files(self) -> list[Path]:
        """Its FMUs."""
        return list(self.assembled.files.values())


@dataclass(frozen=True)
class Kept:
    """Signals whose samples are kept, every so many steps."""

    signals: tuple[str, ...]
    units: tuple[str, ...]
    stride: int = 1


@dataclass(frozen=True)
class Setup:
    """Everything that a run depends on but its point.

    Attributes:
        variants: one after the other those with the same FMUs; the last FMU factor changes fastest.
        cases: names; the run of a point in a case has the number point * len(cases) + case.
        fmus: place of each factor that is an FMU, and how many levels it has.
        recordings: place of each factor that is a recording -> what drives its input at each level.
        noise: components that are given a seed of their own at each point.
        seed: that those come from.
        isolation: how FMUs that scenarios give as files are isolated, None where they are not.
    """

    space: Space
    cases: tuple[str, ...]
    variants: tuple[Variant, ...]
    asked: tuple[Asked, ...]
    fmus: tuple[tuple[int, int], ...] = ()
    recordings: Mapping[int, tuple[Stimulus, ...]] = field(default_factory=dict)
    noise: tuple[str, ...] = ()
    seed: int = 0
    kept: Kept | None = None
    isolation: Isolation | None = None

    def place(self, point: FloatArray, case: int) -> tuple[int, int]:
        """The number of the variant that a point (d,) is run with in a case, and that of the case there."""
        choice = 0
        for column, levels in self.fmus:
            choice = choice * levels + int(point[column])
        of_choice = len(self.variants) // max(1, int(np.prod([levels for _, levels in self.fmus], initial=1)))
        for number in range(choice * of_choice, (choice + 1) * of_choice):
            if case in self.variants[number].cases:
                return number, self.variants[number].cases.index(case)
        raise LookupError(case)

    def moved(self, files: Mapping[Path, Path]) -> Setup:
        """The same with FMU files at other places."""
        return replace(self, variants=tuple(_moved(variant, files) for variant in self.variants))


def _moved(variant: Variant, files: Mapping[Path, Path]) -> Variant:
    found = variant.assembled
    places = {name: files[file] for name, file in found.files.items()}
    components = {name: replace(one, source=places[name]) for name, one in found.system.components.items()}
    return replace(variant, assembled=replace(found, files=places, system=replace(found.system, components=components)))


@dataclass(frozen=True, eq=False)
class Chunk:
    """Some runs.

    Attributes:
        runs: (n,) their numbers, ascending.
        points: (n, d) the point of each.
    """

    runs: Numbers
    points: FloatArray

    def part(self, first: int, stop: int) -> Chunk:
        """Those at some places."""
        return Chunk(self.runs[first:stop], self.points[first:stop])


@dataclass(frozen=True)
class ChunkResult:
    """What came of a task.

    Attributes:
        rows: a row a run, in the order of the runs, as an Arrow stream.
        failed: how many of the runs failed.
        seconds: wall time of all [s].
        by: who ran them.
    """

    rows: bytes
    failed: int
    seconds: float
    by: str = ""
