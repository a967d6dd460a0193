"""What a search for parameters has come to: values, what they are worth, how well they match, and doubts about them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Minimum, Point, WindowBlock
from identification.estimation.estimated_value import PriorKnowledge
from identification.estimation.identifiability import Identifiability
from identification.estimation.information import Information
from identification.estimation.parameters import Parameter, ParameterSet
from identification.estimation.uncertainty import Covariance, marked
from identification.estimation.validation import fit
from identification.output_error.search.free_run import Tally
from identification.output_error.search.intervals import LOCAL, Intervals
from identification.output_error.search.problem import Problem
from identification.output_error.search.roughness import Roughness
from identification.output_error.search.steps import FlatStretch
from identification.output_error.times.lateness import OutputLateness
from identification.signals.resolution import ROUNDED
from orchestrator.trace import FloatArray, ReadOnlyArrays

VAGUE = math.log(1e3)  # half of a 95 % interval on a log scale: a factor from which nothing is known


@dataclass(frozen=True, eq=False)
class Shot(ReadOnlyArrays):
    """What segments of windows came to, which were run from start values of their own: where a search may begin.

    Attributes:
        segments: of each window.
        values: name -> parameter.
        starts: component.variable -> (W,) estimated start values of the windows.
        gap: the largest that is left between two segments, in sizes of the states.
        joined: whether that counts for none.
        cost: of the outputs, by least squares.
        noise: standard deviation of the residuals, by which what is known before was weighed.
        growth: how many times as much windows make at most of a deviation at their start.
        blocks: the windows linearised there, as far as segments stay joined.
    """

    KEYS = ("segments", "joined", "gap", "growth", "iterations", "simulations")

    segments: int
    values: Mapping[str, float]
    starts: Mapping[str, FloatArray]
    gap: float
    joined: bool
    cost: float
    iterations: int
    simulations: int
    growth: float
    noise: float
    blocks: tuple[WindowBlock, ...]


@dataclass(frozen=True)
class StartReport:
    """What became of one start vector.

    Attributes:
        values: name -> start value.
        start_cost: on the windows tried; inf when the simulation failed there.
        cost: after a few iterations.
    """

    values: Mapping[str, float]
    start_cost: float
    cost: float


@dataclass(frozen=True)
class OutputNoise:
    """What is left over of an output, taken for noise.

    Attributes:
        std: its rms [unit of the output].
        white: whether it is one, by its tests; `why_not` says which one does not take it for white.
        samples_each: how many samples of it tell as much as one of white noise.
        resolution: step in which the output was recorded [its unit], 0 for none.
    """

    KEYS = ("std", "white", "why_not", "samples_each", "resolution", "rounding")

    output: str
    std: float
    white: bool
    why_not: str
    samples_each: float
    resolution: float

    @property
    def rounding(self) -> float:
        """rms of the recording's rounding [unit of the output]."""
        return self.resolution * ROUNDED


