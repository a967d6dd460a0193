"""Running points in one process: systems are opened once and reset from run to run."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from time import perf_counter

import numpy as np

from fmus.errors import ServotwinError
from orchestrator.assembly.assembly import OpenSystem
from orchestrator.batch.sweep.points.designs import seed_of
from orchestrator.batch.sweep.points.factors import Factor, Target
from orchestrator.batch.sweep.runs import rows
from orchestrator.batch.sweep.runs.rows import Row
from orchestrator.batch.sweep.runs.setup import Chunk, ChunkResult, Kept, Setup, Variant
from orchestrator.engine import Run, Simulation
from orchestrator.fmi.interface import Value
from orchestrator.processes import last_words
from orchestrator.scenario.run.case import checked, ran
from orchestrator.trace import FloatArray, Trace

MOST_OPEN = 8  # systems at the same time


@dataclass
class _Opened:
    """A system that is open, what drives it, and what is recorded of it.

    Attributes:
        instants: (K,) of the stimuli [s].
        played: place and level of a recording that varies -> (K,) what it is at the instants.
    """

    simulation: Simulation
    stack: ExitStack
    instants: FloatArray
    stimuli: Mapping[str, FloatArray]
    record: tuple[str, ...]
    played: dict[tuple[int, int], FloatArray] = field(default_factory=dict)


class Worker:
    """Runs tasks; holds open systems, belongs to one process, is closed in the end."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self._opened: dict[int, _Opened] = {}
        factors = list(enumerate(setup.space.factors))
        self._variables = [(place, factor) for place, factor in factors if factor.target is Target.VALUE]
        self._inputs = [
            (place, factor) for place, factor in factors if factor.target in (Target.CONSTANT, Target.RECORDING)
        ]

    def __call__(self, task: Chunk) -> ChunkResult:
        """The rows of a task; a run that fails is one of them."""
        begun = perf_counter()
        made = []
        for number, run in enumerate(task.runs.tolist()):
            with last_words.own().working_on(number):
                made.append(self._row(run, task.points[number]))
        data = rows.packed(rows.table(self._setup, task, made))
        failed = sum(row.state == rows.FAILED for row in made)
        return ChunkResult(data, failed, perf_counter() - begun, platform.node())

    def close(self) -> None:
        """Free all systems."""
        while self._opened:
            self._opened.popitem()[1].stack.close()

    def _row(self, run: int, point: FloatArray) -> Row:
        number, case = divmod(run, len(self._setup.cases))
        place, place_of_case = self._setup.place(point, case)
        variant, opened = self._setup.variants[place], self._open(place)
        asked = variant.scenario.cases[place_of_case]
        values = {**asked.values, **self._values(point), **self._seeds(number)}
        found = ran(opened.simulation, Run(values, self._stimuli(opened, point), opened.record), asked)
        if found.error is not None and not asked.may_be_refused:
            return Row(rows.FAILED, str(found.error), False, {})
        try:
            checks = [checked(expected, found) for expected in asked.expected]
        except ServotwinError as odd:
            return Row(rows.FAILED, f"cannot be judged: {odd}", False, {})
        columns = variant.asked[place_of_case]
        counted = [c for c, column in zip(checks, columns, strict=True) if self._setup.asked[column].counts]
        passed = not any(check.failed for check in counted) and (found.error is None or bool(counted))
        ended = found.result.ended if found.result is not None else ""
        told = dict(zip(columns, checks, strict=True))
        kept = None if found.trace is None or self._setup.kept is None else _kept(found.trace, self._setup.kept)
        return Row(rows.ENDED if ended else rows.DONE, ended or None, passed, told, kept)

    def _values(self, point: FloatArray) -> dict[str, Value]:
        return {factor.name: factor.value(point[place]) for place, factor in self._variables}

    def _seeds(self, number: int) -> dict[str, Value]:
        setup = self._setup
        return {f"{name}.seed": seed_of(setup.seed, number, place) for place, name in enumerate(setup.noise)}

    def _stimuli(self, opened: _Opened, point: FloatArray) -> Mapping[str, FloatArray]:
        """What drives the inputs: what the scenario says, but for what varies."""
        if not self._inputs:
            return opened.stimuli
        return {**opened.stimuli, **{one.name: self._driven(opened, place, one, point) for place, one in self._inputs}}

    def _driven(self, opened: _Opened, place: int, factor: Factor, point: FloatArray) -> FloatArray:
        if factor.target is Target.CONSTANT:
            return np.full(len(opened.instants), point[place])
        level = int(point[place])
        if (place, level) not in opened.played:
            stimulus = self._setup.recordings[place][level]
            opened.played[place, level] = stimulus.values(opened.instants, factor.name)
        return opened.played[place, level]

    def _open(self, place: int) -> _Opened:
        if place not in self._opened:
            if len(self._opened) >= MOST_OPEN:
                self._opened.pop(next(iter(self._opened))).stack.close()
            self._opened[place] = _open(self._setup.variants[place], self._setup)
        return self._opened[place]


def _open(variant: Variant, setup: Setup) -> _Opened:
    with ExitStack() as stack:
        system = stack.enter_context(OpenSystem(variant.assembled))
        simulation = stack.enter_context(system.simulation(variant.scenario.timing, setup.isolation))
        scenario = variant.scenario
        instants = simulation.instants() if scenario.stimuli else np.zeros(0)
        varied = {factor.name for factor in setup.space.factors}
        stimuli = {n: one.values(instants, n) for n, one in scenario.stimuli.items() if n not in varied}
        looked_at = [signal for case in scenario.cases for signal in case.looked_at]
        record = tuple(dict.fromkeys([*looked_at, *(setup.kept.signals if setup.kept else ())]))
        return _Opened(simulation, stack.pop_all(), instants, stimuli, record)


def _kept(trace: Trace, kept: Kept) -> list[FloatArray]:
    return [trace.time[:: kept.stride], *(trace[name][:: kept.stride] for name in kept.signals)]
