"""State-space models from records: observability range space extraction (ORSE) and its relatives.

`subspace` is the one way in: it extracts the range space, chooses the order, and realises the model; `scan` realises
many orders from one extraction. ORSE is biased by feedback; `SubspaceSettings(closed_loop=True)` is the remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.linear.hankel import Compression
from identification.linear.input_matrices import InputFit, fit_inputs
from identification.linear.model import LinearModel
from identification.linear.poles import PoleMove, constrained, injecting
from identification.linear.records import InputOutputData, Records, without_gaps
from identification.subspace.orders import Best, OrderRule, checked, from_singular_values
from identification.subspace.range_space import RangeSpace, SubspaceSettings, range_space
from orchestrator.trace import BoolArray, FloatArray

__all__ = ["SubspaceResult", "SubspaceSettings", "realise", "scan", "simulated", "subspace"]


@dataclass(frozen=True, eq=False)
class SubspaceResult:
    """A model with the evidence for it.

    Attributes:
        model: A, B, C, D.
        why: how its order came about.
        singular_values: (r,) of the weighted projection; the published ones (Eq. 2-21) are their squares.
        initial_states: (R, n), one a record.
        records: what was fitted: the given records cut at gaps.
        rms: (R, p) root mean square of the free run's error [each output's unit] (thesis, Eq. 2-24).
        delta: (R, p) the same over the output's (Eq. 2-25); nan for an output that is 0, inf for a run that overflows.
        gain: (n, p) Kalman gain where the estimate is of the predictor (closed loop), else None.
        moves: poles put elsewhere on request.
        condition, compression: of the compressed data, see `hankel.Factor`.
        excitation: condition of the input's block Hankel matrix.
        dropped, lost: pieces between gaps that were too short, and samples in them.
    """

    model: LinearModel
    why: str
    singular_values: FloatArray
    initial_states: FloatArray
    records: tuple[InputOutputData, ...]
    rms: FloatArray
    delta: FloatArray
    gain: FloatArray | None
    moves: tuple[PoleMove, ...]
    condition: float
    compression: Compression
    excitation: float
    dropped: int
    lost: int

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    @property
    def mean_delta(self) -> float:
        """Delta-bar of Eq. 2-25, over all records' outputs that are not 0; nan where all are."""
        return _mean(self.delta)


@single_threaded
def subspace(records: Records, order: OrderRule, settings: SubspaceSettings) -> SubspaceResult:
    """The linear model of all records together.

    Args:
        records: of the same step and columns; NaN in them are gaps.
        order: the order, or how it is found: `Threshold`, `Gap` or `Best` of `identification.orders`.
        settings: the block size, the weighting, and what else is asked of the model.

    Raises:
        IdentificationError: the records, or what they excite, do not bear the estimate.

    Source: the flexible-manipulator thesis, Section 2.2.3, for weighting "orse".
    """
    space = range_space(records, settings)
    if isinstance(order, Best):
        return _best(space, order)
    return realise(space, *from_singular_values(order, space.values, space.limit))


@single_threaded
def scan(records: Records, orders: Iterable[int], settings: SubspaceSettings) -> tuple[SubspaceResult, ...]:
    """A model of each order, all from one decomposition."""
    space = range_space(records, settings)
    return tuple(realise(space, order) for order in orders)


@single_threaded
def realise(space: RangeSpace, order: int, why: str = "") -> SubspaceResult:
    """The model of this order in a range space.

    Raises:
        IdentificationError: the block size or the data do not bear the order, or the poles cannot be had.
    """
    checked(order, space.values, space.limit)
    a, c = space.shift_invariant(order)
    fitted = _by_prediction(space, a, c) if space.settings.closed_loop else _by_simulation(space, a, c)
    first, scale = space.pieces.records[0], 1 / space.weights
    model = LinearModel(
        fitted.a,
        fitted.fit.b,
        c * scale[:, None],
        fitted.fit.d * scale[:, None],
        first.step,
        first.inputs,
        first.outputs,
    )
    rms, delta = _errors(model, space.pieces.records, fitted.fit.starts)
    return SubspaceResult(
        model=model,
        why=why or f"order {order} was asked for",
        singular_values=space.values,
        initial_states=fitted.fit.starts,
        records=space.pieces.records,
        rms=rms,
        delta=delta,
        gain=None if fitted.gain is None else fitted.gain / scale,
        moves=fitted.moves,
        condition=space.condition,
        compression=space.compression,
        excitation=space.excitation,
        dropped=space.pieces.dropped,
        lost=space.pieces.lost,
    )


@single_threaded
def simulated(model: LinearModel, records: Sequence[InputOutputData], horizon: int | None = None) -> list[FloatArray]:
    """(K, p) free runs of a model along records it was not fitted to, each from its own least-squares initial state.

    Args:
        horizon: samples at the start from which the initial state is estimated; the whole record when None.
    """
    runs, none = [], np.zeros((len(model.outputs), 0), dtype=bool)
    for each in records:
        part = slice(0, horizon)
        driven = model.simulate(each.u[part])
        known = fit_inputs(model.a, model.c, [(each.u[part, :0], each.y[part] - driven)], none)
        runs.append(model.simulate(each.u, known.starts[0]))
    return runs