@dataclass(frozen=True, eq=False)
class Estimate(ReadOnlyArrays):
    """Parameters that match the windows, what they are worth, and what it took.

    Attributes:
        values: name -> estimate of every parameter, fixed and tied ones too [its unit].
        std: name -> standard deviation of every estimated or tied one [its unit]; inf when not determined.
        ci95: name -> 95 % interval [its unit]; parameters on a log scale have asymmetric ones.
        free: names of the free parameters, in the order of z and covariance.
        z: (n,) scaled free vector.
        covariance: (n, n) of the free parameters [product of their units]; nan beside an undetermined one.
        uncertainty: how it was computed, and the residual tests.
        initial_states: name -> (W,) start values, fixed or estimated.
        initial_std: name -> (W,) standard deviations of the estimated ones.
        cost: the loss at the estimate.
        simulated: (K, m) outputs a window.
        residuals: (K, m) measured - simulated a window [unit of each output].
        fit: (W, m) FIT of every window and output.
        converged: whether the search came to its end, and `message` to which.
        flat: name -> range over which the cost does not tell values apart [its unit], of parameters that act in steps;
            it lies within their intervals.
        warnings: what else a reader of the numbers has to know.
        noise: of each output.
        known: name -> what was known of a parameter before.
        told: which samples inform which parameter; None where the search was stopped.
        late: how late outputs seem to be recorded, where residuals speak for it.
        intervals: how `ci95` came about, where not by `covariance` alone.
        local95: name -> interval by `covariance` of every estimated or tied one [its unit].
        shot: what segments of the windows came to before the search, where they were run.
        rough: name -> own noise of the simulations and steps, of free parameters whose differences that disturbs.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    ci95: Mapping[str, tuple[float, float]]
    free: tuple[str, ...]
    z: FloatArray
    covariance: FloatArray
    uncertainty: Covariance
    identifiability: Identifiability
    initial_states: Mapping[str, FloatArray]
    initial_std: Mapping[str, FloatArray]
    cost: float
    simulated: tuple[FloatArray, ...]
    residuals: tuple[FloatArray, ...]
    fit: FloatArray
    iterations: int
    converged: bool
    message: str
    starts: tuple[StartReport, ...]
    tally: Tally
    warnings: tuple[str, ...]
    flat: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    noise: tuple[OutputNoise, ...] = ()
    known: Mapping[str, PriorKnowledge] = field(default_factory=dict)
    told: Information | None = None
    late: OutputLateness | None = None
    intervals: Intervals = LOCAL
    local95: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    shot: Shot | None = None
    rough: Mapping[str, Roughness] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class Prediction(ReadOnlyArrays):
    """Free runs with given parameters.

    Attributes:
        simulated: (K, m) outputs a window.
        initial_states: name -> (W,) start values, fixed or estimated.
        fit: (W, m) FIT of every window and output.
    """

    simulated: tuple[FloatArray, ...]
    initial_states: Mapping[str, FloatArray]
    fit: FloatArray


@dataclass
class Reached:
    """How far an estimation has come.

    Attributes:
        found: the best so far on all windows, None before there is something better than the start.
        wide: column -> width of its differences, of the parameters that act in steps.
        flats: column -> over which z the cost does not tell such a parameter's values apart.
        rough: column -> own noise of the simulations along it, of those without tangents whose differences it disturbs.
        noise: standard deviation of the residuals, by which what is known before is weighed.
        shot: what segments of the windows came to before, where they were run.
    """

    tally: Tally = field(default_factory=Tally)
    starts: tuple[StartReport, ...] = ()
    found: Minimum | None = None
    wide: Mapping[int, float] = field(default_factory=dict)
    flats: Mapping[int, FlatStretch] = field(default_factory=dict)
    rough: Mapping[int, Roughness] = field(default_factory=dict)
    noise: float = 1.0
    shot: Shot | None = None


def assembled(
    problem: Problem,
    reached: Reached,
    found: Minimum,
    uncertainty: Covariance,
    seen: Identifiability,
    intervals: Intervals = LOCAL,
    told: Information | None = None,
    late: OutputLateness | None = None,
) -> Estimate:
    """What a search has come to, as people and files need it; `doubts` says what is to be told of it."""
    z = found.at.point.parameters
    given = np.sqrt(np.diag(uncertainty.matrix)) * uncertainty.quantile
    uncertainty = _without(uncertainty, _undetermined(problem.parameters, given, reached.flats))
    deviations = np.sqrt(np.diag(uncertainty.matrix))
    slopes = problem.parameters.slopes(z)
    simulated, residuals, fits = outputs(problem, found.at)
    local = _intervals(problem.parameters, z, deviations * uncertainty.quantile, reached.flats)
    return Estimate(
        values=problem.parameters.values(z),
        std=_with_ties(problem.parameters, dict(zip(seen.names, (float(s) for s in deviations * slopes), strict=True))),
        ci95=_with_tied_ends(problem.parameters, local | dict(intervals.ends)),
        free=seen.names,
        z=z,
        covariance=uncertainty.matrix * np.outer(slopes, slopes),
        uncertainty=uncertainty,
        identifiability=seen,
        initial_states=initial_states(problem, found.at.point),
        initial_std={s.name: uncertainty.states[:, i] * s.size for i, s in enumerate(problem.estimated)},
        cost=found.at.cost,
        simulated=simulated,
        residuals=residuals,
        fit=fits,
        iterations=found.iterations,
        converged=found.converged,
        message=found.message,
        starts=reached.starts,
        tally=reached.tally,
        warnings=(),
        flat=_flat_ranges(problem.parameters, reached.flats, given),
        noise=_noise(problem, uncertainty, residuals),
        known=_known(problem, z, deviations * slopes),
        told=told,
        late=late,
        intervals=intervals,
        local95=_with_tied_ends(problem.parameters, local),
        shot=reached.shot,
        rough={problem.parameters.free[c].name: one for c, one in reached.rough.items() if c < len(z)},
    )


def _with_ties(parameters: ParameterSet, std: dict[str, float]) -> dict[str, float]:
    return std | {tie.name: abs(tie.factor) * std[tie.other] for tie in parameters.ties if tie.other in std}


def _undetermined(parameters: ParameterSet, reach: FloatArray, flats: Mapping[int, FlatStretch]) -> list[int]:
    """Columns of parameters without effect, and of those on a log scale of which not even the size is known.

    Args:
        reach: (n,) half of the 95 % interval in z.
    """
    silent = [column for column, range_ in flats.items() if range_.silent]
    vague = [c for c, p in enumerate(parameters.free) if p.scale == "log" and VAGUE < reach[c] < math.inf]
    return sorted({*silent, *vague})


def _without(uncertainty: Covariance, lost: Sequence[int]) -> Covariance:
    """The same in which these parameters are not determined."""
    matrices = {method: marked(matrix, lost) for method, matrix in uncertainty.matrices.items()}
    return replace(uncertainty, matrices=matrices) if lost else uncertainty


def _flat_ranges(
    parameters: ParameterSet, flats: Mapping[int, FlatStretch], reach: FloatArray
) -> dict[str, tuple[float, float]]:
    """name -> flat range of those that are not silent, where it is more than noise explains."""
    known = {parameters.free[c]: f for c, f in flats.items() if not f.silent and not f.width < reach[c] < math.inf}
    return {p.name: (_end(p, range_.low), _end(p, range_.high)) for p, range_ in known.items()}


def _intervals(
    parameters: ParameterSet, z: FloatArray, reach: FloatArray, flats: Mapping[int, FlatStretch]
) -> dict[str, tuple[float, float]]:
    """name -> local interval of the free ones, symmetric in z; about a flat range where there is one."""
    intervals = {}
    for column, (p, zi, r) in enumerate(zip(parameters.free, z, reach, strict=True)):
        range_ = flats.get(column)
        low, high = (zi, zi) if range_ is None or range_.silent else (min(zi, range_.low), max(zi, range_.high))
        own = 0.0 if high > low and math.isinf(r) else r
        intervals[p.name] = (_end(p, float(low - own)), _end(p, float(high + own)))
    return intervals


def _with_tied_ends(
    parameters: ParameterSet, intervals: Mapping[str, tuple[float, float]]
) -> dict[str, tuple[float, float]]:
    """The intervals of the free ones, and of what is tied to them."""
    found = dict(intervals)
    for tie in parameters.ties:
        if tie.other in intervals and tie.factor:
            low, high = sorted(tie.factor * end for end in intervals[tie.other])
            found[tie.name] = (low, high)
    return found


def _end(parameter: Parameter, z: float) -> float:
    """An interval's end, which may lie beyond the bounds."""
    if parameter.scale == "log" and z > 700:
        return math.inf
    return parameter.unbounded(z)


