"""A parameter's estimate with its uncertainty, the form in which every method hands its results out.

Standard errors come from a covariance matrix, 95 % intervals from Student's t with the degrees of freedom
left.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import chndtrix, ndtri, stdtrit

from orchestrator.trace import FloatArray

_FAR = 5.0  # standard deviations, from which only one side counts
_NEAR = 1e-9  # standard deviations that change nothing: SciPy errs by 2e-6 at squares below normal numbers


@dataclass(frozen=True)
class EstimatedValue:
    """One estimated quantity; `value`, `std` and `ci95` in `unit`.

    Attributes:
        std: standard error, rms; inf when the data leave no degree of freedom to judge it, or the value sits at a
            bound.
        ci95: ends of the 95 % interval, -inf and inf where `std` is inf.
    """

    value: float
    std: float
    ci95: tuple[float, float]
    unit: str = ""

    @property
    def known(self) -> bool:
        """Whether the data say how uncertain the value is."""
        return math.isfinite(self.std)

    @property
    def half(self) -> float | None:
        """Half of the interval; None where the data do not say."""
        return (self.ci95[1] - self.ci95[0]) / 2 if self.known else None


@dataclass(frozen=True)
class PriorKnowledge:
    """What was known of a parameter before, beside what the recordings say.

    Attributes:
        text: the prior in words, in the parameter's unit.
        source: where it is from.
        added: share of its variance that the recordings took away; 0 where they say nothing of the parameter.
        off: how many standard deviations of the prior the estimate is off.
    """

    text: str
    source: str
    added: float
    off: float


def with_interval(value: float, std: float, dof: float = math.inf, unit: str = "", off: float = 0.0) -> EstimatedValue:
    """The estimate with 95 % interval value +- t(0.975, dof) * std; normal when `dof` is infinite.

    Args:
        off: by how much at most the value is off beside noise, to either side: with that the interval is the narrowest
            symmetric one that holds the truth in 95 % wherever it is, and `std` the rms error where it is farthest.

    Source: Armstrong and Kolesar 2018 (a critical value that is aware of bias).
    """
    if not (dof > 0 and math.isfinite(std)):
        return EstimatedValue(float(value), math.inf, (-math.inf, math.inf), unit)
    normal = float(ndtri(0.975))
    wider = (normal if math.isinf(dof) else float(stdtrit(dof, 0.975))) / normal
    half = _critical(off / (wider * std)) * wider * std if std > 0 else off
    return EstimatedValue(float(value), math.hypot(std, off), (float(value - half), float(value + half)), unit)


def _critical(off: float) -> float:
    """What |x| is below in 95 %, x normal about `off` with variance 1."""
    return math.sqrt(chndtrix(0.95, 1, max(off, _NEAR) ** 2)) if off < _FAR else off + float(ndtri(0.95))


def estimates(
    values: FloatArray, covariance: FloatArray, units: Mapping[str, str], dof: float = math.inf
) -> dict[str, EstimatedValue]:
    """Name -> estimate for `values` (n,) with `covariance` (n, n); `units` names them in their order."""
    stds = np.sqrt(np.diag(covariance))
    return {
        name: with_interval(value, std, dof, unit)
        for (name, unit), value, std in zip(units.items(), values, stds, strict=True)
    }


def propagated(gradient: FloatArray, covariance: FloatArray) -> float:
    """Standard error of a function with this gradient (n,) at the estimate (first order)."""
    return float(np.sqrt(gradient @ covariance @ gradient))
