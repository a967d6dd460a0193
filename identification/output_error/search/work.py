"""One estimation at work, and its search from a point to the nearest minimum, however rough the cost is."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.estimation.arrow_least_squares import ROUGH, Iterate, Minimum, SearchLimits, minimise
from identification.estimation.workers import Pool
from identification.output_error.search.estimate import Reached
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.options import SearchOptions, SearchState, Watch
from identification.output_error.search.problem import Problem
from orchestrator.trace import FloatArray

_COARSER, _COARSEST = (1.0, 10.0, 100.0), 1e-2  # times the difference step, and where that ends
_VISIBLE = 1e-3  # of FIT
_PERFECT = 1e-6  # of FIT: what is missing at most in a perfect one
PERFECT = "the outputs match to the accuracy of the simulation"


@dataclass(frozen=True)
class Work:
    """One estimation at work: what it is asked, what it simulates with, and how far it has come."""

    problem: Problem
    options: SearchOptions
    pool: Pool
    reached: Reached
    watch: Watch | None

    @property
    def tally(self) -> Tally:
        return self.reached.tally

    def over(self, windows: tuple[int, ...], coarser: float = 1.0) -> FreeRun:
        fine = self.options.difference_step
        step = min(coarser * fine, max(fine, _COARSEST))
        wide, noise = self.reached.wide, self.reached.noise
        rough = {column: (one.step, one.central) for column, one in self.reached.rough.items()}
        return FreeRun(self.problem, self.pool, self.tally, windows, step, wide, coarser == 1.0, noise, rough)

    @property
    def all_windows(self) -> tuple[int, ...]:
        return tuple(range(len(self.problem.windows)))

    def tell(self, stage: str, taken: int = 0) -> Callable[[int, Iterate], None]:
        def report(iteration: int, there: Iterate) -> None:
            if stage == "fit":
                self.reached.found = Minimum(there, taken + iteration, False, "")
            if self.watch:
                self.watch(SearchState(stage, taken + iteration, there.cost, self.tally.simulations))

        return report

    def at_share(self, share: float) -> Work:
        """The same, which tells that so much of its stage is done."""
        watch = self.watch
        return replace(self, watch=lambda state: watch(replace(state, share=share))) if watch else self

    def limits(self, iterations: int) -> SearchLimits:
        options = self.options
        return SearchLimits(options.max_evaluations, iterations, options.cost_tolerance, options.step_tolerance)


def search(work: Work, windows: tuple[int, ...], begin: Iterate, stage: str, iterations: int) -> Minimum:
    """The minimum; where the cost is too rough for fine differences (by play, dry friction), coarser ones go on."""
    problem, taken = work.problem, 0
    box, limits = problem.box(windows), work.limits(iterations)
    for coarser in _COARSER:
        run, report = work.over(windows, coarser), work.tell(stage, taken)
        found = minimise(run, begin, box, problem.loss, limits=limits, report=report)
        begin, taken = found.at, taken + found.iterations
        if not found.promised:
            break
    return _judged(problem, windows, replace(found, iterations=taken))


def _judged(problem: Problem, windows: tuple[int, ...], found: Minimum) -> Minimum:
    """A search that ended without a better point: at a perfect fit, at what nobody would see, or short of its aim."""
    if found.converged:
        return found
    missing = _missing_fit(problem, windows, found)
    if missing < _PERFECT:
        return replace(found, converged=True, message=PERFECT)
    visible = missing * (1 - math.sqrt(max(0.0, 1 - found.promised)))
    if found.promised and visible < _VISIBLE:
        return replace(found, converged=True, message=ROUGH)
    if found.promised:
        return replace(found, message=f"{found.message}, while slopes promise {visible:.2g} of FIT")
    return found


def is_perfect(work: Work, found: Minimum) -> bool:
    """Whether nothing is left over that could be noise."""
    return _missing_fit(work.problem, work.all_windows, found) < _PERFECT


def _missing_fit(problem: Problem, windows: tuple[int, ...], found: Minimum) -> float:
    """By how much FIT of all outputs together falls short of 1; infinite where none moves."""
    error = float(np.linalg.norm(np.concatenate(problem.measured_only(found.at.residuals, windows))))
    size = float(np.linalg.norm(_moving(problem, windows)))
    return error / size if size > 0 else math.inf


def spread(problem: Problem) -> float:
    """rms of what moves in the outputs, weighted."""
    return float(np.sqrt(np.mean(_moving(problem, range(len(problem.windows))) ** 2)))


def _moving(problem: Problem, windows: Sequence[int]) -> FloatArray:
    cut = [problem.windows[w] for w in windows]
    return np.concatenate([np.ravel(one.weight * (one.measured - one.measured.mean(axis=0))) for one in cut])
