"""Where multiple shooting has a search begin: the segments of a study's windows, joined.

Free runs over long windows leave the recordings where a plant is unstable, integrates or starts far from its
parameters; segments stay near. What they come to as they are joined is where the search over whole windows begins, so
that estimates and intervals are those of the output error.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from identification.estimation.arrow_least_squares import (
    LEAST_SQUARES,
    Box,
    Iterate,
    Point,
    SearchLimits,
)
from identification.estimation.parameters import InitialState
from identification.estimation.threads import single_threaded
from identification.estimation.workers import Factory, open_pool
from identification.output_error.search.estimate import Shot
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.options import SearchOptions, SearchState, Watch
from identification.output_error.search.problem import Problem
from identification.output_error.search.work import spread
from identification.output_error.shooting.guesses import guessed, require_whole
from identification.output_error.shooting.joined import JoinedSegments, join
from identification.output_error.shooting.segments import seen
from identification.output_error.shooting.shots import Shots
from orchestrator.trace import FloatArray

_FIRST_NOISE = 1e-3  # of the outputs' spread, by which what is known before counts at first
_WEIGHINGS = 3  # how often that is done anew by what is left over


@single_threaded
def shoot(shots: Shots, problem: Problem, factory: Factory, options: SearchOptions, watch: Watch | None = None) -> Shot:
    """The parameters and start values at which the segments match the windows best and join.

    Args:
        problem: of the whole windows.
        factory: of simulators of `shots.windows` that record `shots.recorded`.

    Raises:
        IdentificationError: a run that is cut is another one than the whole.
        FmuError: a segment cannot be simulated.
    """
    tally, most = Tally(), options.max_evaluations
    limits = SearchLimits(most, most, options.cost_tolerance, options.step_tolerance)

    def report(iteration: int, there: Iterate) -> None:
        if watch:
            watch(SearchState("segments", iteration, there.cost, tally.simulations))

    with open_pool(factory, options.processes, options.isolation) as pool:
        guesses = guessed(shots, problem, pool)
        require_whole(shots, problem, pool, guesses)
        segmented = _segmented(shots, problem, guesses)
        sizes = np.array([state.size for state in segmented.estimated])
        rows = tuple(range(guesses.shape[0] * shots.count))
        noise, joined = _FIRST_NOISE * spread(problem), None
        start = Point(np.zeros(len(problem.parameters.free)), np.zeros((len(guesses), shots.count * len(sizes))))
        for _ in range(_WEIGHINGS if problem.parameters.is_known_of else 1):
            run = FreeRun(segmented, pool, tally, rows, options.difference_step, tangents=True, noise=noise)
            begin = start if joined is None else joined.found.at.point
            joined = join(run, guesses / sizes, begin, _box(shots, problem, start), limits, report)
            noise = math.sqrt(2 * joined.cost / max(problem.samples - problem.unknowns, 1))
        assert joined is not None
        return _shot(shots, segmented, joined, guesses.shape)


def _shot(shots: Shots, segmented: Problem, joined: JoinedSegments, shape: tuple[int, ...]) -> Shot:
    point = joined.found.at.point
    blocks, grown = joined.system.condensed(point, ~_held(shots))
    scaled = point.states.reshape(shape)
    starts = {
        state.name: np.array([state.value(w * shots.count, z) for w, z in enumerate(scaled[:, 0, i])])
        for i, (state, fixed) in enumerate(zip(segmented.estimated, shots.fixed, strict=True))
        if not fixed
    }
    return Shot(
        segments=shots.count,
        values=segmented.parameters.values(point.parameters),
        starts=starts,
        gap=joined.gap,
        joined=joined.closed,
        cost=joined.cost,
        iterations=joined.found.iterations,
        simulations=joined.system.run.tally.simulations,
        growth=grown,
        noise=joined.system.run.noise,
        blocks=tuple(blocks),
    )


def _segmented(shots: Shots, problem: Problem, guesses: FloatArray) -> Problem:
    """The segments as a problem in which every start value is estimated."""
    whole = len(guesses) * shots.count
    starts = guesses.reshape(whole, -1)
    states = tuple(
        InitialState(state.start, tuple(starts[:, i]), estimated=True) for i, state in enumerate(shots.states)
    )
    sizes = np.array([state.size for state in states])
    weights = [problem.windows[row // shots.count].weight for row in range(whole)]
    windows = [seen(replace(one, weight=w), sizes) for one, w in zip(shots.windows[:whole], weights, strict=True)]
    outputs = (*problem.outputs, *(f"{state.shown} at the end" for state in shots.states))
    return Problem(problem.parameters, tuple(windows), outputs, states, LEAST_SQUARES, problem.grouped)


def _box(shots: Shots, problem: Problem, start: Point) -> Box:
    """The bounds: of the first segments' start values those that are not estimated stay."""
    lower, upper = problem.parameters.z_bounds
    ends = np.broadcast_to(np.where(_held(shots), 0.0, np.inf), start.states.shape)
    return Box(Point(lower, -ends), Point(upper, ends + 0.0), problem.parameters.reach)


def _held(shots: Shots) -> NDArray[np.bool_]:
    """(count s,) which start values of a window stay."""
    later = [False] * len(shots.fixed) * (shots.count - 1)
    return np.array([*shots.fixed, *later])
