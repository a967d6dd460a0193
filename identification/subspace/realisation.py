"""A state-space model in a range space: A and C by shift invariance, B, D and initial states by least squares.

ORSE is biased by feedback; `SubspaceSettings(closed_loop=True)` is the remedy.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.threads import single_threaded
from identification.estimation.validation import delta, rms
from identification.linear.input_matrices import InputFit, fit_inputs
from identification.linear.model import LinearModel
from identification.linear.poles import PoleMove, constrained, injecting
from identification.linear.records import InputOutputData
from identification.subspace.orders import checked
from identification.subspace.range_space import RangeSpace
from orchestrator.trace import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class SubspaceResult:
    """A model with the evidence for it.

    Attributes:
        model: A, B, C, D.
        why: how its order came about.
        space: where it was realised, with singular values and the conditions of the data.
        initial_states: (R, n), one a record.
        rms: (R, p) root mean square of the free run's error [each output's unit] (thesis, Eq. 2-24).
        delta: (R, p) the same over the output's (Eq. 2-25); nan for an output that is 0, inf for a run that overflows.
        gain: (n, p) Kalman gain where the estimate is of the predictor (closed loop), else None.
        moves: poles put elsewhere on request.
    """

    model: LinearModel
    why: str
    space: RangeSpace
    initial_states: FloatArray
    rms: FloatArray
    delta: FloatArray
    gain: FloatArray | None
    moves: tuple[PoleMove, ...]

    @property
    def order(self) -> int:
        """Number of states."""
        return self.model.order

    @property
    def records(self) -> tuple[InputOutputData, ...]:
        """What was fitted: the given records cut at gaps."""
        return self.space.pieces.records

    @property
    def mean_delta(self) -> float:
        """Delta-bar of Eq. 2-25, over all records' outputs that are not 0; nan where all are."""
        return mean(self.delta)


@single_threaded
def realise(space: RangeSpace, order: int, why: str = "") -> SubspaceResult:
    """The model of this order in a range space.

    Raises:
        IdentificationError: the block size or the data do not bear the order, or the poles cannot be had.
    """
    checked(order, space.values, space.limit)
    try:
        return _realised(space, order, why)
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "model", f"of order {order} cannot be computed ({error})", "ask for another"
        ) from None


def _realised(space: RangeSpace, order: int, why: str) -> SubspaceResult:
    a, c = space.shift_invariant(order)
    fitted = _by_prediction(space, a, c) if space.settings.closed_loop else _by_simulation(space, a, c)
    records, scale = space.pieces.records, 1 / space.weights
    b, c, d = fitted.fit.b, c * scale[:, None], fitted.fit.d * scale[:, None]
    model = LinearModel(fitted.a, b, c, d, records[0].step, records[0].inputs, records[0].outputs)
    runs = [model.simulate(record.u, start) for record, start in zip(records, fitted.fit.starts, strict=True)]
    gain = None if fitted.gain is None else fitted.gain / scale
    why = why or f"order {order} was asked for"
    return SubspaceResult(model, why, space, fitted.fit.starts, *errors_of(records, runs), gain, fitted.moves)


@single_threaded
def simulated(model: LinearModel, records: Sequence[InputOutputData], horizon: int | None = None) -> list[FloatArray]:
    """(K, p) free runs of a model along records it was not fitted to, each from its own least-squares initial state.

    Args:
        horizon: samples at the start from which the initial state is estimated; the whole record when None.
    """
    runs, none = [], np.zeros((len(model.outputs), 0), dtype=bool)
    for record in records:
        u, y = record.u[:horizon], record.y[:horizon]
        known = fit_inputs(model.a, model.c, [(u[:, :0], y - model.simulate(u))], none)
        runs.append(model.simulate(record.u, known.starts[0]))
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
    data = [(record.u, record.y * space.weights) for record in space.pieces.records]
    fit = fit_inputs(a, c, data, _feedthrough(space), starts=space.settings.initial_states)
    return _Fitted(a, fit, None, moves)


def _by_prediction(space: RangeSpace, predictor: FloatArray, c: FloatArray) -> _Fitted:
    """B, D, the gain and initial states by the one-step error, which feedback does not bias.

    The predictor has inputs u and y and the matrices A - K C, [B - K D, K], C, [D, 0].
    """
    settings, inputs = space.settings, len(space.pieces.records[0].inputs)
    predictor, _ = constrained(predictor, "stable")
    data = [(record.u, record.y * space.weights) for record in space.pieces.records]
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


def mean(deltas: FloatArray) -> float:
    """Delta-bar, over outputs that are not 0; nan where all are."""
    known = deltas[~np.isnan(deltas)]
    return float(known.mean()) if len(known) else np.nan


def errors_of(records: Sequence[InputOutputData], runs: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """(R, p) rms and delta of free runs; inf where one overflowed."""
    bounded = [np.where(np.isnan(run), np.inf, run) for run in runs]
    with np.errstate(over="ignore"):
        pairs = [(rms(record.y, run), delta(record.y, run)) for record, run in zip(records, bounded, strict=True)]
    return np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs])


def _feedthrough(space: RangeSpace) -> BoolArray:
    first = space.pieces.records[0]
    return np.full((len(first.outputs), len(first.inputs)), space.settings.feedthrough)