def initial_states(problem: Problem, point: Point) -> dict[str, FloatArray]:
    """name -> (W,) start values at a point."""
    rows = [problem.initial_values(w, z) for w, z in enumerate(point.states)]
    return {state.name: np.array([row[state.name] for row in rows]) for state in problem.initial_states}


def outputs(problem: Problem, at: Iterate) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...], FloatArray]:
    """Simulated outputs and errors, (K, m) a window, and FIT (W, m)."""
    residuals = problem.measured_only(at.residuals, range(len(problem.windows)))
    pairs = list(zip(problem.windows, residuals, strict=True))
    errors = tuple(-residual.reshape(window.measured.shape) / window.weight for window, residual in pairs)
    simulated = tuple(window.measured - error for window, error in zip(problem.windows, errors, strict=True))
    fits = np.array([fit(window.measured, y) for window, y in zip(problem.windows, simulated, strict=True)])
    return simulated, errors, fits


def _noise(problem: Problem, uncertainty: Covariance, residuals: Sequence[FloatArray]) -> tuple[OutputNoise, ...]:
    """What is left over of each output."""
    stacked = np.concatenate(list(residuals))
    steps = [np.zeros(len(problem.outputs)) if w.resolution is None else w.resolution for w in problem.windows]
    coarsest = np.max(steps, axis=0)
    return tuple(
        OutputNoise(
            output=name,
            std=float(np.sqrt(np.mean(stacked[:, i] ** 2))),
            white=test.white,
            why_not="" if test.white else test.why_not,
            samples_each=1.0 if test.white else float(uncertainty.samples_each[i]),
            resolution=float(coarsest[i]),
        )
        for i, (name, test) in enumerate(zip(problem.outputs, uncertainty.whiteness, strict=True))
    )


def _known(problem: Problem, z: FloatArray, std: FloatArray) -> dict[str, PriorKnowledge]:
    """What was known of the free parameters before.

    Args:
        std: (n,) standard deviations of the estimates [unit each].
    """
    values, known = problem.parameters.values(z), {}
    for parameter, own in zip(problem.parameters.free, std, strict=True):
        if (prior := parameter.prior) is not None:
            value = values[parameter.name]
            left = min(1.0, (float(own) / prior.std(value)) ** 2)
            known[parameter.name] = PriorKnowledge(prior.text, prior.source, 1.0 - left, prior.distance(value))
    return known
