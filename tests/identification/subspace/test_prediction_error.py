"""Refinement of models: exact derivatives, minima, what is kept, and honest uncertainties."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from fmus.errors import IdentificationError
from identification.linear.local_coordinates import balanced_basis, local_directions
from identification.linear.model import LinearModel
from identification.linear.poles import Poles
from identification.linear.records import InputOutputData
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.refinement.prediction_error import Error, Refined, Refinement, refine, uncertainty
from identification.subspace.subspace import subspace
from identification.subspace.weightings import Weighting
from tests.support.identification.linear_systems import STEP, distance, random_system, record_of, system

FREE = np.ones((2, 1), dtype=bool)


def all_free(block: int, weighting: Weighting = "orse") -> SubspaceSettings:
    """Settings under which D is estimated, too."""
    return SubspaceSettings(block, weighting, feedthrough=True)


def refinement(error: Error = "output-error", **others: Any) -> Refinement:
    """One of D, too."""
    return Refinement(error, feedthrough=True, **others)


def start(records: list[InputOutputData], order: int, **changes: object) -> LinearModel:
    return subspace(records, order, replace(all_free(8, "moesp"), **changes)).model  # type: ignore[arg-type]


@given(st.integers(0, 1000))
@settings(max_examples=20, deadline=None)
def test_local_directions_are_all_that_changes_the_response(seed: int) -> None:
    model, rng = random_system(seed), np.random.default_rng(seed)
    directions = local_directions(model, FREE)
    assert len(directions) == model.order * 3 + 2
    flat = np.hstack(
        [part.reshape(len(directions), -1) for part in (directions.a, directions.b, directions.c, directions.d)]
    )
    assert flat @ flat.T == pytest.approx(np.eye(len(directions)), abs=1e-12)
    turn = 1e-6 * rng.standard_normal((5, 5))
    other = model.transformed(np.eye(5) + turn)
    change = np.concatenate([(getattr(other, name) - getattr(model, name)).ravel() for name in "abcd"])
    assert np.abs(flat @ change).max() < 1e-9


def test_balanced_states_are_as_large_as_what_they_do() -> None:
    model, u = random_system(3), np.random.default_rng(0).standard_normal((5000, 1))
    balanced = model.transformed(balanced_basis(model, [u]))
    reach = balanced.states(u).T @ balanced.states(u) / len(u)
    responses = [balanced.c @ np.linalg.matrix_power(balanced.a, k) for k in range(200)]
    seen = sum(response.T @ response for response in responses)
    assert reach == pytest.approx(np.diag(np.diag(reach)), abs=1e-8)
    assert seen == pytest.approx(reach, abs=1e-6)


@pytest.mark.parametrize("error", ["output-error", "innovations"])
@pytest.mark.parametrize("poles", ["free", "integrating"])
def test_derivatives_are_those_of_the_error(error: Error, poles: Poles) -> None:
    true = system([1.0, 0.9 * np.exp(0.7j)], outputs=2)
    records = [record_of(true, 150, 1, noise=0.05), record_of(true, 70, 2, noise=0.05)]
    found = refine(start(records, 3, poles=poles), records, refinement(error, poles=poles, iterations=1))
    problem, candidate = found.problem, found.candidate
    directions, step = problem.directions(candidate), 1e-6
    for record in range(2):
        rows = np.concatenate(list(problem.rows(candidate, directions, record, found.initial_states[record])))
        assert rows[:, -1] == pytest.approx(problem.errors(candidate, found.initial_states)[record].ravel())
        for i, unit in enumerate(np.eye(len(directions))):
            ahead, behind = (
                problem.errors(directions.moved(candidate, sign * step * unit), found.initial_states)[record]
                for sign in (1, -1)
            )
            slope = (behind - ahead).ravel() / (2 * step)
            assert rows[:, 3 + i] == pytest.approx(slope, abs=1e-6 * np.abs(slope).max() + 1e-6)
        for i, unit in enumerate(np.eye(3)):
            moved = found.initial_states + unit
            change = problem.errors(candidate, found.initial_states)[record] - problem.errors(candidate, moved)[record]
            assert rows[:, i] == pytest.approx(change.ravel(), abs=1e-9)


def test_the_minimum_is_that_of_a_general_purpose_optimiser() -> None:
    true = random_system(2, pairs=1, real=0)
    record = record_of(true, 300, noise=0.3)
    found = refine(start([record], 2), record, refinement(tolerance=1e-12))

    def residuals(theta: np.ndarray) -> np.ndarray:
        (a, b, c, d, x) = np.split(theta, np.cumsum([4, 2, 4, 2]))
        model = LinearModel(a.reshape(2, 2), b[:, None], c.reshape(2, 2), d[:, None], STEP, ("u1",), ("y1", "y2"))
        return np.asarray(((record.y - model.simulate(record.u, x)) * found.weights).ravel())

    guess = np.concatenate([*(getattr(found.model, name).ravel() for name in "abcd"), found.initial_states[0]])
    theirs = least_squares(residuals, guess + 1e-3, xtol=1e-12, ftol=1e-12)
    assert found.converged
    assert 2 * theirs.cost / 300 == pytest.approx(found.cost, rel=1e-6)


@given(st.integers(0, 1000))
@settings(max_examples=10, deadline=None)
def test_the_error_never_grows_and_noise_free_data_give_the_system(seed: int) -> None:
    true = random_system(seed)
    records = [record_of(true, 300, seed), record_of(true, 200, seed + 1)]
    near = replace(true, a=true.a * 0.998, b=true.b * 1.05)
    found = refine(near, records, refinement(tolerance=1e-14))
    assert found.cost <= found.first_cost
    assert distance(found.model, true) < 1e-6


def test_refinement_beats_the_subspace_estimate_it_started_from_on_average() -> None:
    true, gains = random_system(4), []
    for seed in range(8):
        record = record_of(true, 500, seed, noise=0.3)
        model = subspace(record, 5, all_free(8)).model
        gains.append(distance(refine(model, record, refinement()).model, true) / distance(model, true))
    assert np.exp(np.mean(np.log(gains))) < 0.9


def test_weights_say_which_output_matters() -> None:
    true = random_system(5)
    record = record_of(true, 800, noise=0.3)
    record = replace(record, y=record.y + 0.5 * np.abs(record.y))
    sizes = np.sqrt(np.mean(record.y**2, axis=0))
    model, errors = start([record], 5), []
    for first in (10.0, 0.1):
        found = refine(model, record, refinement(weights=(first / sizes[0], 1 / sizes[1])))
        errors.append(np.mean((record.y - found.model.simulate(record.u, found.initial_states[0])) ** 2, axis=0))
    assert errors[0][0] < errors[1][0]
    assert errors[0][1] > errors[1][1]


def test_a_stable_model_stays_stable_and_an_integrator_stays_on_one() -> None:
    true = system([1.0, 0.995 * np.exp(0.7j)], outputs=2)
    record = record_of(true, 500, 3, noise=0.3)
    stable = refine(start([record], 3, poles="stable"), record, refinement(poles="stable"))
    assert np.abs(stable.model.eigenvalues).max() < 1
    integrating = refine(start([record], 3, poles="integrating"), record, refinement(poles="integrating"))
    assert np.abs(integrating.model.eigenvalues - 1).min() < 1e-10
    assert integrating.converged
    assert len(integrating.directions) == 3 * 3 + 2 - 1
    assert integrating.cost < integrating.first_cost


def test_no_feedthrough_stays_none_and_starts_at_rest_stay_at_rest() -> None:
    true = replace(random_system(6), d=np.zeros((2, 1)))
    record = record_of(true, 400, noise=0.1, settled=True)
    found = refine(start([record], 5), record, Refinement(feedthrough=False, initial_states=False))
    assert not found.model.d.any()
    assert not found.initial_states.any()
    assert found.cost < 0.02
    assert uncertainty(found).matrix.shape == (15, 15)


class TestInnovations:
    """A loop closed over coloured noise."""

    TRUE = LinearModel(
        np.array([[0.8, 0.5], [-0.5, 0.8]]),
        np.array([[0.3], [0.2]]),
        np.array([[1.0, 0.5]]),
        np.zeros((1, 1)),
        STEP,
        ("u1",),
        ("y1",),
    )
    GAIN = np.array([[0.6], [-0.4]])

    def record(self, samples: int, seed: int) -> InputOutputData:
        rng = np.random.default_rng(seed)
        aim, e = 0.5 * rng.standard_normal(samples), rng.standard_normal(samples)
        u, y, x = np.zeros((samples, 1)), np.zeros((samples, 1)), np.zeros(2)
        for k in range(samples):
            y[k] = self.TRUE.c @ x + e[k]
            u[k] = aim[k] - 0.4 * y[k]
            x = self.TRUE.a @ x + self.TRUE.b @ u[k] + self.GAIN[:, 0] * e[k]
        return InputOutputData(u, y, STEP)

    def refined(self, error: Error) -> Refined:
        record = self.record(20_000, 1)
        begun = subspace(record, 2, SubspaceSettings(10, feedthrough=False, closed_loop=True))
        return refine(begun.model, record, Refinement(error, feedthrough=False), begun.gain)

    def test_innovations_are_right_where_the_free_run_s_error_misleads(self) -> None:
        innovations, output_error = self.refined("innovations"), self.refined("output-error")
        assert distance(innovations.model, self.TRUE) < 0.1
        assert distance(output_error.model, self.TRUE) > 2 * distance(innovations.model, self.TRUE)
        assert innovations.cost / innovations.weights[0] ** 2 == pytest.approx(1.0, rel=0.03)
        truth = self.TRUE.c @ self.GAIN
        assert innovations.model.c @ innovations.gain == pytest.approx(truth, abs=0.05)
        assert output_error.gain.shape == (2, 0)

    def test_innovations_may_start_without_a_gain(self) -> None:
        record = self.record(4000, 2)
        begun = subspace(record, 2, SubspaceSettings(10, feedthrough=False, closed_loop=True))
        given_gain = refine(begun.model, record, Refinement("innovations", feedthrough=False), begun.gain)
        without = refine(begun.model, record, Refinement("innovations", feedthrough=False))
        assert without.cost == pytest.approx(given_gain.cost, rel=1e-4)


def pole_deviation(found: Refined) -> tuple[complex, float]:
    """The upper pole and the standard deviation of its real part, from `directions` and `uncertainty`."""
    values, right = np.linalg.eig(found.model.a)
    left = np.linalg.inv(right)
    i = int(np.argmax(values.imag))
    slopes = np.array([left[i] @ change @ right[:, i] for change in found.directions.a])
    return complex(values[i]), float(np.sqrt(slopes.real @ uncertainty(found).matrix @ slopes.real))


@pytest.mark.parametrize("error", ["output-error", "innovations"])
def test_deviations_of_a_pole_are_those_over_repeated_experiments(error: Error) -> None:
    true, poles, deviations = system([0.9 * np.exp(0.6j)]), [], []
    for seed in range(40):
        record = record_of(true, 400, seed, noise=0.3)
        found = refine(start([record], 2), record, refinement(error))
        pole, deviation = pole_deviation(found)
        poles.append(pole.real)
        deviations.append(deviation)
    assert np.median(deviations) == pytest.approx(np.std(poles, ddof=1), rel=0.35)


class TestBadInput:
    """What cannot be refined is refused by name."""

    RECORD = record_of(random_system(3), 300, noise=0.1)

    def test_a_start_that_overflows(self) -> None:
        runaway = system([30.0], outputs=2)
        with pytest.raises(IdentificationError, match="the free run of the start overflows"):
            refine(runaway, self.RECORD, refinement(initial_states=False))
        with pytest.raises(IdentificationError, match="overflows; give the gain of a predictor"):
            refine(runaway, self.RECORD, refinement("innovations"))

    def test_records_of_other_columns(self) -> None:
        other = replace(self.RECORD, inputs=("torque",))
        with pytest.raises(IdentificationError, match="torque"):
            refine(random_system(3), other, refinement())

    def test_weights_that_do_not_fit(self) -> None:
        with pytest.raises(IdentificationError, match="weights"):
            refine(random_system(3), self.RECORD, refinement(weights=(1.0,)))
