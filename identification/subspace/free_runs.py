"""Free runs of a linear model along records: those it was fitted to, and others, from a state that a horizon gives."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fmus.errors import IdentificationError
from identification.estimation.validation import fit
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData
from identification.subspace.realisation import simulated
from orchestrator.trace import FloatArray

_PERIODS = 3.0  # of the slowest mode, or time constants of a real one: what tells its state from noise
_TOLD = 1e-6  # of the largest: what of a constant the initial states do not explain as well


def horizon(model: LinearModel) -> float:
    """Samples from which a state can be told: some periods of the slowest mode; infinite beside an integrator."""
    poles = model.eigenvalues
    poles = poles[np.abs(poles) > 0]
    with np.errstate(divide="ignore"):
        constants = np.where(np.abs(poles) < 1, -1 / np.log(np.abs(poles)), math.inf)
        periods = np.where(poles.imag != 0, 2 * math.pi / np.abs(np.angle(poles)), math.inf)
    slowest = float(np.minimum(constants, periods).max(initial=0.0))
    return max(_PERIODS * slowest, 10.0 * model.order)


def samples_for(model: LinearModel, start: float | None) -> float:
    """At the beginning of an unseen record, for its state: those within `start` [s], or those of the `horizon`."""
    return horizon(model) if start is None else max(round(start / model.step), model.order + 1)


def offset_of(model: LinearModel, records: Sequence[InputOutputData]) -> FloatArray:
    """(p,) constant of the outputs, the same in all records, beside the best initial state of each; 0 where a model's
    free response overflows.

    A mean over a finite record is not quite where the outputs rest.
    """
    outputs, left = len(model.outputs), list[FloatArray]()
    if np.abs(model.eigenvalues).max(initial=0.0) >= 1:  # a drift of the model stands for a constant as well
        return np.zeros(outputs)
    for record in records:
        runs = [model.simulate(np.zeros_like(record.u), start).ravel() for start in np.eye(model.order)]
        constant = np.tile(np.eye(outputs), (len(record), 1))
        error = (record.y - model.simulate(record.u)).ravel()
        rows = np.column_stack([*runs, constant, error])
        if not np.isfinite(rows).all():
            return np.zeros(outputs)
        triangle = np.asarray(np.linalg.qr(rows, mode="r"))
        left.append(triangle[model.order :, model.order :])
    stacked = np.concatenate(left)
    return np.asarray(np.linalg.lstsq(stacked[:, :-1], stacked[:, -1], rcond=_TOLD)[0])


def free_runs(
    model: LinearModel, records: Sequence[InputOutputData], samples: float | None, offset: FloatArray | float = 0.0
) -> tuple[list[FloatArray], FloatArray]:
    """(K, p) a record, and (R, p) FIT; a run that overflows is NaN, and its FIT minus infinity.

    Args:
        samples: at the beginning of a record from which its state is estimated, infinite for all; None starts at rest.
        offset: (p,) of the outputs.
    """
    runs = [_run(model, replace(record, y=record.y - offset), samples) + offset for record in records]
    with np.errstate(over="ignore", invalid="ignore"):
        fits = [fit(record.y, run) for record, run in zip(records, runs, strict=True)]
    bounded = [np.where(np.isfinite(run).all(axis=0), own, -math.inf) for run, own in zip(runs, fits, strict=True)]
    return runs, np.array(bounded).reshape(-1, len(model.outputs))


def _run(model: LinearModel, record: InputOutputData, samples: float | None) -> FloatArray:
    if samples is None:
        return model.simulate(record.u)
    try:
        return simulated(model, [record], int(min(samples, len(record))))[0]
    except (IdentificationError, np.linalg.LinAlgError):
        return np.full(record.y.shape, math.nan)
