"""What can be accepted of a scenario: it is run, and what comes out is held against the references that are there."""

from __future__ import annotations

import getpass
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from enum import StrEnum
from fractions import Fraction
from pathlib import Path

import numpy as np

from fmus import library
from fmus.errors import FmuError, ScenarioError, TraceError
from fmus.files import sha256
from fmus.packaging.native.compiler import host_name
from orchestrator.batch.dependencies import dependencies
from orchestrator.fmi.isolation import Isolation
from orchestrator.measures import Parting, partings
from orchestrator.progress import Progress, silent
from orchestrator.results import versions
from orchestrator.scenario import references
from orchestrator.scenario.decimation import decimated, rounded
from orchestrator.scenario.expectations import Expected, OnSignal
from orchestrator.scenario.expectations.base import Ran
from orchestrator.scenario.expectations.reference import Against
from orchestrator.scenario.run import CaseResult, ScenarioResult, run_scenario
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace

OFF = 0.04  # of a tolerance, that lines between the samples of a reference may be off
ROUND = 0.01  # of a tolerance, that a sample may be rounded by


class ChangeKind(StrEnum):
    """What a new reference is to the old one."""

    NEW = "new"
    SAME = "agrees"
    OTHER = "differs"
    UNFIT = "replaces one that is unfit"


@dataclass(frozen=True, eq=False)
class NewReference:
    """A reference that a run would give.

    Attributes:
        file: where it belongs.
        run: what the run gave, all samples.
        old: the reference that is there, None where there is none that is fit.
        change: what it is to that.
        partings: signals that both have, and how they differ.
        why: why the old one is unfit, or which signals only one of them has.
        content: the new file.
    """

    scenario: Path
    case: str
    file: Path
    run: Trace
    kept: Trace
    old: Trace | None
    change: ChangeKind
    partings: Sequence[Parting]
    why: str
    content: bytes


@dataclass(frozen=True, eq=False)
class Proposal:
    """What can be accepted of a scenario.

    Attributes:
        unused: files among its references that no case asks for.
        doubts: other expectations that the run does not meet, a line each.
    """

    scenario: Path
    title: str
    references: Sequence[NewReference]
    unused: Sequence[Path]
    doubts: Sequence[str]


def propose(
    path: Path, only: str | None = None, progress: Progress = silent, isolation: Isolation | None = None
) -> Proposal:
    """Run a scenario's cases that ask for accepted references, and hold what comes out against what is there.

    Args:
        only: the name of the one case that is run.

    Raises:
        InputError: there is no such case; a file is no reference of ours, or another scenario's; a run ends early or
            holds a signal that is not finite, or the new reference is too large.
        FmuError: an FMU fails.
    """
    scenario = load_scenario(path, references=False)
    unused = references.unused(path, (asked.reference.file for case in scenario.cases for _, asked in _asked(case)))
    if only is not None and only not in (names := [case.name for case in scenario.cases]):
        raise ScenarioError(path, f"has no case '{only}'", f"its cases are {', '.join(names)}")
    chosen = [case for case in scenario.cases if _asked(case) and only in (None, case.name)]
    if not chosen:
        return Proposal(path, scenario.title, (), unused, ())
    result = run_scenario(replace(scenario, cases=tuple(chosen)), progress=progress, isolation=isolation)
    hashes = _hashes(path)
    pairs = zip(result.scenario.cases, result.cases, strict=True)
    made = [new for case, run in pairs for new in _made(result.scenario, case, run, hashes)]
    return Proposal(path, scenario.title, made, unused, list(_doubts(result)))


def _asked(case: Case) -> list[tuple[OnSignal, Against]]:
    """What a case expects of signals against accepted references, and how it compares each."""
    return [pair for expected in case.expected for pair in _against(expected)]


def _against(expected: Expected) -> list[tuple[OnSignal, Against]]:
    """The parts of an expectation that hold a signal against an accepted reference, and how."""
    found = [(leaf, leaf.condition) for leaf in expected.leaves if isinstance(leaf, OnSignal)]
    return [(leaf, one) for leaf, one in found if isinstance(one, Against) and one.reference.accepted]


def _tolerances(case: Case, run: Trace) -> dict[Path, dict[str, float]]:
    """file -> signal -> the smallest distance from the run that the case allows [unit of the signal]."""
    found: dict[Path, dict[str, float]] = {}
    for leaf, condition in _asked(case):
        signals = found.setdefault(condition.reference.file, {})
        values = leaf.window(run)[leaf.signal]
        signals[leaf.signal] = min(condition.precision(values), signals.get(leaf.signal, np.inf))
    return found


def _looked_at(case: Case, file: Path, run: Trace) -> Trace:
    """The part of a run that the case compares with a file, a sample on either side of it.

    Signals that are looked at for less long keep their first and last value there beyond: that costs no samples.
    """
    spans: dict[str, tuple[int, int]] = {}
    for leaf, condition in _asked(case):
        if condition.reference.file == file:
            time = leaf.window(run).time
            first, last = (int(row) for row in np.searchsorted(run.time, time[[0, -1]]))
            known = spans.get(leaf.signal, (first, last))
            spans[leaf.signal] = min(known[0], first - 1), max(known[1], last + 1)
    rows = np.arange(max(min(first for first, _ in spans.values()), 0), len(run))
    rows = rows[: max(last for _, last in spans.values()) - rows[0] + 1]
    signals = {name: run[name][np.clip(rows, max(span[0], 0), span[1])] for name, span in spans.items()}
    return Trace(run.time[rows], signals, run.units, run.name)


