"""How well simulated outputs follow measured ones, and whether what is left over is noise.

The same functions judge windows that were fitted and windows that were kept aside.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import chdtrc, ndtri

from fmus.errors import IdentificationError
from orchestrator.trace import FloatArray, ReadOnlyArrays

_BAND = float(ndtri(0.995))
_LINE = 1e-3


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
    return np.asarray(np.sqrt(np.mean((y - yhat) ** 2, axis=0)))


def delta(measured: ArrayLike, simulated: ArrayLike) -> FloatArray:
    """(m,) rms error over rms output (its mean is delta-bar); nan for an output that is all 0.

    Source: the flexible-manipulator thesis, Eq. 2-25.
    """
    y, _ = _matched(measured, simulated)
    return _ratio(rms(measured, simulated), np.sqrt(np.mean(y**2, axis=0)))


@dataclass(frozen=True, eq=False)
class Whiteness(ReadOnlyArrays):
    """Result of a portmanteau test: small `p_value` means the residuals are correlated.

    Attributes:
        freedom: degrees of freedom of the chi-square distribution of what Ljung and Box sum over lags and windows.
        autocorrelation: (L + 1,) pooled over the windows, 1 at lag 0.
        band: 99 % of a white residual's autocorrelations lie within +- this.
        line: p value of the strongest line in the spectrum, which shows an error at one frequency, or a slow one, that
            is too small to correlate neighbouring samples.
        line_at: where that is [cycles a sample].
    """

    freedom: int
    p_value: float
    autocorrelation: FloatArray
    band: float
    line: float = 1.0
    line_at: float = 0.0

    @property
    def white(self) -> bool:
        """True when whiteness is not rejected, by correlations at 1 %, by a line in the spectrum at 0.1 %."""
        return self.p_value >= 0.01 and self.line >= _LINE

    @property
    def why_not(self) -> str:
        """What rejects it, for people."""
        if self.p_value < 0.01:
            return f"Ljung-Box p = {self.p_value:.2g}"
        return f"a line at {self.line_at:.3g} cycles a sample, p = {self.line:.2g}"


def autocorrelation(residual: ArrayLike, lags: int) -> FloatArray:
    """(lags + 1,) sum of e_t e_(t+k) over sum of e_t^2, about zero: a constant error counts as correlated.

    A residual that is 0 throughout has 1 at lag 0 and 0 beyond.
    """
    e = np.asarray(residual, dtype=float)
    _check_lags(len(e), lags)
    products = np.array([e[: len(e) - k] @ e[k:] for k in range(lags + 1)])
    return np.asarray(products / products[0] if products[0] > 0 else np.eye(1, lags + 1)[0])


def whiteness(residuals: Sequence[ArrayLike], lags: int = 20) -> Whiteness:
    """Test that the residuals of one output are white in all windows together.

    Args:
        residuals: one (K_w,) array a window.
        lags: how many lags are tested; no more than a quarter of the shortest window is used.

    A fit that took much out of short windows (initial states of each) correlates the residuals a little, so that
    they are rejected somewhat more often than the level says.

    Correlations are about zero, not about the mean: the mean of an error is the model's fault, too, so that a residual
    that is biased and otherwise white is not called white. Pictures of residuals show this test's `autocorrelation`.

    Source: Ljung and Box 1978.
    """
    rows = [np.asarray(residual, dtype=float) for residual in residuals]
    used = max(1, min(lags, min(len(row) for row in rows) // 4))
    r = np.array([autocorrelation(row, used) for row in rows])
    counts = np.array([len(row) for row in rows])[:, None]
    k = np.arange(1, used + 1)
    factor = counts * (counts + 2) / (counts - k)
    total, freedom = float(np.sum(factor * r[:, 1:] ** 2)), used * len(rows)
    pooled = np.average(r, axis=0, weights=counts[:, 0])
    band = _BAND / float(np.sqrt(counts.sum()))
    return Whiteness(freedom, float(chdtrc(freedom, total)), pooled, band, *_strongest_line(rows))


def _strongest_line(rows: Sequence[FloatArray]) -> tuple[float, float]:
    """p value of the highest point of the windows' common periodogram, for all of its points, and where it lies.

    Source: Fisher 1929, with many samples and several records.
    """
    length = min(map(len, rows))
    e = np.array([row[:length] for row in rows])
    power = float(np.mean(e**2))
    if not power > 0:
        return 1.0, 0.0
    heights = np.sum(np.abs(np.fft.rfft(e, axis=1)) ** 2, axis=0) / (length * power)
    frequencies = np.fft.rfftfreq(length)
    real = (frequencies == 0) | (frequencies == 0.5)  # one square a window there, two elsewhere
    p = np.where(real, chdtrc(len(rows), heights), chdtrc(2 * len(rows), 2 * heights))
    least = int(np.argmin(p))
    return min(1.0, float(p[least]) * len(p)), float(frequencies[least])


def _matched(measured: ArrayLike, simulated: ArrayLike) -> tuple[FloatArray, FloatArray]:
    y, yhat = np.asarray(measured, dtype=float), np.asarray(simulated, dtype=float)
    if y.shape != yhat.shape or y.ndim not in (1, 2) or not len(y):
        raise IdentificationError(
            "outputs", f"measured have shape {y.shape}, simulated {yhat.shape}", "compare the same samples"
        )
    return (y[:, None], yhat[:, None]) if y.ndim == 1 else (y, yhat)


def _ratio(error: FloatArray, size: FloatArray) -> FloatArray:
    return np.divide(error, size, out=np.full_like(error, np.nan), where=size > 0)


def _check_lags(samples: int, lags: int) -> None:
    if not 0 < lags < samples:
        raise IdentificationError("lags", f"{lags} for {samples} samples", "use fewer lags than samples")
