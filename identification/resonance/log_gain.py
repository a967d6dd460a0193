"""Second-order models fitted to measured gains through log|G|: one resonance, or all added masses at once.

Taking logarithms weighs relative errors, so the flanks count as much as the peak. To the standard errors of
the gains a model error is added, as large as the misfit demands, so that intervals stay honest where the
linear model is only near the truth (dry friction) and rest on the noise where it is exact.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import optimize

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, estimates, propagated, with_interval
from identification.resonance.resonance import GRAVITY
from orchestrator.trace import FloatArray, ReadOnlyArrays

ROUNDING = 1e-12  # relative misfits below this are taken for arithmetic
LARGEST_LOGARITHM = 50.0  # a parameter this far from its start is lost
ROUNDS = 100  # re-weightings allowed until the model error settles
SPREAD = (0.97, 1.0, 1.03)  # starts around the frequency of the largest gain
START_INERTIAS = np.geomspace(0.02, 50, 16)  # of p1, in units of the largest added inertia
START_DAMPINGS = (0.01, 0.04, 0.15, 0.5)  # p2 over inertia and frequency
STARTS = 8
PARAMETER_UNITS = {"p1": "kg m^2", "p2": "N m s/rad", "p3": "N m", "p4": "N m/input"}

LogModel = Callable[[FloatArray], tuple[FloatArray, FloatArray]]  # parameters to log|G| and its derivatives


@dataclass(frozen=True, eq=False)
class GainData(ReadOnlyArrays):
    """Gains measured at K frequencies, each with the mass added in its experiment.

    Attributes:
        frequency: (K,) [rad/s].
        gain: (K,) |G| [rad / input unit].
        gain_std: (K,) standard errors of `gain`, zeros when they are not known.
        added_mass, added_length: (K,) [kg], [m].
    """

    frequency: FloatArray
    gain: FloatArray
    gain_std: FloatArray
    added_mass: FloatArray
    added_length: FloatArray


def gain_data(
    frequency: ArrayLike,
    gain: ArrayLike,
    gain_std: ArrayLike | None = None,
    added_mass: ArrayLike = 0.0,
    added_length: ArrayLike = 0.0,
) -> GainData:
    """Checked columns of equal length; scalars are repeated.

    Raises:
        IdentificationError: lengths differ, or a frequency or gain is not positive and finite.
    """
    given = (frequency, gain, 0.0 if gain_std is None else gain_std, added_mass, added_length)
    try:
        w, g, s, m, length = np.broadcast_arrays(*(np.asarray(column, dtype=float) for column in given))
    except ValueError:
        raise IdentificationError("gains", "the columns have different lengths") from None
    if w.ndim != 1 or not np.all(np.isfinite([w, g, s, m, length])) or np.any(w <= 0) or np.any(g <= 0):
        raise IdentificationError("gains", "a frequency or gain is not positive and finite", "drop that point")
    return GainData(w, g, s, m, length)


@dataclass(frozen=True, eq=False)
class MagnitudeFit(ReadOnlyArrays):
    """G(s) = b0 / (s^2 + a1 s + a0) fitted to gains.

    Attributes:
        omega_opt: frequency of the largest gain [rad/s].
        a0, a1, b0: [1/s^2], [1/s], [response unit / s^2].
        covariance: (3, 3) of a0, a1, b0.
        model_error: relative misfit beyond the standard errors of the gains.
        dof: points less parameters.
    """

    omega_opt: EstimatedValue
    a0: EstimatedValue
    a1: EstimatedValue
    b0: EstimatedValue
    covariance: FloatArray
    model_error: float
    dof: int


def fit_magnitude(frequency: ArrayLike, gain: ArrayLike, gain_std: ArrayLike | None = None) -> MagnitudeFit:
    """The second-order system whose log|G| is nearest, in least squares, to that of `gain` (K,).

    Args:
        frequency: (K,) [rad/s], K >= 4.
        gain: (K,) |G|.
        gain_std: (K,) standard errors of `gain`; None weighs all relative errors alike.

    Raises:
        IdentificationError: too few or bad points, no convergence, or the fit has no resonance.
    """
    data = gain_data(frequency, gain, gain_std)
    x = data.frequency**2

    def log_model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        a0, a1, b0 = p
        stiffness, squared = a0 - x, (a0 - x) ** 2 + a1**2 * x
        slopes = np.column_stack([-stiffness / squared, -a1 * x / squared, np.full_like(x, 1 / b0)])
        return np.log(b0) - np.log(squared) / 2, slopes

    peak = int(np.argmax(data.gain))
    starts = [_magnitude_start(x[peak] * factor**2, data.gain[peak]) for factor in SPREAD]
    values, covariance, model_error, dof = _fit_logarithms(data, log_model, starts, np.full(3, True))
    a0, a1, _ = values
    squared = a0 - a1**2 / 2
    if squared <= 0:
        raise IdentificationError("log|G|", "the fitted system has no resonance", "add frequencies around the peak")
    omega = math.sqrt(squared)
    std = propagated(np.array([1.0, -a1, 0.0]) / (2 * omega), covariance)
    named = estimates(values, covariance, {"a0": "1/s^2", "a1": "1/s", "b0": "1/s^2"}, dof)
    return MagnitudeFit(
        with_interval(omega, std, dof, "rad/s"), **named, covariance=covariance, model_error=model_error, dof=dof
    )


def _magnitude_start(squared: float, gain: float) -> FloatArray:
    damping = 0.1 * math.sqrt(squared)
    return np.array([squared, damping, gain * damping * math.sqrt(squared)])


@dataclass(frozen=True, eq=False)
class PendulumFit(ReadOnlyArrays):
    """The grey box p1 a + p2 w + p3 q = p4 v fitted to gains measured with several added masses.

    Attributes:
        parameters: p1 [kg m^2], p2 [N m s/rad], p3 [N m], p4 [N m / input unit].
        covariance: (4, 4) of p1..p4.
        model_error: relative misfit beyond the standard errors of the gains.
        dof: points less parameters.
    """

    parameters: dict[str, EstimatedValue]
    covariance: FloatArray
    model_error: float
    dof: int


def fit_pendulum(data: GainData) -> PendulumFit:
    """p1..p4 from all gains of all added masses at once (Eq. 78 linearised, least squares in log|G|).

    The added masses fix the scale; with one mass only ratios would be left. p1, p2 and p4 are positive; p3
    may come out on either side of 0 when the unloaded body is nearly balanced.

    Raises:
        IdentificationError: one added mass only, too few points, or no convergence.
    """
    loads = data.added_mass * data.added_length**2, data.added_mass * data.added_length * GRAVITY
    if len(np.unique(np.column_stack(loads), axis=0)) < 2:
        raise IdentificationError(
            "log|G|",
            "all gains were measured with one added mass, which gives only ratios of p1..p4",
            "add experiments with another mass",
        )
    inertia_added, torque_added = loads
    w, x = data.frequency, data.frequency**2

    def log_model(p: FloatArray) -> tuple[FloatArray, FloatArray]:
        p1, p2, p3, p4 = p
        stiffness = p3 + torque_added - (p1 + inertia_added) * x
        squared = stiffness**2 + (p2 * w) ** 2
        slopes = np.column_stack(
            [x * stiffness / squared, -p2 * x / squared, -stiffness / squared, np.full_like(x, 1 / p4)]
        )
        return np.log(p4) - np.log(squared) / 2, slopes

    positive = np.array([True, True, False, True])
    values, covariance, model_error, dof = _fit_logarithms(
        data, log_model, _pendulum_starts(data, log_model, loads), positive
    )
    return PendulumFit(estimates(values, covariance, PARAMETER_UNITS, dof), covariance, model_error, dof)


def _pendulum_starts(data: GainData, log_model: LogModel, loads: tuple[FloatArray, FloatArray]) -> list[FloatArray]:
    """The best few of a grid of p1 and p2, with p3 from each load's largest gain and p4 from the mean."""
    inertia_added, torque_added = loads
    rated = []
    for load in np.unique(inertia_added):
        peak = int(np.argmax(np.where(inertia_added == load, data.gain, 0)))
        w = data.frequency[peak]
        for p1 in float(inertia_added.max()) * START_INERTIAS:
            inertia = p1 + load
            for damping in START_DAMPINGS:
                p = np.array([p1, damping * inertia * w, inertia * w**2 - torque_added[peak], 1.0])
                misfit = np.log(data.gain) - log_model(p)[0]
                p[3] = math.exp(float(misfit.mean()))
                rated.append((float(misfit.std()), p))
    rated.sort(key=lambda rating: rating[0])
    return [p for _, p in rated[:STARTS]]


