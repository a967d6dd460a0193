"""Parameters of any system by output error: free runs over windows, made to match what was measured.

The estimator knows simulators only through `workers.Simulator`; what is free is declared in `parameters`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import FmuError, IdentificationError
from identification.estimation.arrow_least_squares import (
    ROUGH,
    Iterate,
    Limits,
    Loss,
    Minimum,
    Point,
    evaluated,
    minimise,
)
from identification.estimation.parameters import InitialState, Parameter, ParameterSet, Tie
from identification.estimation.stopped import reason, stopped
from identification.estimation.uncertainty import (
    Identifiability,
    covariance,
    identifiability,
    no_covariance,
)
from identification.estimation.workers import Factory, Pool, Simulator, open_pool
from identification.output_error.search.estimate import (
    Estimate,
    Prediction,
    Reached,
    StartReport,
    assembled,
    initial_states,
    outputs,
)
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.problem import Problem, Window, spread_weights
from identification.output_error.search.steps import best_nearby, centred, flat, widened
from orchestrator.fmi.isolation import Isolation
from orchestrator.trace import FloatArray

__all__ = [
    "Estimate",
    "Factory",
    "InitialState",
    "Loss",
    "Options",
    "Parameter",
    "ParameterSet",
    "Prediction",
    "Problem",
    "SearchState",
    "Simulator",
    "StartReport",
    "Tie",
    "Window",
    "estimate",
    "predict",
    "spread_weights",
]


_COARSER, _COARSEST = (1.0, 10.0, 100.0), 1e-2  # times the difference step, and where that ends
_VISIBLE = 1e-3  # of FIT
_ROUNDS = 3  # of looking beside the steps of parameters that act in steps, and searching on from there
_PERFECT = 1e-6  # of FIT: what is missing at most in a perfect one
PERFECT = "the outputs match to the accuracy of the simulation"
SILENT = "nothing to find: the outputs do not depend on"


@dataclass(frozen=True)
class Options:
    """How the estimation searches.

    Attributes:
        starts: how many start vectors are tried: the declared one, the others spread between the bounds.
        seed: of that spreading.
        start_windows: each start is followed on this many windows only, spread evenly.
        start_iterations: for so many iterations; the best is then continued on all windows.
        max_evaluations: most points tried on all windows.
        cost_tolerance: converged when the cost falls by less than this, relatively.
        step_tolerance: or when no scaled unknown moves by more than this.
        difference_step: relative step of forward differences, about the root of the simulation's accuracy.
        processes: worker processes; 1 simulates in this process.
        isolation: how long a simulation may take; every one runs in a worker process then, which is replaced when it
            crashes or hangs.
    """

    starts: int = 1
    seed: int = 0
    start_windows: int = 6
    start_iterations: int = 8
    max_evaluations: int = 60
    cost_tolerance: float = 1e-5
    step_tolerance: float = 1e-5
    difference_step: float = 1e-4
    processes: int = 1
    isolation: Isolation | None = None

    def __post_init__(self) -> None:
        for name in ("starts", "start_windows", "start_iterations", "max_evaluations", "processes"):
            if getattr(self, name) < 1:
                raise IdentificationError(f"options.{name}", f"{getattr(self, name)} is too few", "use 1 or more")
        for name in ("cost_tolerance", "step_tolerance", "difference_step"):
            if not 0 < getattr(self, name) < 0.1:
                raise IdentificationError(f"options.{name}", f"{getattr(self, name)} is not within 0 to 0.1")


@dataclass(frozen=True)
class SearchState:
    """Where an estimation stands: stage, iteration within it, cost there, simulations so far."""

    stage: str
    iteration: int
    cost: float
    simulations: int


Watch = Callable[[SearchState], None]
"""Told where an estimation stands."""


@dataclass(frozen=True)
class _Work:
    """One estimation at work."""

    problem: Problem
    options: Options
    pool: Pool
    reached: Reached
    watch: Watch | None

    @property
    def tally(self) -> Tally:
        return self.reached.tally

    def over(self, windows: tuple[int, ...], coarser: float = 1.0) -> FreeRun:
        fine = self.options.difference_step
        step = min(coarser * fine, max(fine, _COARSEST))
        return FreeRun(self.problem, self.pool, self.tally, windows, step, self.reached.wide, tangents=coarser == 1.0)

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

    def limits(self, iterations: int) -> Limits:
        options = self.options
        return Limits(options.max_evaluations, iterations, options.cost_tolerance, options.step_tolerance)


def estimate(
    problem: Problem, factory: Factory, options: Options | None = None, watch: Watch | None = None
) -> Estimate:
    """The parameters and initial states whose free runs match the windows best.

    The result does not depend on the number of processes. A simulation that fails is counted and its point
    rejected.

    Raises:
        IdentificationError: nothing is free, or outputs do not fit the windows.
        FmuError: no start can be simulated, or simulating processes kept dying.
        EstimationInterrupted, EstimationFailed: an interrupt or such an error came when there was something better than
            the start already; it carries the estimate so far, without uncertainty.
    """
    options = options or Options()
    if not problem.unknowns:
        raise IdentificationError("parameters", "nothing is free", "free a parameter, or use predict")
    reached = Reached()
    try:
        with open_pool(factory, options.processes, options.isolation) as pool:
            work = _Work(problem, options, pool, reached, watch)
            begin, reached.starts = _begin(work)
            reached.wide = _acting_in_steps(work, begin)
            found = _search(work, work.all_windows, begin, "fit", options.max_evaluations)
            found = _beside_steps(work, found)
            work.tell("uncertainty")(found.iterations, found.at)
            blocks = work.over(work.all_windows).linearise(found.at.point, found.at.residuals, central=True)
    except (KeyboardInterrupt, FmuError) as error:
        if reached.found is None:
            raise
        found, size = replace(reached.found, message=f"stopped: {reason(error)}"), len(problem.parameters.free)
        nothing = no_covariance(found.at.residuals, size, len(problem.estimated), len(problem.outputs))
        names = tuple(parameter.name for parameter in problem.parameters.free)
        unseen = Identifiability(names, np.zeros(0), np.full((size, size), np.nan), ())
        raise stopped(error, assembled(problem, reached, found, nothing, unseen)) from error
    uncertainty = covariance(blocks, problem.loss, len(problem.outputs))
    values = problem.parameters.values(found.at.point.parameters)
    free = problem.parameters.free
    silent = [free[c].name for c, range_ in reached.flats.items() if range_.silent]
    if silent:
        found = replace(found, converged=False, message=f"{SILENT} {', '.join(silent)}")
    seen = identifiability(
        blocks,
        free,
        np.array([values[parameter.name] for parameter in free]),
        problem.parameters.slopes(found.at.point.parameters),
    )
    return assembled(problem, reached, found, uncertainty, seen)


def predict(problem: Problem, factory: Factory, options: Options | None = None) -> Prediction:
    """Free runs with the parameters at their start values; estimated initial states are fitted, nothing else.

    For windows kept aside: `predict(unseen.fixed_at(estimate.values), factory)`.

    Raises:
        FmuError: a window cannot be simulated.
    """
    options = options or Options()
    problem = problem.fixed_at({})
    with open_pool(factory, options.processes, options.isolation) as pool:
        work = _Work(problem, options, pool, Reached(), None)
        windows = work.all_windows
        begin = evaluated(work.over(windows), problem.start(windows), problem.loss)
        if begin is None:
            raise FmuError("prediction", f"a window cannot be simulated: {work.tally.reasons[0]}")
        end = _search(work, windows, begin, "fit", options.max_evaluations).at if problem.estimated else begin
    simulated, _, fits = outputs(problem, end)
    return Prediction(simulated, initial_states(problem, end.point), fits)


def _search(work: _Work, windows: tuple[int, ...], begin: Iterate, stage: str, iterations: int) -> Minimum:
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


def _missing_fit(problem: Problem, windows: tuple[int, ...], found: Minimum) -> float:
    """By how much FIT of all outputs together falls short of 1; infinite where none moves."""
    spread = [problem.windows[w].weight * (y - y.mean(axis=0)) for w in windows for y in [problem.windows[w].measured]]
    error, size = (np.linalg.norm(np.concatenate([np.ravel(a) for a in of])) for of in (found.at.residuals, spread))
    return float(error / size) if size > 0 else math.inf


def _acting_in_steps(work: _Work, here: Iterate) -> dict[int, float]:
    """Which parameters act in steps, seen on a few windows."""
    windows = _spread(len(work.all_windows), work.options.start_windows)
    point = replace(here.point, states=here.point.states[list(windows)])
    few = Iterate(point, [here.residuals[w] for w in windows], math.nan)
    return widened(replace(work.over(windows), wide={}), few)


def _beside_steps(work: _Work, found: Minimum) -> Minimum:
    """The minimum beside the steps of what acts in steps, and in the middle of what of it is flat."""
    reached, loss = work.reached, work.problem.loss
    reached.wide = _acting_in_steps(work, found.at)
    for _ in range(_ROUNDS if reached.wide else 0):
        there = best_nearby(work.over(work.all_windows), found.at, loss)
        if there.cost >= found.at.cost:
            break
        left = max(1, work.options.max_evaluations - found.iterations)
        again = _search(work, work.all_windows, there, "fit", left)
        found = replace(again, iterations=found.iterations + again.iterations)
    for column in sorted(column for column in reached.wide if column < len(found.at.point.parameters)):
        run = work.over(work.all_windows)
        range_ = flat(run, found.at, column, loss)
        found = replace(found, at=centred(run, found.at, column, range_, loss))
        reached.flats = {**reached.flats, column: range_}
    return found


def _begin(work: _Work) -> tuple[Iterate, tuple[StartReport, ...]]:
    """Where the search on all windows begins: the best of the starts, or the declared one if better there."""
    all_windows = work.all_windows
    windows = _spread(len(all_windows), work.options.start_windows)
    ends: list[Iterate | None] = []
    reports = []
    if work.options.starts > 1 or len(windows) < len(all_windows):
        for number, parameters in enumerate(_start_vectors(work.problem, work.options)):
            end, report = _followed(work, windows, parameters, f"start {number + 1}")
            ends.append(end)
            reports.append(report)
    points = [work.problem.start(all_windows)]
    best = min((end for end in ends if end is not None), key=lambda end: end.cost, default=None)
    if best is not None:
        points.append(_widened(work.problem, windows, best.point))
    tried = [evaluated(work.over(all_windows), point, work.problem.loss) for point in points]
    begin = min((there for there in tried if there is not None), key=lambda there: there.cost, default=None)
    if begin is None:
        reason = work.tally.reasons[0] if work.tally.reasons else "no reason given"
        raise FmuError("start", f"cannot be simulated: {reason}", "change the start values")
    return begin, tuple(reports)


def _spread(count: int, wanted: int) -> tuple[int, ...]:
    """`wanted` of `count` windows, evenly spread; all when most would be."""
    if count <= 2 * wanted:
        return tuple(range(count))
    return tuple(int(i) for i in np.linspace(0, count - 1, wanted).round())


def _start_vectors(problem: Problem, options: Options) -> list[FloatArray]:
    """The declared start and a Latin hypercube between the bounds, all in z, (n,) each."""
    n = len(problem.parameters.free)
    vectors = [np.zeros(n)]
    if options.starts == 1 or n == 0:
        return vectors
    lower, upper = problem.parameters.z_bounds
    for parameter, low, high in zip(problem.parameters.free, lower, upper, strict=True):
        if not (math.isfinite(low) and math.isfinite(high)):
            wanted = "positive and finite" if parameter.scale == "log" else "finite"
            raise IdentificationError(
                parameter.name, "has an open bound, but several starts are asked for", f"give {wanted} bounds"
            )
    from scipy.stats import qmc  # noqa: PLC0415 - loads slowly, and most estimations have one start

    shares = qmc.LatinHypercube(n, seed=options.seed).random(options.starts - 1)
    return vectors + list(lower + (upper - lower) * shares)


def _followed(
    work: _Work, windows: tuple[int, ...], parameters: FloatArray, stage: str
) -> tuple[Iterate | None, StartReport]:
    """Where a few iterations on some windows lead from this start; None when it cannot be simulated."""
    problem = work.problem
    point = replace(problem.start(windows), parameters=parameters)
    values = problem.parameters.values(parameters)
    begin = evaluated(work.over(windows), point, problem.loss)
    if begin is None:
        return None, StartReport(values, math.inf, math.inf)
    end = _search(work, windows, begin, stage, work.options.start_iterations).at
    return end, StartReport(values, begin.cost, end.cost)


def _widened(problem: Problem, windows: tuple[int, ...], point: Point) -> Point:
    """A point over some windows as one over all; the other windows' states are at their start."""
    everywhere = problem.start(range(len(problem.windows)))
    everywhere.states[list(windows)] = point.states
    return replace(everywhere, parameters=point.parameters)
