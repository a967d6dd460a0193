"""Parameters of any system by output error: free runs over windows, made to match what was measured.

The estimator knows simulators only through `workers.Simulator`; what is free is declared in `parameters`.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from fmus.errors import FmuError, IdentificationError
from identification.estimation.arrow_least_squares import LEAST_SQUARES, Iterate, Minimum, Point, evaluated
from identification.estimation.identifiability import Identifiability
from identification.estimation.stopped import reason, stopped
from identification.estimation.threads import single_threaded
from identification.estimation.uncertainty import no_covariance
from identification.estimation.workers import Factory, open_pool
from identification.output_error.search.bootstrap import require_windows
from identification.output_error.search.doubts import doubts
from identification.output_error.search.estimate import (
    Estimate,
    Prediction,
    Reached,
    Shot,
    StartReport,
    assembled,
    initial_states,
    outputs,
)
from identification.output_error.search.free_run import FreeRun
from identification.output_error.search.options import SearchOptions, Watch
from identification.output_error.search.problem import Problem
from identification.output_error.search.refits import GROWN, Spoken, spoken
from identification.output_error.search.roughness import roughness
from identification.output_error.search.steps import best_nearby, centred, flat, restless, widened
from identification.output_error.search.work import Work, search, spread
from orchestrator.trace import FloatArray

_ROUNDS = 3  # of looking beside the steps of parameters that act in steps, and searching on from there
_FIRST_NOISE = 1e-3  # of the outputs' spread, until something is known of it
_WEIGHINGS, _SETTLED = 6, 0.1  # how often the noise is estimated anew, and from which fall on it is not
JOINED = "segments have joined, and free runs over whole windows are theirs"
APART = "stopped: segments have not joined"
DEPARTED = "segments have joined, but free runs over whole windows leave them, as rounding grows too much"
_DEPARTED = 1e-2  # of the outputs' spread
SILENT = "nothing to find: the outputs do not depend on"


@single_threaded
def estimate(
    problem: Problem,
    factory: Factory,
    options: SearchOptions | None = None,
    watch: Watch | None = None,
    shot: Shot | None = None,
) -> Estimate:
    """The parameters and initial states whose free runs match the windows best.

    The search begins at what segments of the windows came to (`shot`), where there are some. The result does not depend
    on the number of processes. A simulation that fails is counted and its point rejected.

    Raises:
        IdentificationError: nothing is free, or outputs do not fit the windows.
        FmuError: no start can be simulated, or simulating processes kept dying.
        EstimationInterrupted, EstimationFailed: an interrupt or such an error came when there was something better than
            the start already; it carries the estimate so far, without uncertainty.
    """
    options = options or SearchOptions()
    if not problem.unknowns:
        raise IdentificationError("parameters", "nothing is free", "free a parameter, or use predict")
    if options.intervals.by == "bootstrap":
        require_windows(len(problem.windows), len(problem.parameters.free))
    reached = Reached(shot=shot)
    try:
        with open_pool(factory, options.processes, options.isolation) as pool:
            work = Work(problem, options, pool, reached, watch)
            reached.noise = _FIRST_NOISE * spread(problem)
            begin, reached.starts = _begin(work)
            if shot is not None and shot.growth >= GROWN:
                found, reached.noise = _shot(problem, begin, shot), shot.noise
                said = spoken(work, found)
            else:
                reached.wide = _difference_steps(work, begin)
                found, said = _fitted(work, begin)
    except (KeyboardInterrupt, FmuError) as error:
        if reached.found is None:
            raise
        found, size = replace(reached.found, message=f"stopped: {reason(error)}"), len(problem.parameters.free)
        left = problem.measured_only(found.at.residuals, range(len(problem.windows)))
        nothing = no_covariance(left, size, len(problem.estimated), len(problem.outputs))
        names = tuple(parameter.name for parameter in problem.parameters.free)
        unseen = Identifiability(names, np.zeros(0), np.full((size, size), np.nan), ())
        raise stopped(error, _told(problem, assembled(problem, reached, found, nothing, unseen))) from error
    free = problem.parameters.free
    silent = [free[c].name for c, range_ in reached.flats.items() if range_.silent]
    if silent:
        found = replace(found, converged=False, message=f"{SILENT} {', '.join(silent)}")
    return _told(
        problem, assembled(problem, reached, found, said.uncertainty, said.seen, said.intervals, said.told, said.late)
    )


def _told(problem: Problem, found: Estimate) -> Estimate:
    return replace(found, warnings=tuple(doubts(problem, found)))


def _fitted(work: Work, begin: Iterate) -> tuple[Minimum, Spoken]:
    """The minimum and what is said of it; from a better point that profiles met the search goes on."""
    found = _beside_steps(work, _weighed(work, begin))
    said = spoken(work, found)
    for _ in range(_ROUNDS):
        if said.better is None:
            break
        again = search(work, work.all_windows, said.better, "fit", work.options.max_evaluations)
        found = _beside_steps(work, replace(again, iterations=found.iterations + again.iterations))
        said = spoken(work, found)
    if said.better is not None:
        found = replace(found, converged=False, message="stopped: profiles meet better points again and again")
    return found, said


def _weighed(work: Work, begin: Iterate) -> Minimum:
    """The minimum; what is known before counts by the noise that is left over where it counts for little.

    So that a prior which the recordings contradict shows as that, and is not obeyed at the price of more noise.
    """
    problem, reached, windows = work.problem, work.reached, work.all_windows
    found = search(work, windows, begin, "fit", work.options.max_evaluations)
    for _ in range(_WEIGHINGS if problem.parameters.is_known_of else 0):
        left = np.concatenate(problem.measured_only(found.at.residuals, windows))
        power = float(np.sum(problem.loss.influence(left) ** 2))
        noise, before = math.sqrt(power / max(problem.samples - problem.unknowns, 1)), reached.noise
        reached.noise = noise
        at = replace(found.at, residuals=work.over(windows).informed(found.at))
        again = search(work, windows, replace(at, cost=problem.loss.cost(at.residuals)), "fit", _left(work, found))
        found = replace(again, iterations=found.iterations + again.iterations)
        if noise > (1 - _SETTLED) * before:
            break
    return found


def _left(work: Work, found: Minimum) -> int:
    """Iterations that may follow."""
    return max(1, work.options.max_evaluations - found.iterations)


@single_threaded
def fitted_only(problem: Problem, factory: Factory, options: SearchOptions) -> FloatArray:
    """(W, m) FIT where the search ends; nothing is said of the parameters there, which takes as long as to find them.

    Raises:
        FmuError: no start can be simulated, or simulating processes kept dying.
    """
    reached = Reached(noise=_FIRST_NOISE * spread(problem))
    with open_pool(factory, options.processes, options.isolation) as pool:
        work = Work(problem, options, pool, reached, None)
        begin, _ = _begin(work)
        reached.wide = _difference_steps(work, begin)
        return outputs(problem, _weighed(work, begin).at)[2]


@single_threaded
def predict(problem: Problem, factory: Factory, options: SearchOptions | None = None) -> Prediction:
    """Free runs with the parameters at their start values; estimated initial states are fitted, nothing else.

    For windows kept aside: `predict(unseen.fixed_at(estimate.values), factory)`.

    Raises:
        FmuError: a window cannot be simulated.
    """
    options = options or SearchOptions()
    problem = problem.fixed_at({})
    with open_pool(factory, options.processes, options.isolation) as pool:
        work = Work(problem, options, pool, Reached(), None)
        windows = work.all_windows
        begin = evaluated(work.over(windows), problem.start(windows), problem.loss)
        if begin is None:
            raise FmuError("prediction", f"a window cannot be simulated: {work.tally.reasons[0]}")
        end = search(work, windows, begin, "fit", options.max_evaluations).at if problem.estimated else begin
    simulated, _, fits = outputs(problem, end)
    return Prediction(simulated, initial_states(problem, end.point), fits)


def _acting_in_steps(work: Work, here: Iterate) -> dict[int, float]:
    """Which parameters act in steps, seen on a few windows."""
    run, few = _few(work, here)
    return widened(replace(run, wide={}), few)


def _difference_steps(work: Work, here: Iterate) -> dict[int, float]:
    """Which parameters act in steps, once the noise of simulations is known along those that tangents do not give."""
    run, few = _few(work, here)
    unsure = restless(run, few)
    if not unsure:
        return {}
    exact = run.exact(few.point, work.problem.measured_only(few.residuals, run.windows))
    work.reached.rough = roughness(run, few, [c for c in unsure if c not in exact])
    return _acting_in_steps(work, here)


def _few(work: Work, here: Iterate) -> tuple[FreeRun, Iterate]:
    """Some of the windows, with all groups, and a point in them."""
    windows = work.problem.with_all_groups(_spread(len(work.all_windows), work.options.start_windows))
    point = replace(here.point, states=here.point.states[list(windows)])
    return work.over(windows), Iterate(point, [here.residuals[w] for w in windows], math.nan)


def _beside_steps(work: Work, found: Minimum) -> Minimum:
    """The minimum beside the steps of what acts in steps, and in the middle of what of it is flat."""
    reached, loss = work.reached, work.problem.loss
    reached.wide = _acting_in_steps(work, found.at)
    for _ in range(_ROUNDS if reached.wide else 0):
        there = best_nearby(work.over(work.all_windows), found.at, loss)
        if there.cost >= found.at.cost:
            break
        again = search(work, work.all_windows, there, "fit", _left(work, found))
        found = replace(again, iterations=found.iterations + again.iterations)
    for column in sorted(column for column in reached.wide if column < len(found.at.point.parameters)):
        run = work.over(work.all_windows)
        range_ = flat(run, found.at, column, loss)
        found = replace(found, at=centred(run, found.at, column, range_, loss))
        reached.flats = {**reached.flats, column: range_}
    return found


def _begin(work: Work) -> tuple[Iterate, tuple[StartReport, ...]]:
    """Where the search on all windows begins: the best of the starts, or the declared one if better there."""
    all_windows = work.all_windows
    windows = work.problem.with_all_groups(_spread(len(all_windows), work.options.start_windows))
    ends: list[Iterate | None] = []
    reports = []
    shot = work.reached.shot
    if shot is None and (work.options.starts > 1 or len(windows) < len(all_windows)):
        for number, parameters in enumerate(_start_vectors(work.problem, work.options)):
            end, report = _followed(work, windows, parameters, f"start {number + 1}")
            ends.append(end)
            reports.append(report)
    points = [work.problem.start(all_windows)]
    if shot is not None:
        points = [work.problem.point(shot.values, shot.starts)]
    best = min((end for end in ends if end is not None), key=lambda end: end.cost, default=None)
    if best is not None:
        points.append(_widened(work.problem, windows, best.point))
    tried = [evaluated(work.over(all_windows), point, work.problem.loss) for point in points]
    begin = min((there for there in tried if there is not None), key=lambda there: there.cost, default=None)
    if begin is None:
        raise work.tally.no_start("")
    return begin, tuple(reports)


def _shot(problem: Problem, there: Iterate, shot: Shot) -> Minimum:
    """Where segments have joined, of windows too long to be searched by free runs."""
    if not shot.joined:
        return Minimum(there, shot.iterations, False, APART)
    left = LEAST_SQUARES.cost(problem.measured_only(there.residuals, range(len(problem.windows))))
    more = math.sqrt(2 * left / problem.samples) - math.sqrt(2 * shot.cost / problem.samples)
    departs = more > _DEPARTED * spread(problem)
    return Minimum(there, shot.iterations, not departs, DEPARTED if departs else JOINED)


def _spread(count: int, wanted: int) -> tuple[int, ...]:
    """`wanted` of `count` windows, evenly spread; all when most would be."""
    if count <= 2 * wanted:
        return tuple(range(count))
    return tuple(int(i) for i in np.linspace(0, count - 1, wanted).round())


def _start_vectors(problem: Problem, options: SearchOptions) -> list[FloatArray]:
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
    work: Work, windows: tuple[int, ...], parameters: FloatArray, stage: str
) -> tuple[Iterate | None, StartReport]:
    """Where a few iterations on some windows lead from this start; None when it cannot be simulated."""
    problem = work.problem
    point = replace(problem.start(windows), parameters=parameters)
    values = problem.parameters.values(parameters)
    begin = evaluated(work.over(windows), point, problem.loss)
    if begin is None:
        return None, StartReport(values, math.inf, math.inf)
    end = search(work, windows, begin, stage, work.options.start_iterations).at
    return end, StartReport(values, begin.cost, end.cost)


def _widened(problem: Problem, windows: tuple[int, ...], point: Point) -> Point:
    """A point over some windows as one over all; the other windows' states are at their start."""
    everywhere = problem.start(range(len(problem.windows)))
    everywhere.states[list(windows)] = point.states
    return replace(everywhere, parameters=point.parameters)
