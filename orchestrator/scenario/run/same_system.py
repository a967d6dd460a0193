"""Cases that share a system: it is built, opened and checked once, and then runs one case after the other."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from fmus.errors import FmuError, ScenarioError
from fmus.files import sha256
from orchestrator.assembly.assembly import Assembled, OpenSystem, assemble
from orchestrator.assembly.whole_arrays import check_shapes, elements, shapes
from orchestrator.crossing import logged
from orchestrator.engine import Interrupted, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation, scratch
from orchestrator.fmi.said import kept
from orchestrator.processes import last_words
from orchestrator.progress import Progress
from orchestrator.scenario.run.case import named, run_case
from orchestrator.scenario.run.keeping import Keeping
from orchestrator.scenario.run.outcome import CaseResult, CaseState, ScenarioFailed, ScenarioInterrupted, ScenarioResult
from orchestrator.scenario.scenario import Scenario
from orchestrator.scenario.units import in_units_of
from orchestrator.settable import typed
from orchestrator.system import System, recordable
from orchestrator.trace import FloatArray

LOG = logging.getLogger("servotwin.scenario")


def run_cases(
    scenario: Scenario,
    overrides: Mapping[str, Value | list[Any]],
    progress: Progress,
    fmus: Path | None,
    keeping: Keeping,
    isolation: Isolation | None,
    going_on: bool,
) -> ScenarioResult:
    if scenario.logger is not None and (keeping.every, keeping.stream) != (1, None):
        raise ScenarioError(
            scenario.path, "has a recorder, which samples the whole record", "run it without stride and stream"
        )
    with scenario.naming(overrides), kept(keeping.log), scratch(isolation) as folder:
        given = elements(overrides)
        with keeping.span("build FMUs"):
            assembled = assemble(scenario.system.given(given), fmus or folder, scenario.driven)
        result = ScenarioResult(scenario, assembled, (), keeping, overrides=given)
        cases: list[CaseResult] = []
        try:
            with (
                OpenSystem(assembled) as opened,
                opened.simulation(scenario.timing, isolation, keeping.profile) as simulation,
            ):
                result = _prepared(result, opened.system, simulation, shapes(overrides))
                for case in _run_cases(result, simulation, progress):
                    cases.append(case)
                    if not going_on:
                        _go_on(replace(result, cases=tuple(cases)))
        except KeyboardInterrupt as stop:
            cases += _unfinished(scenario, len(cases), stop, keeping)
            if all(case.state is CaseState.NOT_RUN for case in cases):
                raise
            raise ScenarioInterrupted(replace(result, cases=tuple(cases), interrupted=True)) from None
        return replace(result, cases=tuple(cases))


def _prepared(
    result: ScenarioResult, system: System, simulation: Simulation, arrays: Mapping[str, tuple[int, ...]]
) -> ScenarioResult:
    """The result before its first case, of a scenario that fits its system and is in its units.

    Args:
        arrays: shapes of those that are overridden.
    """
    check_shapes(system, arrays)
    given = typed(system, result.overrides)
    scenario, crossed = in_units_of(system, result.scenario)
    crossings = logged([*system.crossings, *crossed])
    recorded = scenario.recorded(simulation.outputs)
    simulation.check_record(recorded)
    for name in () if scenario.logger is None else scenario.logger.signals.values():
        recordable(system, name, f"recorder: {name}")
    for case in scenario.cases:
        check_shapes(system, case.arrays)
    _check_values(scenario, simulation, given)
    if not recorded:
        LOG.warning("nothing is recorded, for there are no outputs; name other variables in `record`")
    if scenario.record is None and simulation.texts:
        LOG.warning("texts are recorded where `record` names them, not by themselves: %s", ", ".join(simulation.texts))
    hashes = hashes_of(result.assembled)
    return replace(result, scenario=scenario, crossings=crossings, overrides=given, system=system, hashes=hashes)


def hashes_of(assembled: Assembled) -> dict[str, str]:
    """Component -> SHA-256 of its FMU."""
    return {name: sha256(file) for name, file in assembled.files.items()}


def _check_values(scenario: Scenario, simulation: Simulation, overrides: Mapping[str, Value]) -> None:
    """See that values and references of all cases fit, but the values of those that expect to be refused."""
    instants = simulation.instants() if any(case.looked_at for case in scenario.cases) else np.zeros(0)
    for case in scenario.cases:
        for expected in case.expected:
            expected.check_covered(instants)
        if not case.may_be_refused:
            with named(scenario, case):
                simulation.check_values({**case.values, **overrides})


def _run_cases(begun: ScenarioResult, simulation: Simulation, progress: Progress) -> Iterator[CaseResult]:
    """Each case, run and judged."""
    scenario, keeping = begun.scenario, begun.keeping
    stimuli = _stimuli(scenario, simulation)
    for number, case in enumerate(scenario.cases):
        values = {**case.values, **begun.overrides}
        told = _part_of(progress, number, len(scenario.cases), case.name)
        start = perf_counter()
        at_case = last_words.own().working_on(keeping.first + number)
        with at_case, keeping.span(f"case {case.name}"):
            made = run_case(scenario, number, simulation, values, stimuli, keeping, told)
        yield replace(made, seconds=perf_counter() - start)


def _stimuli(scenario: Scenario, simulation: Simulation) -> dict[str, FloatArray]:
    instants = simulation.instants() if scenario.stimuli else np.zeros(0)
    return {name: stimulus.values(instants, name) for name, stimulus in scenario.stimuli.items()}


def _part_of(progress: Progress, number: int, count: int, name: str) -> Callable[[float], None]:
    return lambda fraction: progress((number + fraction) / count, name)


def _go_on(result: ScenarioResult) -> None:
    """See that the latest case did not fail."""
    cases = result.cases
    last = cases[-1]
    if last.state is not CaseState.FAILED:
        return
    assert isinstance(last.error, FmuError)
    if all(case.result is None for case in cases):
        raise last.error
    left = result.scenario.cases[len(cases) :]
    rest = [CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in left]
    raise ScenarioFailed(last.error, replace(result, cases=(*cases, *rest))) from last.error


def _unfinished(scenario: Scenario, done: int, stop: KeyboardInterrupt, keeping: Keeping) -> list[CaseResult]:
    """The cases that are not done: the one that was interrupted where one was, and those that have not begun."""
    cases = [CaseResult(case.name, None, None, (), state=CaseState.NOT_RUN) for case in scenario.cases[done:]]
    if isinstance(stop, Interrupted) and stop.result.account.reached > stop.result.account.start:
        cases[0] = CaseResult(cases[0].name, stop.result, None, (), keeping.file(done), CaseState.INTERRUPTED)
    return cases
