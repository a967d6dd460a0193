"""What a search for parameters has come to: values, what they are worth, how well they match, and doubts about them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from identification.estimation.arrow_least_squares import Iterate, Minimum, Point
from identification.estimation.parameters import Parameter, ParameterSet
from identification.estimation.uncertainty import Covariance, Identifiability, marked
from identification.estimation.validation import fit
from identification.output_error.search.free_run import Tally
from identification.output_error.search.problem import Problem
from identification.output_error.search.steps import Flat
from orchestrator.trace import FloatArray, ReadOnlyArrays

_VAGUE = math.log(1e3)  # half of a 95 % interval on a log scale: a factor from which nothing is known


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
    """

    tally: Tally = field(default_factory=Tally)
    starts: tuple[StartReport, ...] = ()
    found: Minimum | None = None
    wide: Mapping[int, float] = field(default_factory=dict)
    flats: Mapping[int, Flat] = field(default_factory=dict)


def assembled(
    problem: Problem, reached: Reached, found: Minimum, uncertainty: Covariance, seen: Identifiability
) -> Estimate:
    """What a search has come to, as people and files need it."""
    z = found.at.point.parameters
    given = np.sqrt(np.diag(uncertainty.matrix)) * uncertainty.quantile
    uncertainty = _without(uncertainty, _undetermined(problem.parameters, given, reached.flats))
    deviations = np.sqrt(np.diag(uncertainty.matrix))
    slopes = problem.parameters.slopes(z)
    simulated, residuals, fits = outputs(problem, found.at)
    partial = Estimate(
        values=problem.parameters.values(z),
        std=_with_ties(problem.parameters, dict(zip(seen.names, (float(s) for s in deviations * slopes), strict=True))),
        ci95=_intervals(problem.parameters, z, deviations * uncertainty.quantile, reached.flats),
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
    )
    return replace(partial, warnings=tuple(_warnings(problem, partial)))


def _with_ties(parameters: ParameterSet, std: dict[str, float]) -> dict[str, float]:
    return std | {tie.name: abs(tie.factor) * std[tie.other] for tie in parameters.ties if tie.other in std}


def _undetermined(parameters: ParameterSet, reach: FloatArray, flats: Mapping[int, Flat]) -> list[int]:
    """Columns of parameters without effect, and of those on a log scale of which not even the size is known.

    Args:
        reach: (n,) half of the 95 % interval in z.
    """
    silent = [column for column, range_ in flats.items() if range_.silent]
    vague = [c for c, p in enumerate(parameters.free) if p.scale == "log" and _VAGUE < reach[c] < math.inf]
    return sorted({*silent, *vague})


def _without(uncertainty: Covariance, lost: Sequence[int]) -> Covariance:
    """The same in which these parameters are not determined."""
    matrices = {method: marked(matrix, lost) for method, matrix in uncertainty.matrices.items()}
    return replace(uncertainty, matrices=matrices) if lost else uncertainty


def _flat_ranges(
    parameters: ParameterSet, flats: Mapping[int, Flat], reach: FloatArray
) -> dict[str, tuple[float, float]]:
    """name -> flat range of those that are not silent, where it is more than noise explains."""
    known = {parameters.free[c]: f for c, f in flats.items() if not f.silent and not f.width < reach[c] < math.inf}
    return {p.name: (_end(p, range_.low), _end(p, range_.high)) for p, range_ in known.items()}


def _intervals(
    parameters: ParameterSet, z: FloatArray, reach: FloatArray, flats: Mapping[int, Flat]
) -> dict[str, tuple[float, float]]:
    """name -> interval, symmetric in z; about a flat range where there is one."""
    intervals = {}
    for column, (p, zi, r) in enumerate(zip(parameters.free, z, reach, strict=True)):
        range_ = flats.get(column)
        low, high = (zi, zi) if range_ is None or range_.silent else (min(zi, range_.low), max(zi, range_.high))
        own = 0.0 if high > low and math.isinf(r) else r
        intervals[p.name] = (_end(p, float(low - own)), _end(p, float(high + own)))
    for tie in parameters.ties:
        if tie.other in intervals and tie.factor:
            low, high = sorted(tie.factor * end for end in intervals[tie.other])
            intervals[tie.name] = (low, high)
    return intervals


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
    pairs = list(zip(problem.windows, at.residuals, strict=True))
    errors = tuple(-residual.reshape(window.measured.shape) / window.weight for window, residual in pairs)
    simulated = tuple(window.measured - error for window, error in zip(problem.windows, errors, strict=True))
    fits = np.array([fit(window.measured, y) for window, y in zip(problem.windows, simulated, strict=True)])
    return simulated, errors, fits


def _warnings(problem: Problem, result: Estimate) -> list[str]:
    """One sentence for everything that makes the numbers worth less than they look."""
    seen = result.identifiability
    named = (combo for combo in (*seen.unseen, *seen.weak) if not set(combo.coefficients) <= set(result.flat))
    warnings = [combination.message for combination in named]
    for name, (low, high) in result.flat.items():
        unit = next(p.unit for p in problem.parameters.free if p.name == name)
        range_ = f"from {low:.6g} to {high:.6g} {unit}"
        warnings.append(f"{name} acts in steps: the outputs do not tell {range_} apart, which its interval holds")
    for parameter in problem.parameters.free:
        warnings += parameter_warnings(parameter, result.values[parameter.name], result.std[parameter.name])
    told = " ".join(warnings)
    for parameter in problem.parameters.free:
        lost = math.isinf(result.std[parameter.name]) and result.uncertainty.method != "none"
        if lost and parameter.name not in told:
            factor = f"a factor of {math.exp(_VAGUE):g} either way"
            warnings.append(f"{parameter.name} is not determined: its 95 % interval would reach over {factor}")
    if result.uncertainty.method == "coloured":
        warnings.append(
            f"residuals are correlated and {len(problem.windows)} windows are too few to judge them by windows: "
            "intervals rest on a fitted noise model and miss model errors, cut the traces into more windows"
        )
    if result.tally.failures:
        failures, total = result.tally.failures, result.tally.simulations
        warnings.append(f"{failures} of {total} simulations failed, first: {result.tally.reasons[0]}")
    return warnings


def parameter_warnings(parameter: Parameter, value: float, std: float) -> list[str]:
    """What makes an estimate worth less than it looks: it lies at a bound, or its sign is not determined."""
    warnings = []
    for bound, word in ((parameter.lower, "lower"), (parameter.upper, "upper")):
        if abs(value - bound) <= 1e-9 * parameter.size:
            at = f"{parameter.name} is at its {word} bound {bound:g} {parameter.unit}"
            warnings.append(f"{at}: its interval is one-sided")
    if math.isfinite(std) and std > abs(value):
        warnings.append(f"{parameter.name} is hardly determined: {value:.3g} with a standard deviation of {std:.3g}")
    return warnings
