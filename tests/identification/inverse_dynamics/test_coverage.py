"""Least squares and instruments on known axes: what they find, and how often their intervals hold the truth."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.special import stdtrit

from identification.estimation.estimated_value import with_interval
from identification.inverse_dynamics.loop import PositionLoop
from identification.inverse_dynamics.regression import Regression, RegressionRows, regress
from identification.inverse_dynamics.rows import AxisRecord, prepared, with_instruments
from identification.inverse_dynamics.steadiness import shifts
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


def record(position: FloatArray, command: FloatArray, wanted: FloatArray, step: float = STEP) -> AxisRecord:
    force = GAIN * command
    return AxisRecord("a", "a", step, position, 0.5 * (force + np.r_[force[:1], force[:-1]]), wanted, 0.0)


def both_ways(given: AxisRecord, how: Filtering, loop: PositionLoop = LOOP) -> tuple[Regression, Regression]:
    """Least squares, and instruments from the axis in its loop by the values of that."""
    one = prepared(given, how, TERMS)
    plain = regress([RegressionRows(one.y, one.x, one.x, one.kept)], LEAST)
    values = dict(zip(TERMS, plain.values.tolist(), strict=True))
    return plain, regress([with_instruments(one, how, loop, values, TERMS, GAIN)], LEAST)


def gains(rate: float) -> tuple[float, float]:
    """Of a loop as fast as a controller of this rate [Hz] can be, up to that of the others."""
    speed_gain = min(SPEED_GAIN, 0.95 * rate)
    return speed_gain * GAIN / AXIS.mass / 3, speed_gain


def sampled(rate: float, duration: float, noise: float, draws: int) -> tuple[list[AxisRecord], PositionLoop]:
    """Records of the axis under a controller of this rate [Hz], and its loop."""
    wanted, own = driven_axis.reference(duration, 1 / rate), gains(rate)
    positions, commands = driven(AXIS, wanted, noise, draws, 7, 1 / rate, own)
    records = [record(q, u, wanted, 1 / rate) for q, u in zip(positions.T, commands.T, strict=True)]
    return records, PositionLoop("wanted", *own)


def test_without_noise_both_find_the_axis_to_what_the_filters_leave() -> None:
    wanted = driven_axis.reference(10.0)
    positions, commands = driven(AXIS, wanted, 0.0, 1, seed=1)
    for found in both_ways(record(positions[:, 0], commands[:, 0], wanted), HOW):
        assert found.values == pytest.approx(TRUTH, rel=5e-3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "cutoff"),
    [(50.0, 8.0), (50.0, 10.0), (100.0, 8.0), (100.0, 20.0), (200.0, 8.0), (200.0, 40.0), (1000.0, 20.0)],
)
def test_without_noise_the_axis_is_found_however_coarse_samples_and_low_the_cutoff(rate: float, cutoff: float) -> None:
    records, loop = sampled(rate, 20.0, 0.0, 1)
    for found in both_ways(records[0], Filtering(cutoff, 100.0, 0.01), loop):
        assert found.values == pytest.approx(TRUTH, rel=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rate", "cutoffs"),
    [(50.0, (8.0, 10.0)), (100.0, (8.0, 20.0)), (200.0, (8.0, 20.0, 40.0)), (1000.0, (20.0, 100.0))],
)
def test_intervals_hold_the_truth_however_coarse_samples_and_low_the_cutoff(
    rate: float, cutoffs: tuple[float, ...]
) -> None:
    records, loop = sampled(rate, 20.0, 2e-5, 200)
    for cutoff in cutoffs:
        held = np.zeros(len(TERMS))
        for one in records:
            found = both_ways(one, Filtering(cutoff, 100.0, 0.01), loop)[1]
            held += np.abs(found.values - TRUTH) <= stdtrit(found.freedom, 0.975) * np.sqrt(np.diag(found.covariance))
        assert np.all((held >= 180) & (held <= 198)), (cutoff, held)


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


@pytest.mark.slow
@pytest.mark.parametrize(("cutoff", "least_speed"), [(20.0, 0.01), (14.0, 0.01), (8.0, 0.0), (20.0, 0.0)])
def test_what_noise_and_rest_do_to_least_squares_is_in_their_intervals(cutoff: float, least_speed: float) -> None:
    """Plain intervals miss the mass nearly always there; with what moves it they hold it."""
    records, _ = sampled(100.0, 20.0, 2e-5, 100)
    how, plain, allowing = Filtering(cutoff, 100.0, least_speed), np.zeros(len(TERMS)), np.zeros(len(TERMS))

    def again(one: AxisRecord, other: Filtering) -> Regression:
        row = prepared(one, other, TERMS, prepared(one, how, TERMS).kept)
        return regress([RegressionRows(row.y, row.x, row.x, row.kept)], LEAST)

    for one in records:
        found = again(one, how)
        moved = shifts(found, how, [prepared(one, how, TERMS)], partial(again, one))
        off, stds = np.abs(found.values - TRUTH), np.sqrt(np.diag(found.covariance))
        plain += off <= 1.96 * stds
        by = np.sum([np.abs(shift.by) for shift in moved], axis=0)
        ends = [
            with_interval(value, std, off=most).ci95 for value, std, most in zip(found.values, stds, by, strict=True)
        ]
        allowing += [low <= true <= high for (low, high), true in zip(ends, TRUTH, strict=True)]
    assert plain[0] < 50
    assert np.all(allowing >= 90), allowing


def test_a_lower_cutoff_is_tried_on_the_same_rows_whatever_rest_it_would_let_in() -> None:
    """A noisy axis that rests between its moves: smoother speeds leave fewer of its rows out."""
    time = np.arange(4000) * STEP
    ahead = np.clip((time % 2 - 0.5) / 0.5, 0, 1) - np.clip((time % 2 - 1.5) / 0.5, 0, 1)
    wanted = 0.05 * (3 * ahead**2 - 2 * ahead**3)
    positions, commands = driven(AXIS, wanted, 2e-4, 1, seed=4)
    one, how = record(positions[:, 0], commands[:, 0], wanted), Filtering(100.0, 100.0, 0.01)
    kept = set(prepared(one, how, TERMS).kept)
    lower = replace(how, cutoff=24.0)
    assert set(prepared(one, lower, TERMS).kept) - kept
    asked: list[Filtering] = []

    def again(other: Filtering) -> Regression:
        asked.append(other)
        row = prepared(one, other, TERMS, prepared(one, how, TERMS).kept)
        assert set(row.kept) <= kept
        return regress([RegressionRows(row.y, row.x, row.x, row.kept)], LEAST)

    shifts(again(how), how, [prepared(one, how, TERMS)], again)
    assert {other.cutoff for other in asked} == {100.0, 24.0}