@dataclass(frozen=True, eq=False)
class _Fitted:
    a: FloatArray
    fit: InputFit
    gain: FloatArray | None
    moves: tuple[PoleMove, ...]


def _by_simulation(space: RangeSpace, a: FloatArray, c: FloatArray) -> _Fitted:
    """B, D and initial states by the free run's error (ORSE, step 5)."""
    a, moves = constrained(a, space.settings.poles)
    data = [(each.u, each.y * space.weights) for each in space.pieces.records]
    fit = fit_inputs(a, c, data, _feedthrough(space), starts=space.settings.initial_states)
    return _Fitted(a, fit, None, moves)


def _by_prediction(space: RangeSpace, predictor: FloatArray, c: FloatArray) -> _Fitted:
    """B, D, the gain and initial states by the one-step error, which feedback does not bias.

    The predictor has inputs u and y and the matrices A - K C, [B - K D, K], C, [D, 0].
    """
    settings, inputs = space.settings, len(space.pieces.records[0].inputs)
    predictor, _ = constrained(predictor, "stable")
    data = [(each.u, each.y * space.weights) for each in space.pieces.records]
    both = [(np.hstack([u, y]), y) for u, y in data]
    mask = np.hstack([_feedthrough(space), np.zeros((len(c), len(c)), dtype=bool)])
    fit = fit_inputs(predictor, c, both, mask, starts=settings.initial_states)
    gain = fit.b[:, inputs:]
    more, moves = injecting(predictor + gain @ c, c, settings.poles)
    if moves:
        gain = gain + more
        fit = _refitted(predictor, gain, c, data, _feedthrough(space), starts=settings.initial_states)
    b, d = fit.b[:, :inputs], fit.d[:, :inputs]
    return _Fitted(predictor + gain @ c, InputFit(b + gain @ d, d, fit.starts), gain, moves)


def _refitted(
    predictor: FloatArray,
    gain: FloatArray,
    c: FloatArray,
    data: Sequence[tuple[FloatArray, FloatArray]],
    feedthrough: BoolArray,
    *,
    starts: bool,
) -> InputFit:
    """The predictor's fit when its gain is known: what the measured outputs contribute is taken off first."""
    names = tuple(f"y{i}" for i in range(len(c)))
    observer = LinearModel(predictor, gain, c, np.zeros((len(c), len(c))), 1.0, names, names)
    left = [(u, y - observer.simulate(y)) for u, y in data]
    return fit_inputs(predictor, c, left, feedthrough, starts=starts)


def _best(space: RangeSpace, rule: Best) -> SubspaceResult:
    results, refused = [], IdentificationError("order", "no order is to be tried", "give a range")
    for order in sorted(rule.orders):
        try:
            results.append(realise(space, order))
        except IdentificationError as error:
            refused = error
    if not results:
        raise refused
    errors = np.array([_judged(result, rule.validation) for result in results])
    least = float(np.min(errors))
    if not np.isfinite(least):
        raise IdentificationError("order", "no order gives a bounded free run", "ask for stable poles")
    chosen = int(np.argmax(errors <= least * (1 + rule.margin)))
    why = (
        f"mean delta {errors[chosen]:.4g} at order {results[chosen].order}, the least is {least:.4g} "
        f"of the {len(results)} orders that could be had of {len(rule.orders)}"
    )
    return replace(results[chosen], why=why)


def _judged(result: SubspaceResult, validation: Sequence[InputOutputData]) -> float:
    """Mean delta, inf where a run overflows."""
    if not validation:
        return result.mean_delta
    records = without_gaps(validation, result.order + 1).records
    runs = simulated(result.model, records)
    return _mean(np.array([_delta(each.y, run) for each, run in zip(records, runs, strict=True)]))


def _mean(deltas: FloatArray) -> float:
    known = deltas[~np.isnan(deltas)]
    return float(known.mean()) if len(known) else np.nan


def _errors(
    model: LinearModel, records: Sequence[InputOutputData], starts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(R, p) rms and delta of the free runs."""
    runs = [model.simulate(each.u, start) for each, start in zip(records, starts, strict=True)]
    pairs = [(each.y, run) for each, run in zip(records, runs, strict=True)]
    return np.array([_rms(y - run) for y, run in pairs]), np.array([_delta(*pair) for pair in pairs])


def _delta(y: FloatArray, run: FloatArray) -> FloatArray:
    size = _rms(y)
    return np.divide(_rms(y - run), size, out=np.full_like(size, np.nan), where=size > 0)


def _rms(error: FloatArray) -> FloatArray:
    """(p,) root mean square; inf where an unstable run overflowed."""
    with np.errstate(over="ignore", invalid="ignore"):
        mean = np.mean(error**2, axis=0)
    return np.sqrt(np.where(np.isnan(mean), np.inf, mean))


def _feedthrough(space: RangeSpace) -> BoolArray:
    first = space.pieces.records[0]
    return np.full((len(first.outputs), len(first.inputs)), space.settings.feedthrough)
