"""A scenario run: its cases by the systems that they share, and all of them in one result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from fmus.errors import FmuError
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, share_of, silent
from orchestrator.scenario.run.keeping import Keeping
from orchestrator.scenario.run.outcome import CaseResult, CaseState, ScenarioFailed, ScenarioInterrupted, ScenarioResult
from orchestrator.scenario.run.same_system import run_cases
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.schema import load_scenario


def run_scenario(
    scenario: Scenario | str | Path,
    overrides: Mapping[str, Value | list[Any]] | None = None,
    progress: Progress = silent,
    fmus: Path | None = None,
    keeping: Keeping | None = None,
    isolation: Isolation | None = None,
    going_on: bool = False,
) -> ScenarioResult:
    """Run every case of a scenario, or of a scenario file, and judge it.

    Args:
        overrides: component.variable -> value, or component.array -> nested lists, over those of the file.
        fmus: folder that keeps the FMUs that are built; a temporary one by default.
        isolation: how FMUs given as files are isolated, None where they are not.
        going_on: whether a case in which an FMU fails, though none expects it, is one failed case, and others follow.

    Raises:
        InputError: the file or the system does not fit; nothing has run.
        ScenarioFailed: an FMU failed in a case that does not expect to be refused, when something had been stepped.
        FmuError: it failed before that.
        ScenarioInterrupted: a KeyboardInterrupt came when a case had begun to step.
    """
    whole = scenario if isinstance(scenario, Scenario) else load_scenario(scenario)
    done: list[ScenarioResult] = []
    for group in whole.by_system():
        first, count = sum(len(result.cases) for result in done), len(whole.cases)
        told = share_of(progress, first / count, (first + len(group.cases)) / count)
        kept_there = replace(keeping or Keeping(), first=first)
        try:
            done.append(run_cases(group, overrides or {}, told, fmus, kept_there, isolation, going_on))
        except (ScenarioInterrupted, ScenarioFailed) as end:
            end.result = _joined(whole, [*done, end.result])
            raise
        except KeyboardInterrupt:
            if not done:
                raise
            raise ScenarioInterrupted(replace(_joined(whole, done), interrupted=True)) from None
        except FmuError as error:
            if not done:
                raise
            raise ScenarioFailed(error, _joined(whole, done)) from error
    return _joined(whole, done)


def _joined(scenario: Scenario, parts: Sequence[ScenarioResult]) -> ScenarioResult:
    """The result of a scenario from those of its cases with one system each; what follows them has not run."""
    first, made = parts[0], [case for part in parts for case in part.cases]
    rest = scenario.cases[len(made) :]
    cases = [*made, *(CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in rest)]
    converted = (*(case for part in parts for case in part.scenario.cases), *rest)
    files, built, hashes = dict(first.assembled.files), set(first.assembled.built), dict(first.hashes)
    components = dict(first.scenario.system.components)
    for part in parts[1:]:
        for name, digest in part.hashes.items():
            known = name if hashes.get(name, digest) == digest else f"{name} of {part.cases[0].name}"
            files[known], hashes[known] = part.assembled.files[name], digest
            components[known] = part.scenario.system.components[name]
            built |= {known} if name in part.assembled.built else set()
    return replace(
        first,
        scenario=replace(first.scenario, cases=converted, system=replace(first.scenario.system, components=components)),
        assembled=replace(first.assembled, files=files, built=frozenset(built)),
        cases=tuple(cases),
        keeping=replace(first.keeping, first=0),
        interrupted=any(part.interrupted for part in parts),
        crossings=tuple(dict.fromkeys(crossing for part in parts for crossing in part.crossings)),
        hashes=hashes,
    )
