"""Models of the noise in residuals: white, or correlated in time as an autoregression fitted to them says.

Each multiplies columns by the noise's covariance within a window, which is all that covariances of estimates need.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import matmul_toeplitz

from orchestrator.trace import FloatArray

_LONGEST_ORDER = 30


class Noise(Protocol):
    """Zero-mean noise, the same process in all windows."""

    def at_least(self, variances: FloatArray) -> Noise:
        """The same with no output's variance below (m,) these."""

    def times(self, columns: FloatArray) -> FloatArray:
        """Covariance of a window's noise times columns (K m, c), rows ordered instant by instant."""


@dataclass(frozen=True, eq=False)
class White:
    """No correlation in time; `covariance` (m, m) between the outputs at one instant."""

    covariance: FloatArray

    def at_least(self, variances: FloatArray) -> White:
        own = np.diag(self.covariance)
        return White(self.covariance + np.diag(np.maximum(variances - own, 0.0)))

    def times(self, columns: FloatArray) -> FloatArray:
        outputs = len(self.covariance)
        instants = columns.reshape(len(columns) // outputs, outputs, columns.shape[1])
        return np.asarray((self.covariance @ instants).reshape(columns.shape))


@dataclass(frozen=True, eq=False)
class Coloured:
    """Correlated in time; `autocovariance` (m, K) of each output, the outputs independent of each other."""

    autocovariance: FloatArray

    def at_least(self, variances: FloatArray) -> Coloured:
        short = np.maximum(variances - self.autocovariance[:, 0], 0.0)
        return Coloured(self.autocovariance + np.eye(1, self.autocovariance.shape[1]) * short[:, None])

    @property
    def samples_each(self) -> FloatArray:
        """(m,) how many samples tell as much of a mean as one independent one."""
        power = self.autocovariance[:, 0]
        sums = power + 2 * self.autocovariance[:, 1:].sum(axis=1)
        return np.asarray(np.divide(sums, power, out=np.ones(len(power)), where=power > 0))

    def times(self, columns: FloatArray) -> FloatArray:
        outputs, product = len(self.autocovariance), np.empty_like(columns)
        for i, covariance in enumerate(self.autocovariance):
            rows = columns[i::outputs]
            if rows.size:
                product[i::outputs] = matmul_toeplitz(covariance[: len(rows)], rows)
        return product


def white(residuals: Sequence[FloatArray], outputs: int, freedom: int) -> White:
    """The white model of windows' residuals (K_w m,), when the fit has left so many degrees of freedom."""
    stacked = np.concatenate([residual.reshape(-1, outputs) for residual in residuals])
    return White(stacked.T @ stacked * outputs / freedom)


def coloured(residuals: Sequence[FloatArray], outputs: int, fitted: Sequence[FloatArray]) -> Coloured:
    """The coloured model of windows' residuals (K_w m,): an autoregression for each output.

    Args:
        fitted: (K_w m, c) a window, orthonormal columns spanning what the fit has taken out of the residuals; the
            model gets back most of the power that went with them.

    Source: Yule-Walker equations on the windows' pooled autocovariance, order by Akaike's criterion.
    """
    longest, samples = max(map(len, residuals)) // outputs, sum(map(len, residuals)) // outputs
    rows = [_extended([residual[i::outputs] for residual in residuals], longest) for i in range(outputs)]
    left = Coloured(np.array(rows))
    lost = sum(np.sum((q * left.times(q)).reshape(len(q) // outputs, outputs, q.shape[1]), axis=(0, 2)) for q in fitted)
    power = left.autocovariance[:, 0] * samples
    share = np.divide(lost, power, out=np.zeros(outputs), where=power > 0)
    return Coloured(left.autocovariance / (1 - np.minimum(share, 0.9))[:, None])


def _extended(windows: Sequence[FloatArray], length: int) -> FloatArray:
    """(length,) autocovariance of the autoregression that fits the windows best."""
    samples, order = sum(map(len, windows)), min(_LONGEST_ORDER, min(map(len, windows)) // 4)
    pooled = [sum(float(e[: len(e) - k] @ e[k:]) for e in windows) / samples for k in range(order + 1)]
    model = _autoregression(np.array(pooled), samples)
    extended = np.zeros(max(length, order + 1))
    extended[: order + 1] = pooled
    for k in range(len(model) + 1, length):
        extended[k] = model @ extended[k - len(model) : k][::-1]
    return extended[:length]


def _autoregression(covariance: FloatArray, samples: int) -> FloatArray:
    """(p,) coefficients by the Levinson-Durbin recursion, p of the least Akaike criterion."""
    best = model = np.zeros(0)
    variance = float(covariance[0])
    if variance <= 0:
        return best
    least = samples * np.log(variance)
    for p in range(1, len(covariance)):
        reflection = (covariance[p] - model @ covariance[1:p][::-1]) / variance
        model = np.append(model - reflection * model[::-1], reflection)
        variance *= 1 - reflection**2
        if variance <= 1e-12 * covariance[0]:
            return model
        criterion = samples * np.log(variance) + 2 * p
        if criterion < least:
            best, least = model, criterion
    return best
