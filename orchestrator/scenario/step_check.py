"""How far a run is off by the length of its communication steps, seen from runs with shorter ones."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import InputError
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress, silent
from orchestrator.scenario.run.keeping import Keeping
from orchestrator.scenario.run.outcome import ScenarioResult
from orchestrator.scenario.run.scenario import run_scenario
from orchestrator.scenario.scenario import Scenario
from orchestrator.trace import FloatArray, Trace

HEADERS = ("case", "signal", "error", "of its range", "order")
_ROUNDING = 1e-12  # of a signal's range: what tells nothing of its steps
_LEAST, _MOST = 0.5, 6.0  # orders between which a difference falls as the error of a method does


@dataclass(frozen=True)
class StepCost:
    """What the communication step costs a signal of a case.

    Attributes:
        difference: largest over the run between steps h and h/2, at the instants of h.
        share: of the largest less the smallest value of the signal; 0 where that is nought.
        order: p of an error that falls as h^p, by h, h/2 and h/4; None where two of the three are equal to rounding.
    """

    KEYS = ("case", "signal", "unit", "error", "difference", "share", "order")

    case: str
    signal: str
    unit: str
    difference: float
    share: float
    order: float | None

    @property
    def error(self) -> float:
        """Of the run with h: extrapolated (Richardson), or where that cannot be the difference alone."""
        if self.order is None or self.unsettled:
            return self.difference
        return self.difference / (1 - 2**-self.order)

    @property
    def unsettled(self) -> bool:
        """Whether it does not fall with the step as an error does: not at all, or as where h is far too long."""
        return self.order is not None and not _LEAST <= self.order <= _MOST

    def row(self) -> tuple[str, str, str, str, str]:
        """What stands under `HEADERS`."""
        order = "-" if self.order is None else f"{self.order:.2f}"
        return self.case, self.signal, f"{self.error:.3g} {self.unit}".strip(), f"{100 * self.share:.2g} %", order


def step_errors(
    scenario: Scenario,
    result: ScenarioResult,
    progress: Progress = silent,
    isolation: Isolation | None = None,
) -> list[StepCost]:
    """Those of all signals that `result`, a run of the scenario, holds as numbers, by falling share.

    It is run twice more, with a half and a quarter of its step.

    Raises:
        InputError: it holds no number.
        ServotwinError: as `run_scenario`, also where a component cannot take such steps.
    """
    if not any(case.result is None or case.trace.numbers.signals for case in result.cases):
        raise InputError("--check-step", "nothing that is recorded is a number", "name variables in `record`")

    def run(parts: int) -> ScenarioResult:
        keeping = Keeping(result.keeping.every * parts)
        return run_scenario(_shorter(scenario, parts), result.overrides, progress, keeping=keeping, isolation=isolation)

    whole = result if scenario.logger is None else run(1)  # a logger's record is no row a step
    half, quarter = run(2), run(4)
    cases = zip(whole.cases, half.cases, quarter.cases, strict=True)
    whole_cases = [case for case in cases if all(one.result is not None for one in case)]
    found = [error for case in whole_cases for error in _errors(case[0].name, *(one.trace.numbers for one in case))]
    return sorted(found, key=lambda error: -error.share)


def _shorter(scenario: Scenario, parts: int) -> Scenario:
    """With so many steps in the place of one, all of them recorded, and nothing expected."""
    cases = tuple(replace(case, expected=()) for case in scenario.cases)
    return replace(scenario, timing=scenario.timing.finer(parts), cases=cases, logger=None)


def _errors(case: str, whole: Trace, half: Trace, quarter: Trace) -> list[StepCost]:
    found = []
    for name in (name for name in whole.signals if name in half.signals):  # others are there for expectations alone
        values = whole[name]
        coarse, fine = _largest(values, half[name]), _largest(half[name], quarter[name])
        reach = float(np.ptp(values)) if len(values) else 0.0
        told = max(coarse, fine) > _ROUNDING * max(reach, float(np.abs(values).max(initial=0.0)))
        order = math.log2(coarse / fine) if told and coarse > 0 and fine > 0 else None
        found.append(StepCost(case, name, whole.unit(name) or "", coarse, coarse / reach if reach else 0.0, order))
    return found


def _largest(one: FloatArray, other: FloatArray) -> float:
    """Over the instants that both have, for an FMU may have asked to stop earlier."""
    both = min(len(one), len(other))
    return float(np.abs(one[:both] - other[:both]).max(initial=0.0))