def _fit_logarithms(
    data: GainData, log_model: LogModel, starts: list[FloatArray], positive: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray, float, int]:
    """Parameters (n,), their covariance (n, n), the model error and the degrees of freedom.

    `log_model` maps parameters (n,) to log|G| (K,) and its derivatives (K, n); `positive` (n,) marks those
    that are kept positive.
    """
    dof = len(data.gain) - len(starts[0])
    if dof < 1:
        raise IdentificationError(
            "log|G|", f"{len(data.gain)} gains for {len(starts[0])} parameters", "add frequencies"
        )
    relative = data.gain_std / data.gain
    alike = np.ones_like(relative)
    scale = np.max(np.abs(starts), axis=0)
    runs = [_solve(data, log_model, start, alike, positive=positive, scale=scale) for start in starts]
    p, cost = min(runs, key=lambda run: run[1])
    if not math.isfinite(cost):
        raise IdentificationError("log|G|", "no start led to a least-squares solution", "check the gains")
    model_error = math.nan
    for _ in range(ROUNDS):
        previous, model_error = model_error, _model_error(np.log(data.gain) - log_model(p)[0], relative, dof)
        std = np.sqrt(relative**2 + model_error**2)
        p, cost = _solve(data, log_model, p, std, positive=positive, scale=scale)
        if not math.isfinite(cost):
            break
        if abs(model_error - previous) <= 1e-6 * model_error + ROUNDING:
            return p, _covariance(log_model(p)[1] / std[:, None]), model_error, dof
    raise IdentificationError("log|G|", "the re-weighted fit does not settle", "check the gains")


