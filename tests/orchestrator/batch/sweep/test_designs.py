"""Points of a design: any stretch is known without the others, does not depend on how many there are, and is spread as
the kind promises."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, norm

from orchestrator.batch.sweep.points.designs import (
    Grid,
    Hypercubes,
    MonteCarlo,
    Morris,
    PointDesign,
    SobolIndices,
    SobolSequence,
    seed_of,
)
from orchestrator.batch.sweep.points.factors import Factor, JointFactors, Levels, Space, TruncatedNormal, UniformBetween

SPACE = Space(
    (
        Factor("a.x", UniformBetween(2.0, 4.0)),
        Factor("a.y", TruncatedNormal(1.0, 0.5)),
        Factor("a.z", Levels((1.0, 5.0))),
    )
)
UNIT = Space(tuple(Factor(f"a.x{number}", UniformBetween(0.0, 1.0)) for number in range(3)))
KINDS: dict[str, Callable[[Space, int], PointDesign]] = {
    "monte-carlo": lambda space, count: MonteCarlo(space=space, count=count, seed=1),
    "sobol": lambda space, count: SobolSequence(space=space, count=count, seed=1),
    "hypercubes": lambda space, count: Hypercubes(space=space, count=count, seed=1, size=40),
    "sobol indices": lambda space, count: SobolIndices(space=space, count=count, seed=1),
    "morris": lambda space, count: Morris(space=space, count=count, seed=1),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@settings(max_examples=20)
@given(data=st.data())
def test_a_stretch_is_the_same_by_itself_and_of_a_larger_study(kind: str, data: st.DataObject) -> None:
    space = UNIT if kind == "morris" else SPACE
    first = data.draw(st.integers(0, 2500))
    stop = data.draw(st.integers(first, first + 300))
    small, large = KINDS[kind](space, stop), KINDS[kind](space, 5000)
    assert np.array_equal(small.points(first, stop), large.points(0, 3000)[first:stop])


@given(st.lists(st.integers(1, 4), min_size=0, max_size=4))
def test_a_grid_has_each_combination_once_the_last_factor_fastest(sizes: list[int]) -> None:
    factors = [Factor(f"a.x{n}", Levels(tuple(map(float, range(size))))) for n, size in enumerate(sizes)]
    grid = Grid(Space(tuple(factors)))
    assert [tuple(row) for row in grid.points(0, grid.count)] == list(np.ndindex(*sizes))


def test_each_hypercube_has_one_point_in_each_stratum_of_each_factor() -> None:
    points = KINDS["hypercubes"](UNIT, 120).points(0, 120)
    for cube in np.split(points, 3):
        assert np.array_equal(np.sort((cube * 40).astype(int), axis=0), np.repeat(np.arange(40)[:, None], 3, axis=1))


def test_a_sobol_sequence_is_evener_than_chance() -> None:
    """Of 2^10 points exactly one lies in each of 2^10 equal intervals of each factor."""
    points = KINDS["sobol"](UNIT, 1024).points(0, 1024)
    assert np.array_equal(np.sort((points * 1024).astype(int), axis=0), np.repeat(np.arange(1024)[:, None], 3, axis=1))


def test_drawn_values_have_their_distributions() -> None:
    points = MonteCarlo(space=SPACE, count=4000, seed=2).points(0, 4000)
    assert kstest(points[:, 0], "uniform", (2, 2)).pvalue > 1e-3
    assert kstest(points[:, 1], "norm", (1, 0.5)).pvalue > 1e-3
    assert abs(np.mean(points[:, 2] == 5) - 0.5) < 4 * 0.5 / np.sqrt(4000)


def test_a_normal_law_between_ends_is_the_truncated_one() -> None:
    law, shares = TruncatedNormal(1.0, 0.5, 0.8, 2.0), np.linspace(0.01, 0.99, 50)
    low, high = norm.cdf([0.8, 2.0], 1.0, 0.5)
    assert (norm.cdf(law.at(shares), 1.0, 0.5) - low) / (high - low) == pytest.approx(shares)


def test_factors_that_are_drawn_together_have_their_covariance() -> None:
    covariance = np.array([[4.0, 1.2], [1.2, 1.0]])
    joint = JointFactors(("a.x", "a.y"), np.array([10.0, -3.0]), np.linalg.cholesky(covariance))
    space = Space((Factor("a.x", TruncatedNormal(10.0, 2.0)), Factor("a.y", TruncatedNormal(-3.0, 1.0))), joint)
    points = MonteCarlo(space=space, count=20_000, seed=5).points(0, 20_000)
    assert points.mean(axis=0) == pytest.approx([10, -3], abs=0.06)
    assert np.cov(points.T) == pytest.approx(covariance, abs=0.12)


def test_a_trajectory_moves_one_factor_after_the_other_by_the_same() -> None:
    points = KINDS["morris"](UNIT, 400).points(0, 400)
    steps = np.diff(points.reshape(100, 4, 3), axis=1)
    assert np.allclose(np.sort(np.abs(steps), axis=2), [0, 0, 2 / 3])
    assert (np.argmax(np.abs(steps), axis=2).sum(axis=1) == 3).all() and set(np.sign(steps).ravel()) == {-1, 0, 1}
    assert points.min() >= 0 and points.max() <= 1


def test_a_base_sample_crosses_two_points_column_by_column() -> None:
    points = SobolIndices(space=UNIT, count=80, seed=1, second_order=True).points(0, 80)
    for a, *crossed, b in points.reshape(10, 8, 3):
        own = np.eye(3, dtype=bool)
        assert np.array_equal(crossed, [*np.where(own, b, a), *np.where(own, a, b)])


def test_seeds_differ_by_study_point_and_component_and_fit_an_integer_of_an_fmu() -> None:
    seeds = [seed_of(seed, point, part) for seed in range(4) for point in range(200) for part in range(3)]
    assert len(set(seeds)) == len(seeds) and min(seeds) >= 0 and max(seeds) < 2**31
    assert seed_of(1, 2, 0) == 1_938_974_512  # a contract: what was begun goes on with the same noise
