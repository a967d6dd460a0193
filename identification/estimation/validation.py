"""How well simulated outputs follow measured ones, and whether what is left over is noise.

The same functions judge windows that were fitted and windows that were kept aside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import chi2, norm

from fmus.errors import IdentificationError
from orchestrator.trace import FloatArray

Statistic = Literal["ljung-box", "box-pierce"]
_BAND = float(norm.ppf(0.995))


def fit(measured: ArrayLike, simulated: ArrayLike) -> FloatArray:
    """(m,) FIT = 1 - |y - yhat| / |y - mean y| of each output; 1 is perfect, 0 no better than the mean.

    Args:
        measured: (K, m) or (K,) measured outputs, one column an output.
        simulated: the same shape.

    An output that is constant in `measured` has no FIT: nan.
    """
    y, yhat = _matched(measured, simulated)
    spread = np.linalg.norm(y - y.mean(axis=0), axis=0)
    return 1.0 - _ratio(np.linalg.norm(y - yhat, axis=0), spread)


def rms(measured: ArrayLike, simulated: ArrayLike) -> FloatArray:
    """(m,) root mean square of the prediction error, in each output's unit.

    Source: the flexible-manipulator thesis, Eq. 2-24.
    """
    y, yhat = _matched(measured, simulated)
    return np.sqrt(np.mean((y - yhat) ** 2, axis=0))


def delta(measured: ArrayLike, simulated: ArrayLike) -> FloatArray:
    """(m,) rms error over rms output (its mean is delta-bar); nan for an output that is all 0.

    Source: the flexible-manipulator thesis, Eq. 2-25.
    """
    y, _ = _matched(measured, simulated)
    return _ratio(rms(measured, simulated), np.sqrt(np.mean(y**2, axis=0)))


@dataclass(frozen=True)
class Summary:
    """Spread of one figure over windows, those without a value (nan) left out."""

    count: int
    minimum: float
    lower_quartile: float
    median: float
    upper_quartile: float
    maximum: float


def summarise(values: ArrayLike) -> Summary:
    """The quantiles of a figure over windows.

    Raises:
        IdentificationError: no value is there.
    """
    finite = np.asarray(values, dtype=float).ravel()
    finite = finite[~np.isnan(finite)]
    if not len(finite):
        raise IdentificationError("summary", "no window has a value", "judge windows whose outputs move")
    return Summary(len(finite), *(float(q) for q in np.quantile(finite, [0, 0.25, 0.5, 0.75, 1])))


@dataclass(frozen=True)
class Whiteness:
    """Result of a portmanteau test: small `p_value` means the residuals are correlated.

    Attributes:
        statistic: Ljung-Box or Box-Pierce, summed over the windows.
        freedom: degrees of freedom of its chi-square distribution.
        autocorrelation: (L + 1,) pooled over the windows, 1 at lag 0.
        band: 99 % of a white residual's autocorrelations lie within +- this.
    """

    statistic: float
    freedom: int
    p_value: float
    autocorrelation: FloatArray
    band: float

    @property
    def white(self) -> bool:
        """True when whiteness is not rejected at 1 %."""
        return self.p_value >= 0.01


def autocorrelation(residual: ArrayLike, lags: int) -> FloatArray:
    """(lags + 1,) sum of e_t e_(t+k) over sum of e_t^2, about zero: a constant error counts as correlated.

    A residual that is 0 throughout has 1 at lag 0 and 0 beyond.
    """
    e = np.asarray(residual, dtype=float)
    _check_lags(len(e), lags)
    products = np.array([e[: len(e) - k] @ e[k:] for k in range(lags + 1)])
    return products / products[0] if products[0] > 0 else np.eye(1, lags + 1)[0]


def whiteness(residuals: Sequence[ArrayLike], lags: int = 20, statistic: Statistic = "ljung-box") -> Whiteness:
    """Test that the residuals of one output are white in all windows together.

    Args:
        residuals: one (K_w,) array a window.
        lags: how many lags are tested; no more than a quarter of the shortest window is used.

    A fit that took much out of short windows (initial states of each) correlates the residuals a little, so that
    they are rejected somewhat more often than the level says.

    Source: Ljung and Box 1978; Box and Pierce 1970.
    """
    rows = [np.asarray(residual, dtype=float) for residual in residuals]
    used = max(1, min(lags, min(len(row) for row in rows) // 4))
    r = np.array([autocorrelation(row, used) for row in rows])
    counts = np.array([len(row) for row in rows])[:, None]
    k = np.arange(1, used + 1)
    factor = counts * (counts + 2) / (counts - k) if statistic == "ljung-box" else counts * np.ones(used)
    total, freedom = float(np.sum(factor * r[:, 1:] ** 2)), used * len(rows)
    pooled = np.average(r, axis=0, weights=counts[:, 0])
    band = _BAND / float(np.sqrt(counts.sum()))
    return Whiteness(total, freedom, float(chi2.sf(total, freedom)), pooled, band)


@dataclass(frozen=True)
class CrossCorrelation:
    """Correlation of a residual with an input.

    Attributes:
        lags: (2 L + 1,) samples by which the residual comes after the input.
        values: (2 L + 1,) correlation coefficients.
        band: 99 % of the coefficients lie within +- this when the two are independent.
    """

    lags: FloatArray
    values: FloatArray
    band: float

    @property
    def independent(self) -> bool:
        """True when no coefficient is larger than chance allows in 1 % of cases, all lags together (Bonferroni)."""
        limit = norm.ppf(1 - 0.005 / len(self.values)) / _BAND * self.band
        return bool(np.max(np.abs(self.values)) <= limit)


def cross_correlation(residual: ArrayLike, driving: ArrayLike, lags: int = 20) -> CrossCorrelation:
    """Correlation of a window's residual with its input, both centred.

    At positive lags it shows dynamics that the model misses, at negative ones feedback. The band allows for
    both signals' own correlation.

    Source: Ljung, System Identification, 1999, Section 16.6.
    """
    e, u = _centred(residual), _centred(driving)
    if e.shape != u.shape:
        raise IdentificationError("residual", f"has shape {e.shape}, the input {u.shape}", "sample them alike")
    _check_lags(len(e), lags)
    scale = np.linalg.norm(e) * np.linalg.norm(u)
    shifts = list(range(-lags, lags + 1))
    values = np.array([e[max(k, 0) : len(e) + min(k, 0)] @ u[max(-k, 0) : len(u) - max(k, 0)] for k in shifts])
    values = values / scale if scale > 0 else np.zeros(len(shifts))
    common = float(autocorrelation(e, lags)[1:] @ autocorrelation(u, lags)[1:])
    return CrossCorrelation(np.array(shifts, dtype=float), values, _BAND * math.sqrt(max(1 + 2 * common, 1.0) / len(e)))


@dataclass(frozen=True)
class Judgement:
    """How simulated windows compare with measured ones.

    Attributes:
        fit: (W, m) FIT of every window and output; nan for a constant output.
        delta: (W, m) Eq. 2-25 of every window and output.
        whiteness: one test an output, over all windows.
    """

    fit: FloatArray
    delta: FloatArray
    whiteness: tuple[Whiteness, ...]

    @property
    def summary(self) -> Summary:
        """Quantiles of FIT over all windows and outputs."""
        return summarise(self.fit)


def judge(measured: Sequence[FloatArray], simulated: Sequence[FloatArray]) -> Judgement:
    """FIT, delta and whiteness of windows, each (K_w, m)."""
    errors = [y - yhat for y, yhat in (_matched(*pair) for pair in zip(measured, simulated, strict=True))]
    return Judgement(
        np.array([fit(*pair) for pair in zip(measured, simulated, strict=True)]),
        np.array([delta(*pair) for pair in zip(measured, simulated, strict=True)]),
        tuple(whiteness([error[:, i] for error in errors]) for i in range(errors[0].shape[1])),
    )


def _matched(measured: ArrayLike, simulated: ArrayLike) -> tuple[FloatArray, FloatArray]:
    y, yhat = np.asarray(measured, dtype=float), np.asarray(simulated, dtype=float)
    if y.shape != yhat.shape or y.ndim not in (1, 2) or not len(y):
        raise IdentificationError(
            "outputs", f"measured have shape {y.shape}, simulated {yhat.shape}", "compare the same samples"
        )
    return (y[:, None], yhat[:, None]) if y.ndim == 1 else (y, yhat)


def _centred(signal: ArrayLike) -> FloatArray:
    values = np.asarray(signal, dtype=float)
    return np.asarray(values - values.mean())


def _ratio(error: FloatArray, size: FloatArray) -> FloatArray:
    return np.divide(error, size, out=np.full_like(error, np.nan), where=size > 0)


def _check_lags(samples: int, lags: int) -> None:
    if not 0 < lags < samples:
        raise IdentificationError("lags", f"{lags} for {samples} samples", "use fewer lags than samples")
