"""The shares of samples are those of leaving them out, and of a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from identification.estimation.arrow_least_squares import LEAST_SQUARES, WindowBlock
from identification.estimation.information import information
from identification.estimation.uncertainty import covariance


def blocks_of(columns: list[np.ndarray], states: int = 0) -> list[WindowBlock]:
    rng = np.random.default_rng(1)
    return [WindowBlock(rng.normal(size=len(c)), c, rng.normal(size=(len(c), states))) for c in columns]


def test_samples_without_sensitivity_tell_nothing() -> None:
    """A slope is told by late samples, by t^2; a parameter of the second window by that alone."""
    time = np.linspace(0.0, 1.0, 40)
    nothing = np.zeros(40)
    blocks = blocks_of([np.column_stack([time, nothing]), np.column_stack([nothing, np.ones(40)])])
    told = information(blocks, covariance(blocks, LEAST_SQUARES, 1).curvature, 1)
    assert told.over_time[:, 0] == pytest.approx(time**2 / np.sum(time**2))
    assert told.over_time[:, 1] == pytest.approx(np.full(40, 1 / 40))
    assert told.by_window == pytest.approx(np.eye(2))


def test_shares_add_up_to_one_whatever_the_outputs_and_states() -> None:
    rng = np.random.default_rng(2)
    blocks = blocks_of([rng.normal(size=(60, 3)), rng.normal(size=(90, 3))], states=2)
    told = information(blocks, covariance(blocks, LEAST_SQUARES, 3).curvature, 3)
    for shares in (told.over_time, told.by_window, told.by_output):
        assert shares.sum(axis=0) == pytest.approx(np.ones(3))
    assert told.over_time.shape == (30, 3)


def test_shares_are_the_parts_of_the_variance() -> None:
    """Noise in one half of the samples alone gives the estimate the variance that this half has a share of."""
    rng = np.random.default_rng(3)
    columns = rng.normal(size=(80, 2)) * np.linspace(0.2, 2.0, 80)[:, None]
    blocks = blocks_of([columns])
    told = information(blocks, covariance(blocks, LEAST_SQUARES, 1).curvature, 1)
    answer = np.linalg.pinv(columns)
    noise = rng.normal(size=(80, 20000))
    first = noise * (np.arange(80) < 40)[:, None]
    share = np.var(answer @ first, axis=1) / np.var(answer @ noise, axis=1)
    assert told.over_time[:40].sum(axis=0) == pytest.approx(share, rel=0.1)


def test_a_parameter_that_is_not_seen_has_no_shares() -> None:
    blocks = blocks_of([np.column_stack([np.ones(20), np.zeros(20)])])
    told = information(blocks, covariance(blocks, LEAST_SQUARES, 1).curvature, 1)
    assert np.all(np.isnan(told.over_time[:, 1])) and told.by_window[0, 0] == pytest.approx(1)
