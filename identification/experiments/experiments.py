"""A campaign of experiments on one rig: its data sets simulated, then worked on side by side.

Data sets do not know of each other, so each goes to a process of its own; `set_result` says what happens there.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from fmus.errors import FmuError, ScenarioError
from identification.experiments.data_set import DataSet, data_set
from identification.experiments.physical_modes import PhysicalMode, physical_modes
from identification.experiments.reduction import ReductionExample
from identification.experiments.schema import ExampleBlock, ExperimentsBlock, NamedConditioningBlock
from identification.experiments.set_result import SetResult, identified
from identification.recordings.campaign import StudyTrace, TraceSource, load_campaign
from identification.recordings.units import in_common_units
from orchestrator.fmi.isolation import Isolation
from orchestrator.processes.child import Died
from orchestrator.processes.pool import Processes, calling, processors
from orchestrator.progress import Progress

Workers = Processes[Callable[[], Any], Any]
SIMULATED, IDENTIFIED = 0.35, 0.97  # of the whole when the one and the other are done, roughly


@dataclass(frozen=True, eq=False)
class Experiments:
    """What a study gave.

    Attributes:
        preparation: under which the results came about.
        results: label -> result; the label is the data set's code, with a `c` where the compensation was left in.
        physical: payload [kg] -> lowest modes of the physical model.
        compared: the same under the study's other preparation, where there is one.
    """

    study: ExperimentsBlock
    preparation: NamedConditioningBlock
    recorded: tuple[StudyTrace, ...]
    results: dict[str, SetResult]
    physical: dict[float, tuple[PhysicalMode, ...]]
    compared: Experiments | None = None

    def example(self, name: str) -> ExampleBlock:
        """The study's example of this name."""
        return next(example for example in self.study.examples if example.name == name)

    @property
    def reductions(self) -> dict[str, ReductionExample]:
        """By the example's name, in the study's order."""
        found = {
            reduction.example.name: reduction for result in self.results.values() for reduction in result.reductions
        }
        return {example.name: found[example.name] for example in self.study.examples}


def run(
    study: ExperimentsBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None = None
) -> Experiments:
    """All data sets of a study.

    Args:
        base: folder of the study file.
        data: folder with the data sets as CSV files named by their codes, to take instead of simulating them.
        isolation: of FMUs that are simulated.

    Raises:
        InputError: the study and its data do not fit together.
        FmuError: a simulation failed, or a process died.
    """
    physical = {
        payload: _physical(study, payload) for payload in sorted({known.payload for known in study.sets.values()})
    }
    preparations = [study.preparation, *([study.compare] if study.compare else [])]
    with Workers(calling, processors(), [__name__]) as pool:
        recorded = _read(study, base, data) if data else _simulated(pool, study, base, progress, isolation)
        recorded = in_common_units(recorded, [study.input, *study.outputs])
        sets = [_data_sets(study, preparation, recorded, physical) for preparation in preparations]
        results = _identified(pool, list(itertools.chain(*sets)), progress)
    made = [
        Experiments(study, preparation, tuple(recorded), {own.label: results[own] for own in owns}, physical)
        for preparation, owns in zip(preparations, sets, strict=True)
    ]
    return replace(made[0], compared=made[1] if study.compare else None)


def _identified(pool: Workers, sets: list[DataSet], progress: Progress) -> dict[DataSet, SetResult]:
    results: dict[DataSet, SetResult] = {}
    for number, result in _answers(pool, [partial(identified, own) for own in sets]):
        results[sets[number]] = result
        done = SIMULATED + (IDENTIFIED - SIMULATED) * len(results) / len(sets)
        progress(done, f"{len(results)} of {len(sets)} identified, {sets[number].label}")
    return results


def _physical(study: ExperimentsBlock, payload: float) -> tuple[PhysicalMode, ...]:
    how = study.physical
    return physical_modes(how.model, how.without | {how.payload: payload})[: how.modes]


def _data_sets(
    study: ExperimentsBlock,
    preparation: NamedConditioningBlock,
    recorded: list[StudyTrace],
    physical: dict[float, tuple[PhysicalMode, ...]],
) -> list[DataSet]:
    """All of the study, those with a compensation a second time with it left in."""
    traces = {known.trace.name: known.trace for known in recorded}
    return [
        data_set(study, preparation.preparation(), code, removed, traces, physical[known.payload])
        for code, known in study.sets.items()
        for removed in ((True, False) if known.compensation else (True,))
    ]


def _read(study: ExperimentsBlock, base: Path, data: Path) -> list[StudyTrace]:
    return _wanted(study, load_campaign(TraceSource(base, files="**/*.csv"), data))


def _simulated(
    pool: Workers, study: ExperimentsBlock, base: Path, progress: Progress, isolation: Isolation | None
) -> list[StudyTrace]:
    found: list[StudyTrace] = []
    scenarios = [base / path for path in study.scenarios]
    tasks = [partial(_simulate, path, isolation) for path in scenarios]
    for done, (number, cases) in enumerate(_answers(pool, tasks), start=1):
        found += cases
        progress(SIMULATED * done / len(scenarios), f"simulated {scenarios[number].stem}")
    return _wanted(study, found)


def _simulate(scenario: Path, isolation: Isolation | None) -> list[StudyTrace]:
    return load_campaign(TraceSource(scenario.parent, scenario=scenario), isolation=isolation)


def _wanted(study: ExperimentsBlock, found: list[StudyTrace]) -> list[StudyTrace]:
    """Those that are data sets, by name."""
    missing = sorted(set(study.sets) - {recording.trace.name for recording in found})
    if missing:
        raise ScenarioError(f"sets.{missing[0]}", "no scenario or file has this name", "correct `scenarios`, or --data")
    return sorted(
        (recording for recording in found if recording.trace.name in study.sets),
        key=lambda recording: recording.trace.name,
    )


def _answers(pool: Workers, tasks: Sequence[Callable[[], Any]]) -> Iterator[tuple[int, Any]]:
    """(number of the task, what it gives), as they come."""
    for number, answer in pool.answers(tasks):
        if isinstance(answer, Died):
            raise FmuError("study", "a process died", "look for a crash in the FMUs, or for too little memory")
        yield number, answer
