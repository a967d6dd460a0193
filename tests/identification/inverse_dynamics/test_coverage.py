"""Least squares and instruments on known axes: what they find, and how often their intervals hold the truth."""

from __future__ import annotations

import numpy as np
import pytest

from identification.inverse_dynamics.loop import PositionLoop
from identification.inverse_dynamics.regression import Regression, RegressionRows, regress
from identification.inverse_dynamics.rows import AxisRecord, prepared, with_instruments
from identification.inverse_dynamics.study import Filtering
from identification.inverse_dynamics.terms import Term
from orchestrator.trace import FloatArray
from tests.support.identification import driven_axis
from tests.support.identification.driven_axis import GAIN, POSITION_GAIN, SPEED_GAIN, STEP, Axis, driven

TERMS: list[Term] = ["inertia", "viscous_positive", "viscous_negative", "coulomb_positive", "coulomb_negative"]
AXIS = Axis()
TRUTH = np.array([AXIS.mass, *AXIS.viscous, *AXIS.coulomb])
LEAST = np.zeros(len(TERMS))
HOW = Filtering(cutoff=200, rows_per_second=200, least_speed=0.01)
LOOP = PositionLoop("wanted", POSITION_GAIN, SPEED_GAIN)


def record(position: FloatArray, command: FloatArray, wanted: FloatArray) -> AxisRecord:
    force = GAIN * command
    return AxisRecord("a", "a", STEP, position, 0.5 * (force + np.r_[force[:1], force[:-1]]), wanted, 0.0)


def both_ways(given: AxisRecord, how: Filtering) -> tuple[Regression, Regression]:
    """Least squares, and instruments from the axis in its loop by the values of that."""
    one = prepared(given, how, TERMS)
    plain = regress([RegressionRows(one.y, one.x, one.x)], LEAST)
    values = dict(zip(TERMS, plain.values.tolist(), strict=True))
    return plain, regress([with_instruments(one, how, LOOP, values, TERMS, GAIN)], LEAST)


def test_without_noise_both_find_the_axis_to_what_the_filters_leave() -> None:
    wanted = driven_axis.reference(10.0)
    positions, commands = driven(AXIS, wanted, 0.0, 1, seed=1)
    for found in both_ways(record(positions[:, 0], commands[:, 0], wanted), HOW):
        assert found.values == pytest.approx(TRUTH, rel=5e-3)


@pytest.mark.slow
def test_intervals_by_instruments_hold_the_truth_where_least_squares_are_biased_by_noise() -> None:
    """The encoder's noise goes through the loop into the force; rows that fast have it in their accelerations."""
    wanted = driven_axis.reference(20.0)
    positions, commands = driven(AXIS, wanted, 2e-5, 200, seed=2)
    held = np.zeros((2, len(TERMS)))
    for k in range(positions.shape[1]):
        for way, found in enumerate(both_ways(record(positions[:, k], commands[:, k], wanted), HOW)):
            half = 1.96 * np.sqrt(np.diag(found.covariance))
            held[way] += np.abs(found.values - TRUTH) <= half
    plain, instrumental = held / positions.shape[1]
    assert np.all(np.abs(instrumental - 0.95) <= 0.04), instrumental
    assert plain[0] < 0.05