def _made(scenario: Scenario, case: Case, result: CaseResult, hashes: Mapping[str, str]) -> Iterator[NewReference]:
    place = f"{scenario.path}: case {case.name}"
    if result.error is not None:
        raise FmuError(place, f"gives no reference, for it failed ({result.error})", "mend the run first")
    if result.ended:
        raise ScenarioError(place, f"gives no reference, for {result.ended}", "mend the run first")
    asked = result.trace.select(dict.fromkeys(leaf.signal for leaf, _ in _asked(case)))
    hold = {leaf.signal for leaf, _ in _asked(case) if leaf.hold}
    _check_finite(asked, place)
    for file, tolerances in _tolerances(case, asked).items():
        run = _looked_at(case, file, asked.select(tolerances))
        kept = _compact(run, tolerances, hold & tolerances.keys())
        old, why = _old(file, scenario.path)
        found = [] if old is None else _held_against(run, old, tolerances, hold)
        if old is not None:
            why = _others(run, old)
        content = references.content(
            kept, _provenance(scenario.path, case, file, run, tolerances, hashes, scenario.timing.step)
        )
        change = ChangeKind.OTHER
        if old is None:
            change = ChangeKind.UNFIT if file.exists() else ChangeKind.NEW
        elif not why and _holds(case, result.trace, file, old):
            change = ChangeKind.SAME
        yield NewReference(scenario.path, case.name, file, run, kept, old, change, found, why, content)


def _compact(run: Trace, tolerances: Mapping[str, float], hold: Collection[str]) -> Trace:
    few = decimated(run, {name: OFF * tolerance for name, tolerance in tolerances.items()}, hold)
    return rounded(few, {name: ROUND * tolerance for name, tolerance in tolerances.items()})


def _check_finite(run: Trace, place: str) -> None:
    for name in run.names:
        bad = np.flatnonzero(~np.isfinite(run[name]))
        if len(bad):
            raise TraceError(place, f"{name} is not finite at {run.time[bad[0]]:g} s", "mend the run first")


def _old(file: Path, scenario: Path) -> tuple[Trace | None, str]:
    """The reference that is there, or why there is none that is fit."""
    if not file.exists():
        return None, ""
    if references.provenance(file) is None:
        raise TraceError(file, "was not written by `servotwin accept`, and is not replaced", "move it away")
    try:
        trace, origin = references.read(file)
    except TraceError as problem:
        return None, problem.problem
    references.check_owner(file, origin, scenario)
    return trace, ""


def _held_against(run: Trace, old: Trace, tolerances: Mapping[str, float], hold: Collection[str]) -> list[Parting]:
    both = {name: tolerances[name] for name in run.names if name in old.names and old.unit(name) == run.unit(name)}
    covered = run.between(old.time[0], old.time[-1])
    return partings(covered, old.resampled(covered.time, hold), both) if both and len(covered) else []


def _others(run: Trace, old: Trace) -> str:
    """In what an old reference is not of the same kind as the run: signals, units, times."""
    added = [name for name in run.names if name not in old.names]
    gone = [name for name in old.names if name not in run.names]
    units = [
        f"{name} in {old.unit(name) or 'no unit'} instead of {run.unit(name) or 'no unit'}"
        for name in run.names
        if name in old.names and old.unit(name) != run.unit(name)
    ]
    words = [f"without {', '.join(added)}"] if added else []
    words += [f"with {', '.join(gone)}"] if gone else []
    words += units
    if not (old.covers(run.time[0], run.time[-1]) and run.covers(old.time[0], old.time[-1])):
        words.append(f"of {old.time[0]:g} to {old.time[-1]:g} s instead of {run.time[0]:g} to {run.time[-1]:g} s")
    return f"the old one is {'; '.join(words)}" if words else ""


def _holds(case: Case, run: Trace, file: Path, old: Trace) -> bool:
    """Whether a run holds all that the case asks of it against an old reference."""
    for leaf, condition in _asked(case):
        if condition.reference.file == file:
            reference = replace(condition.reference, trace=old.select([leaf.signal]))
            if not replace(leaf, condition=replace(condition, reference=reference)).check(Ran(run)).held:
                return False
    return True


def _provenance(
    scenario: Path,
    case: Case,
    file: Path,
    run: Trace,
    tolerances: Mapping[str, float],
    hashes: Mapping[str, str],
    step: Fraction,
) -> references.Provenance:
    return {
        "scenario": scenario.name,
        "case": case.name,
        "by": _user(),
        "at": datetime.now(UTC).isoformat(timespec="seconds"),
        "platform": host_name(),
        "versions": versions(),
        "sha256": dict(hashes),
        "samples": len(run),
        "step": float(step),
        "tolerances": dict(tolerances),
        "replaces": sha256(file) if file.exists() else "",
    }


def _user() -> str:
    """Who runs this, as far as the system knows."""
    try:
        return getpass.getuser()
    except (KeyError, OSError):  # a number without a name, as in containers
        return "unknown"


def _hashes(scenario: Path) -> dict[str, str]:
    """What goes into a run -> its hash; files as seen from the scenario, models of the library by their names."""
    base = scenario.resolve().parent
    names = {
        file: f"model {file.stem}" if library.holds(file) else Path(os.path.relpath(file, base)).as_posix()
        for file in dependencies(scenario)
    }
    return {name: sha256(file) for file, name in sorted(names.items(), key=lambda pair: pair[1])}


def _doubts(result: ScenarioResult) -> Iterator[str]:
    for case, run in zip(result.scenario.cases, result.cases, strict=True):
        for expected, check in zip(case.expected, run.checks, strict=True):
            if not _against(expected) and not check.held:
                yield f"case {case.name}: {check.text} does not hold ({check.found})"
