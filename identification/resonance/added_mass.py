"""Physical parameters from how the resonance moves when masses are added (pendulum thesis, Step 4.3).

Known added masses fix the scale that a frequency response alone leaves open.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue, with_interval
from identification.resonance.resonance import GRAVITY
from orchestrator.trace import FloatArray, ReadOnlyArrays

UNITS = {"p1": "kg m^2", "p2": "N m s/rad", "p3": "N m"}


@dataclass(frozen=True, eq=False)
class Resonances(ReadOnlyArrays):
    """Resonance frequencies found with K added masses.

    Attributes:
        squared: (K,) w_opt^2, Y of Eq. 81 [(rad/s)^2].
        squared_std: (K,) its standard errors, or None when they are not known (then all alike).
        torque: (K,) added gravity torque m_a g l_a, X of Eq. 81 [N m].
        inertia: (K,) added inertia m_a l_a^2, Z of Eq. 81 [kg m^2].
    """

    squared: FloatArray
    squared_std: FloatArray | None
    torque: FloatArray
    inertia: FloatArray


def resonances(
    omega: ArrayLike,
    added_mass: ArrayLike,
    added_length: ArrayLike,
    omega_std: ArrayLike | None = None,
) -> Resonances:
    """Checked columns: `omega` (K,) [rad/s], `added_mass` (K,) [kg], `added_length` (K,) or one [m].

    Raises:
        IdentificationError: lengths differ, or a number is not finite or out of range.
    """
    given = (omega, added_mass, added_length, 1.0 if omega_std is None else omega_std)
    try:
        w, mass, length, std = np.broadcast_arrays(*(np.asarray(column, dtype=float) for column in given))
    except ValueError:
        raise IdentificationError("resonances", "the columns have different lengths") from None
    if w.ndim != 1 or not np.all(np.isfinite([w, mass, length, std])) or np.any(w <= 0) or np.any(std <= 0):
        raise IdentificationError("resonances", "a frequency or its std is not positive and finite", "drop that mass")
    squared_std = None if omega_std is None else 2 * w * std
    return Resonances(w**2, squared_std, mass * GRAVITY * length, mass * length**2)


@dataclass(frozen=True)
class AddedMassFit:
    """Parameters from the resonances.

    Attributes:
        parameters: p1 [kg m^2], p3 [N m] and, from Eq. 102, p2 [N m s/rad]. Standard errors are scaled by the
            misfit when the resonances' own are not known; they are inf when no degree of freedom is left.
        at_bound: names of parameters that were held or ended on a bound; their std is inf, that of
            the others holds with them fixed.
        misfit: sum of squared differences of w_opt^2, f of Eq. 102 [(rad/s)^4].
        dof: resonances less free parameters.
    """

    parameters: dict[str, EstimatedValue]
    at_bound: tuple[str, ...]
    misfit: float
    dof: int


def _std(data: Resonances) -> FloatArray:
    return np.ones_like(data.squared) if data.squared_std is None else data.squared_std


def _result(
    data: Resonances,
    values: dict[str, float],
    slopes: FloatArray,
    fitted: FloatArray,
    at_bound: tuple[str, ...],
) -> AddedMassFit:
    """The result with standard errors from `slopes` (K, n) of the fitted w_opt^2 (K,)."""
    free = [name for name in values if name not in at_bound]
    weighed = slopes[:, [list(values).index(name) for name in free]] / _std(data)[:, None]
    gap = data.squared - fitted
    dof = len(gap) - len(free)
    variance = 1.0 if data.squared_std is not None else float(gap @ gap) / dof if dof > 0 else math.inf
    information = weighed.T @ weighed
    scale = np.sqrt(np.diag(information))
    solvable = len(free) > 0 and np.linalg.cond(information / np.outer(scale, scale)) < 1e14
    stds = dict.fromkeys(values, math.inf)
    if solvable:
        inverse = np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)
        stds.update(zip(free, np.sqrt(np.diag(inverse) * variance), strict=True))
    spread = math.inf if data.squared_std is not None else dof
    named = {name: with_interval(value, stds[name], spread, UNITS[name]) for name, value in values.items()}
    return AddedMassFit(named, at_bound, float(gap @ gap), dof)


@dataclass(frozen=True)
class AddedMassBounds:
    """Start and bounds of p1 [kg m^2], p2 [N m s/rad], p3 [N m], in this order."""

    start: tuple[float, float, float]
    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


def fit_damped(data: Resonances, bounds: AddedMassBounds) -> AddedMassFit:
    """p1, p2, p3 that bring Eq. 79 nearest to the resonances within bounds (Eq. 102).

    Minimises the sum of squared differences of w_opt^2, divided by their variances where these are known. p2
    moves the resonance very little, so it and with it p3 are poorly determined: the thesis' own p2 is off by
    a factor of 10, and lies on or near its bound. fmincon's answers in Table 5 stop short of the minimum.

    Args:
        bounds: a parameter whose lower bound is its upper one is held there.

    Raises:
        IdentificationError: the bounds exclude the start, too few resonances, or no convergence.
    """
    low, start, high = (np.array(column) for column in (bounds.lower, bounds.start, bounds.upper))
    if np.any(low > start) or np.any(start > high) or np.any(high <= 0):
        raise IdentificationError("Eq. 102", f"bounds {low} to {high} exclude the start {start}", "widen them")
    free = low < high
    if len(data.squared) < np.count_nonzero(free):
        raise IdentificationError("Eq. 102", f"{len(data.squared)} resonances are too few", "add masses")
    std = _std(data)

    def everything(scaled: FloatArray) -> FloatArray:
        p = start.copy()
        p[free] = scaled * high[free]
        return p

    run = optimize.least_squares(
        lambda q: (_damped(data, everything(q))[0] - data.squared) / std,
        (start / high)[free],
        jac=lambda q: (_damped(data, everything(q))[1] * high / std[:, None])[:, free],
        bounds=((low / high)[free], np.ones(np.count_nonzero(free))),
        xtol=1e-15,
        ftol=1e-15,
        gtol=1e-15,
        max_nfev=5000,
    )
    if not run.success:
        raise IdentificationError("Eq. 102", "the least-squares fit did not converge", "narrow the bounds")
    names, p = np.array(tuple(UNITS)), everything(run.x)
    held = (*names[~free].tolist(), *names[free][run.active_mask != 0].tolist())
    fitted, slopes = _damped(data, p)
    return _result(data, dict(zip(names.tolist(), p.tolist(), strict=True)), slopes, fitted, held)


def _damped(data: Resonances, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """w_opt^2 of Eq. 79 (K,) and its derivatives with respect to p1, p2, p3 (K, 3)."""
    p1, p2, p3 = p
    inertia, torque = p1 + data.inertia, p3 + data.torque
    fitted = torque / inertia - (p2 / inertia) ** 2 / 2
    by_p1 = -torque / inertia**2 + p2**2 / inertia**3
    return fitted, np.column_stack([by_p1, -p2 / inertia**2, 1 / inertia])
