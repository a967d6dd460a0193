"""One case run and judged."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import process_time

from fmus.errors import FmuError, ScenarioError, ServotwinError
from orchestrator import formats
from orchestrator.engine import Result, Run, RunFailed, Simulation, Sink
from orchestrator.fmi.interface import Value
from orchestrator.formats import parquet
from orchestrator.processes.interrupts import requested
from orchestrator.scenario.expectations import Check, Expected, Ran
from orchestrator.scenario.run.draws import drawn
from orchestrator.scenario.run.keeping import Keeping
from orchestrator.scenario.run.outcome import CaseResult, CaseState, nonfinite
from orchestrator.scenario.scenario import Case, Scenario
from orchestrator.trace import FloatArray

LOG = logging.getLogger("servotwin.scenario")


def run_case(
    scenario: Scenario,
    number: int,
    simulation: Simulation,
    values: Mapping[str, Value],
    stimuli: Mapping[str, FloatArray],
    keeping: Keeping,
    progress: Callable[[float], None],
) -> CaseResult:
    case, file = scenario.cases[number], keeping.file(number)
    run = Run(values, stimuli, scenario.recorded(simulation.outputs), record_every=keeping.every)
    execute = partial(keeping.run, simulation, run, progress)
    found = ran(simulation, run, case, execute if file is None else partial(_streamed, execute, file, case.looked_at))
    error, state = found.error, CaseState.DONE
    if error is not None and not case.may_be_refused:
        error, state = of_case(scenario, case, error), CaseState.FAILED
        if not isinstance(error, FmuError):
            raise error
    found = replace(found, error=error)
    checks = tuple(checked(expected, found) for expected in case.expected)
    spent, draws = found.processor or 0.0, found.draws
    made = CaseResult(case.name, found.result, error, checks, file, state, processor=spent, draws=draws)
    for check in checks:
        if check.doubt:
            LOG.warning("case %s: %s: %s", case.name, check.text, check.doubt)
    for name, count in nonfinite(found.trace).items() if found.trace is not None else ():
        LOG.warning("case %s: %d samples of %s are not finite", case.name, count, name)
    if made.ended:
        LOG.warning("case %s: %s; the run ends there and is judged by what there is", case.name, made.ended)
    return made


def ran(simulation: Simulation, run: Run, case: Case, execute: Callable[[], Result] | None = None) -> Ran:
    """A run of a case as its expectations see it, with those that differ by their noise; what failed is its error.

    Args:
        execute: what runs it, the simulation by itself where that is None.
    """
    result, error, begun, spent, draws = None, None, process_time(), 0.0, {}
    try:
        result = simulation.execute(run) if execute is None else execute()
        spent = process_time() - begun
        draws = drawn(simulation, run, case)
    except ServotwinError as failure:
        if requested():  # an FMU's answer to an interrupt
            raise KeyboardInterrupt from failure
        error = failure
        if isinstance(failure, RunFailed):
            result, error = failure.result, FmuError(failure.place, failure.problem, failure.fix)
    trace = result.trace if result is not None and error is None else None
    return Ran(trace, error, result, spent, case.name, draws=draws)


def checked(expected: Expected, ran: Ran) -> Check:
    """How an expectation turned out; one about times that a run which an FMU ended has not reached does not hold."""
    try:
        return expected.check(ran)
    except ScenarioError:
        if ran.result is None or not ran.result.ended:
            raise
        return Check(str(expected), False, ran.result.ended)


def of_case(scenario: Scenario, case: Case, failure: ServotwinError) -> ServotwinError:
    """The error with the name of its case, where there are several."""
    return failure if len(scenario.cases) == 1 else failure.within(f"case {case.name}")


@contextmanager
def named(scenario: Scenario, case: Case) -> Iterator[None]:
    try:
        yield
    except ServotwinError as failure:
        raise of_case(scenario, case, failure) from failure


def _streamed(execute: Callable[[Sink], Result], file: Path, looked_at: Iterable[str]) -> Result:
    """The result of a run whose record goes to a file; its trace has what the expectations look at."""
    with parquet.appending(file) as append:
        result = execute(append)
    signals = {signal: signal for signal in looked_at}
    if not signals:
        return result
    return replace(result, trace=formats.read(file, formats.Layout(columns=signals, texts=True)).trace)
