"""Block Hankel matrices of long records, compressed to the triangular factor that holds all their inner products.

The matrix itself is never formed. Its Gram matrix follows from correlations by a recursion, at the price of a squared
condition; where that price is too high, orthogonal transformations chunk by chunk give the factor instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from orchestrator.trace import FloatArray

IntArray = NDArray[np.intp]
Compression = Literal["auto", "gram", "qr"]
GRAM_LIMIT = 1e5  # condition up to which the Gram matrix keeps six digits of the smallest direction
_CHUNK = 4096
_GROUP = 8  # times as many rows as columns are triangularised at once: what a processor's cache holds


@dataclass(frozen=True, eq=False)
class HankelFactor:
    """A lower triangular L with L L' = H H'.

    Attributes:
        lower: (r, r), in the rows' order and units.
        condition: of L with rows scaled to their signals' rms; inf when it is singular.
        compression: "gram" or "qr".
    """

    lower: FloatArray
    condition: float
    compression: Compression


@dataclass(frozen=True)
class HankelRows:
    """Rows of a block Hankel matrix: `lags` lags of some channels, from lag `first` on, lag by lag."""

    channels: tuple[int, ...]
    first: int
    lags: int


def factor(
    signals: Sequence[FloatArray], rows: Sequence[HankelRows], compression: Compression = "auto"
) -> HankelFactor:
    """The triangular factor of the Hankel matrix whose rows are these groups, one below the other.

    Column k of the matrix holds sample k + lag of every channel; columns run over all records.

    Args:
        signals: a record (K, s), one column a channel, each longer than the largest lag.
        compression: "gram" up to a condition of `GRAM_LIMIT` and "qr" beyond with "auto", or the one to use.
    """
    lags = np.concatenate([np.repeat(group.first + np.arange(group.lags), len(group.channels)) for group in rows])
    channels = np.concatenate([np.tile(group.channels, group.lags) for group in rows])
    depth = int(lags.max()) + 1
    scale = _rms(signals)
    scaled = [np.ascontiguousarray(record / scale) for record in signals]
    lower = None if compression == "qr" else _by_gram(scaled, depth, lags * len(scale) + channels)
    if lower is not None:
        found = _factor(lower, scale[channels], "gram")
        if compression == "gram" or found.condition <= GRAM_LIMIT:
            return found
    return _factor(_by_qr(scaled, depth, lags, channels), scale[channels], "qr")


def absorbed(triangle: FloatArray, rows: FloatArray) -> FloatArray:
    """The upper triangle R of both stacked, R'R = triangle' triangle + rows' rows; (at most n, n)."""
    columns = rows.shape[1]
    group = _GROUP * columns
    while len(rows) > 2 * group:
        whole = len(rows) // group * group
        small = np.asarray(np.linalg.qr(rows[:whole].reshape(-1, group, columns), mode="r"))
        rows = np.concatenate([small.reshape(-1, columns), rows[whole:]])
    return np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def _factor(lower: FloatArray, scale: FloatArray, compression: Compression) -> HankelFactor:
    values = np.linalg.svd(lower, compute_uv=False)
    condition = float(values[0] / values[-1]) if values[-1] > 0 else np.inf
    return HankelFactor(lower * scale[:, None], condition, compression)


def _rms(signals: Sequence[FloatArray]) -> FloatArray:
    """(s,) of every channel over all records; 1 for one that is 0."""
    power = np.sum([np.sum(record**2, axis=0) for record in signals], axis=0) / sum(map(len, signals))
    return np.where(power > 0, np.sqrt(power), 1.0)


def _by_gram(signals: Sequence[FloatArray], depth: int, order: IntArray) -> FloatArray | None:
    """The factor by Cholesky, None where the Gram matrix is not positive definite to rounding."""
    gram = np.sum([gram_matrix(record, depth) for record in signals], axis=0)
    try:
        return np.asarray(np.linalg.cholesky(gram[np.ix_(order, order)]))
    except np.linalg.LinAlgError:
        return None


def gram_matrix(z: FloatArray, depth: int) -> FloatArray:
    """(depth s, depth s) H H' of one record z (K, s), lag by lag.

    The first block row is correlated; block (i+1, j+1) is block (i, j) less the first product and plus one more.
    """
    width, s = len(z) - depth + 1, z.shape[1]
    first = np.zeros((depth, s, s))
    for start in range(0, width, _CHUNK):
        stop = min(start + _CHUNK, width)
        part = z[start:stop].T
        for lag in range(depth):
            first[lag] += part @ z[start + lag : stop + lag]
    gram = np.zeros((depth, s, depth, s))
    gram[0] = first.transpose(1, 0, 2)
    last = z[width:]
    for i in range(depth - 1):
        change = np.multiply.outer(last[i], last[i:]) - np.multiply.outer(z[i], z[i : depth - 1])
        gram[i + 1, :, i + 1 :] = gram[i, :, i:-1] + change
    flat = gram.reshape(depth * s, depth * s)
    return np.asarray(np.triu(flat) + np.triu(flat, 1).T)


def _by_qr(signals: Sequence[FloatArray], depth: int, lags: IntArray, channels: IntArray) -> FloatArray:
    """The factor by orthogonal transformations, some thousand columns at a time."""
    triangle = np.zeros((0, len(lags)))
    for record in signals:
        width = len(record) - depth + 1
        for start in range(0, width, _CHUNK):
            columns = np.arange(start, min(start + _CHUNK, width))
            chunk = record[columns[:, None] + lags, channels]
            triangle = absorbed(triangle, chunk)
    lower = np.zeros((len(lags), len(lags)))
    lower[:, : len(triangle)] = triangle.T
    return lower
