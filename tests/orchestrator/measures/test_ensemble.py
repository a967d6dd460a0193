"""The chance that a like signal is taken for another one is the one that is stated."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal, stats

from fmus.errors import TraceError
from orchestrator.measures import band, membership


def noisy(rng: np.random.Generator, count: int) -> np.ndarray:
    """(count, 60) a mean with coloured, skewed noise that grows."""
    noise = signal.lfilter([1.0], [1.0, -0.8], rng.exponential(size=(count, 60)), axis=1)
    return np.linspace(0, 3, 60) + np.linspace(0, 1, 60) * noise


@pytest.mark.parametrize("draws", [19, 39])
def test_one_more_draw_is_the_farthest_out_as_often_as_is_stated(draws: int) -> None:
    rng, trials = np.random.default_rng(draws), 400
    pools = [noisy(rng, draws + 1) for _ in range(trials)]
    failures = sum(membership(pool[0], pool[1:]).chance <= 1 / (draws + 1) + 1e-12 for pool in pools)
    low, high = stats.binom.interval(0.999, trials, 1 / (draws + 1))
    assert low <= failures <= high


def test_a_signal_that_moves_out_of_the_noise_is_told() -> None:
    pool = noisy(np.random.default_rng(1), 51)
    assert membership(pool[0], pool[1:]).chance > 0.02
    moved = pool[0] + np.where(np.arange(60) == 40, 12.0, 0.0)
    found = membership(moved, pool[1:])
    assert (found.chance, found.at) == (1 / 51, 40)
    assert found.score > 2 * found.median_score


@settings(max_examples=30)
@given(st.integers(2, 12), st.integers(0, 999))
def test_chances_are_ranks_and_no_two_draws_share_a_better_one(count: int, seed: int) -> None:
    pool = noisy(np.random.default_rng(seed), count + 1)
    chances = [membership(pool[i], np.delete(pool, i, axis=0)).chance for i in range(count + 1)]
    ranks = (np.arange(count + 1) + 1) / (count + 1)
    assert min(chances) < 1 and np.all(np.sort(chances) >= ranks - 1e-12)  # ties are on the safe side


@settings(max_examples=60)
@given(st.integers(5, 25), st.integers(1, 3), st.integers(0, 999))
def test_a_signal_leaves_the_band_just_when_it_ranks_among_the_farthest_out(draws: int, rank: int, seed: int) -> None:
    pool = noisy(np.random.default_rng(seed), draws + 1)
    values = pool[0] + np.random.default_rng(seed).choice([0.0, 1.0, 3.0])
    lower, upper = band(values, pool[1:], 0.05, 0.95, rank)
    inside = bool(np.all((values >= lower - 1e-9) & (values <= upper + 1e-9)))
    assert inside == (round(membership(values, pool[1:]).chance * (draws + 1)) > rank)


def test_where_there_is_no_noise_a_difference_beyond_a_thousandth_of_the_range_is_far_out() -> None:
    draws = np.tile(np.linspace(0.0, 1.0, 50), (20, 1))
    assert membership(draws[0], draws).chance == 1.0
    assert membership(draws[0] + 2e-3, draws).chance == 1 / 21
    assert membership(np.ones(5), np.ones((9, 5))).chance == 1.0


def test_many_instants_are_scored_piece_by_piece_alike() -> None:
    pool = np.random.default_rng(0).standard_normal((6, 40_000))
    found = membership(pool[0], pool[1:])
    middle = np.median(pool, axis=0)
    half = np.where(pool > middle, np.quantile(pool, 0.95, axis=0) - middle, middle - np.quantile(pool, 0.05, axis=0))
    scores = np.max(np.abs(pool - middle) / np.maximum(half, 1e-3 * np.ptp(pool)), axis=1)
    assert found.score == pytest.approx(scores[0])
    assert found.chance == np.mean(scores >= scores[0])


def test_what_cannot_be_ranked_is_refused() -> None:
    with pytest.raises(TraceError, match="have shape"):
        membership([1.0, 2.0], np.ones((4, 3)))
    with pytest.raises(TraceError, match="a value is not finite"):
        membership([1.0, np.nan], np.ones((4, 2)))
    with pytest.raises(TraceError, match="do not hold the median"):
        membership([1.0], np.ones((4, 1)), 0.6, 0.9)
