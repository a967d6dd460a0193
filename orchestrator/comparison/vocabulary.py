"""What commands and notebooks call: two things compared, and references accepted."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.errors import InputError, ServotwinError
from orchestrator.batch.discovery import find_scenarios
from orchestrator.batch.scenario_judge import ScenarioJudge
from orchestrator.comparison.acceptance import accept_proposals
from orchestrator.comparison.comparison import Comparison, Tolerance, compare_sides
from orchestrator.comparison.fmu_side import differences
from orchestrator.comparison.proposal import NewReference, Proposal, propose
from orchestrator.comparison.sides import Comparable, SideSetting, side
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.results import check_target
from orchestrator.scenario.references import abandoned

Bar = Callable[[str], AbstractContextManager[Progress]]
FOLDER = "out/accept"


def compare(
    one: Comparable,
    other: Comparable,
    *,
    scenario: str | Path | None = None,
    component: str | None = None,
    case: str | None = None,
    tolerance: Tolerance | None = None,
    names: Mapping[str, str] | None = None,
    stop: float | None = None,
    step: float | None = None,
    bar: Bar = lambda label: nullcontext(silent),
) -> Comparison:
    """Two things held against each other: traces, results of runs, or what `servotwin compare` takes.

    Args:
        scenario: what FMUs, or ways to run, are compared in.
        component: the one of the scenario that the FMUs take the place of.
        case: this one alone.
        tolerance: by how much they may differ, by default as the command's.
        names: signal of `other` -> what it is called in `one`.
        stop, step: of FMUs alone, over their own [s].
        bar: shows progress under a label.

    Raises:
        InputError: one is not there, or they have nothing in common.
        FmuError: an FMU failed.
    """
    setting = SideSetting(None if scenario is None else Path(scenario), component, case, stop, step)
    sides = []
    for given in (one, other):
        with bar(str(given)) as progress:
            sides.append(side(given, setting, progress))
    found = compare_sides(sides[0], sides[1].renamed(names or {}), tolerance or Tolerance())
    files = [Path(given) for given in (one, other) if isinstance(given, str | Path)]
    fmus = len(files) == 2 and all(file.suffix.lower() == ".fmu" for file in files)
    return replace(found, interface=differences(*files) if fmus else ())


@dataclass(frozen=True, eq=False)
class Acceptance:
    """What came of accepting references.

    Attributes:
        written: those that were, or would be.
        failures: why scenarios have none.
        abandoned: folders of references whose scenario is not there.
        folder: has the page with the curves, and the references that were replaced.
    """

    proposals: Sequence[Proposal]
    written: Sequence[NewReference]
    failures: Sequence[ServotwinError]
    abandoned: Sequence[Path]
    folder: Path

    @property
    def references(self) -> list[NewReference]:
        """All that the runs would give."""
        return [new for proposal in self.proposals for new in proposal.references]


def accept(
    *paths: str | Path, case: str | None = None, every: bool = False, write: bool = True, out: str | Path = FOLDER
) -> Acceptance:
    """Run scenarios that ask for accepted references, and write those that differ from the old ones.

    Args:
        paths: scenarios, and folders of them.
        case: of one scenario this case alone.
        every: whether those that agree with the old ones are written, too.
        write: whether any is.
        out: folder of the page that shows new against old ones, and of what was replaced.

    Raises:
        InputError: there is no such scenario or case, or a reference cannot be replaced.
        ServotwinError: a scenario failed; those of the others are written.
    """
    found = accept_all([Path(path) for path in paths], Path(out), case, every, write)
    if found.failures:
        raise found.failures[0]
    return found


def accept_all(
    paths: Sequence[Path],
    folder: Path,
    case: str | None = None,
    every: bool = False,
    write: bool = True,
    isolation: Isolation | None = None,
    bar: Bar = lambda label: nullcontext(silent),
) -> Acceptance:
    """As `accept`, which raises the same errors but those of single scenarios: they are in what it returns."""
    judge = ScenarioJudge()
    files = [task.file for task in find_scenarios(paths, {}, judge) if task.judge is judge]
    if case is not None and len(files) != 1:
        raise InputError("--case", "is for one scenario", f"give one of {', '.join(map(str, files))}")
    check_target(folder, files)
    proposals: list[Proposal] = []
    failures: list[ServotwinError] = []
    for file in files:
        with bar(file.stem) as progress:
            try:
                proposals.append(propose(file, case, progress, isolation))
            except ServotwinError as error:
                failures.append(error)
    gone = [one for place in sorted({file.parent for file in files}) for one in abandoned(place)]
    written = accept_proposals(proposals, folder, every, write)
    return Acceptance(proposals, written, failures, gone, folder)
