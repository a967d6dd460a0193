"""The compressed factor against block Hankel matrices that are written out."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.linear.hankel import HankelRows, factor, gram_matrix

GROUPS = (HankelRows((0,), 3, 4), HankelRows((1, 2), 0, 3), HankelRows((2,), 3, 5))


def written_out(signals: list[np.ndarray], groups: tuple[HankelRows, ...]) -> np.ndarray:
    """(r, d) the matrix, all records side by side."""
    depth = max(group.first + group.lags for group in groups)
    rows = [(group.first + lag, channel) for group in groups for lag in range(group.lags) for channel in group.channels]
    return np.hstack([np.array([z[lag : len(z) - depth + 1 + lag, channel] for lag, channel in rows]) for z in signals])


def noise(*lengths: int) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    return [rng.standard_normal((length, 3)) * [1.0, 1e3, 1e-3] for length in lengths]


@pytest.mark.parametrize("compression", ["gram", "qr"])
def test_the_factor_has_the_inner_products_of_the_matrix(compression: str) -> None:
    signals = noise(500, 60)
    h, found = written_out(signals, GROUPS), factor(signals, GROUPS, compression)  # type: ignore[arg-type]
    assert found.compression == compression
    assert np.array_equal(found.lower, np.tril(found.lower))
    scale = np.linalg.norm(h, axis=1)
    assert found.lower @ found.lower.T / np.outer(scale, scale) == pytest.approx(
        h @ h.T / np.outer(scale, scale), abs=1e-13
    )


@given(st.integers(1, 6), st.integers(0, 40))
@settings(max_examples=30)
def test_the_correlation_recursion_is_the_gram_matrix(depth: int, more: int) -> None:
    (z,) = noise(depth + more)
    h = written_out([z], (HankelRows((0, 1, 2), 0, depth),))
    assert gram_matrix(z, depth) == pytest.approx(h @ h.T, rel=1e-9, abs=1e-6)


def test_a_hundred_thousand_samples_give_the_singular_values_of_the_written_out_matrix() -> None:
    signals = noise(60_000, 40_000)
    direct = np.linalg.svd(np.linalg.qr(written_out(signals, GROUPS).T, mode="r"), compute_uv=False)
    for compression in ("gram", "qr"):
        ours = np.linalg.svd(factor(signals, GROUPS, compression).lower, compute_uv=False)  # type: ignore[arg-type]
        assert ours == pytest.approx(direct, rel=1e-10)


def test_condition_is_free_of_units() -> None:
    signals = noise(500)
    in_other_units = [z * [1e6, 1.0, 1e-6] for z in signals]
    assert factor(in_other_units, GROUPS).condition == pytest.approx(factor(signals, GROUPS).condition)


@pytest.mark.parametrize(("size", "expected"), [(1e-3, "gram"), (1e-7, "qr"), (0.0, "qr")])
def test_the_gram_matrix_is_left_where_it_would_cost_the_smallest_direction(size: float, expected: str) -> None:
    (z,) = noise(400)
    z[:, 2] = z[:, 0] + size * z[:, 2] / 1e-3
    found = factor([z], (HankelRows((0, 2), 0, 5),))
    assert found.compression == expected
    exact = np.linalg.svd(
        written_out([z / np.sqrt(np.mean(z**2, axis=0))], (HankelRows((0, 2), 0, 5),)), compute_uv=False
    )
    if size:
        assert found.condition == pytest.approx(exact[0] / exact[-1], rel=1e-6)


def test_fewer_columns_than_rows_give_a_singular_factor() -> None:
    signals = noise(10)
    h, found = written_out(signals, GROUPS), factor(signals, GROUPS)
    assert found.lower @ found.lower.T == pytest.approx(h @ h.T, rel=1e-9, abs=1e-9)
    assert found.condition > 1e12