def _solve(
    data: GainData,
    log_model: LogModel,
    start: FloatArray,
    std: FloatArray,
    *,
    positive: NDArray[np.bool_],
    scale: FloatArray,
) -> tuple[FloatArray, float]:
    """Parameters (n,) and the cost at the weighted optimum from `start` (n,).

    Positive ones are sought as logarithms, the others in units of `scale` (n,). The cost is infinite where the
    search did not converge.
    """
    log_data = np.log(data.gain)

    def parameters(q: FloatArray) -> FloatArray:
        bounded = np.clip(q, -LARGEST_LOGARITHM, LARGEST_LOGARITHM)
        return np.where(positive, start * np.exp(bounded), start + scale * q)

    def jacobian(q: FloatArray) -> FloatArray:
        p = parameters(q)
        return -log_model(p)[1] * np.where(positive, p, scale) / std[:, None]

    run = optimize.least_squares(
        lambda q: (log_data - log_model(parameters(q))[0]) / std,
        np.zeros(len(start)),
        jac=jacobian,
        method="lm",
        xtol=1e-12,
        ftol=1e-12,
        gtol=1e-12,
        max_nfev=500,
    )
    return parameters(run.x), float(run.cost) if run.success else math.inf


def _model_error(misfit: FloatArray, relative: FloatArray, dof: int) -> float:
    """The error that, added to the `relative` std, brings the mean squared misfit to 1; 0 when below."""
    largest = math.sqrt(float(misfit @ misfit) / dof)
    if np.all(relative > 0) and np.sum((misfit / relative) ** 2) <= dof:
        return 0.0
    if not np.any(relative):
        return max(largest, ROUNDING)

    def excess(tau: float) -> float:
        return float(np.sum(misfit**2 / (relative**2 + tau**2))) - dof

    return float(optimize.brentq(excess, 1e-9 * largest, largest * (1 + 1e-9), xtol=1e-14, rtol=1e-10))


def _covariance(slopes: FloatArray) -> FloatArray:
    """Inverse of slopes' slopes (n, n), for `slopes` (K, n) divided by the standard errors."""
    lengths = np.linalg.norm(slopes, axis=0)
    unit = slopes / lengths
    if np.linalg.matrix_rank(unit, tol=1e-9) < unit.shape[1]:
        raise IdentificationError("log|G|", "the gains do not determine all parameters", "add frequencies")
    return np.asarray(np.linalg.inv(unit.T @ unit) / np.outer(lengths, lengths))
