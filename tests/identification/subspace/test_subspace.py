"""Subspace estimates of known systems, against the published algorithm written out and python-control."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, get_args

import control
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.estimation.validation import delta
from identification.linear.model import LinearModel
from identification.linear.records import InputOutputData
from identification.subspace.orders import Best, Gap, Threshold
from identification.subspace.range_space import SubspaceSettings, range_space
from identification.subspace.realisation import realise, simulated
from identification.subspace.subspace import subspace
from identification.subspace.weightings import Weighting
from tests.support.identification.linear_systems import STEP, distance, random_system, record_of, sorted_poles, system

WEIGHTINGS = get_args(Weighting)


def all_free(block: int, weighting: Weighting = "orse", **others: Any) -> SubspaceSettings:
    """Settings under which D is estimated, too."""
    return SubspaceSettings(block, weighting, feedthrough=True, **others)


def as_published(record: InputOutputData, block: int, order: int) -> LinearModel:
    """ORSE with every matrix formed: Eqs. 2-19, 2-21, steps 3 and 4, 2-14 and 2-17."""
    y, u = (np.array([np.ravel(z[k : k + block]) for k in range(len(z) - block + 1)]).T for z in (record.y, record.u))
    left, _, _ = np.linalg.svd(y @ y.T - y @ u.T @ np.linalg.pinv(u @ u.T) @ (y @ u.T).T)
    p, psi = record.y.shape[1], left[:, :order]
    a, c = np.linalg.pinv(psi[:-p]) @ psi[p:], psi[:p]
    model = LinearModel(a, np.zeros((order, 1)), c, np.zeros((p, 1)), record.step, record.inputs, record.outputs)
    columns = [np.outer(record.u[:, 0], row).ravel() for row in np.eye(p)]
    for unit in np.eye(order):
        columns.append(replace(model, b=unit[:, None]).simulate(record.u).ravel())
    theta = np.linalg.pinv(np.array(columns).T) @ record.y.ravel()
    return replace(model, b=theta[p:, None], d=theta[:p, None])


def test_orse_is_the_published_algorithm() -> None:
    record = record_of(random_system(4, pairs=3), 900, noise=0.2, settled=True)
    found = subspace(record, 7, all_free(10, initial_states=False))
    assert distance(found.model, as_published(record, 10, 7)) < 1e-8


def test_published_singular_values_are_the_squares() -> None:
    record = record_of(random_system(4), 300, noise=0.2)
    y, u = (np.array([np.ravel(z[k : k + 6]) for k in range(len(z) - 5)]).T for z in (record.y, record.u))
    published = np.linalg.svd(y @ y.T - y @ u.T @ np.linalg.pinv(u @ u.T) @ u @ y.T, compute_uv=False)
    assert subspace(record, 3, all_free(6)).space.values ** 2 == pytest.approx(published, rel=1e-9)


@pytest.mark.parametrize("closed_loop", [False, True])
@pytest.mark.parametrize("weighting", WEIGHTINGS)
@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (1, 4), (2, 3)])
def test_noise_free_data_give_the_system_exactly(
    weighting: Weighting, inputs: int, outputs: int, closed_loop: bool
) -> None:
    true = random_system(8, pairs=2, real=1, inputs=inputs, outputs=outputs)
    records = [record_of(true, 500, 1), record_of(true, 300, 2)]
    found = subspace(records, 5, all_free(9, weighting, closed_loop=closed_loop))
    assert sorted_poles(found.model) == pytest.approx(sorted_poles(true), abs=1e-8)
    assert distance(found.model, true) < 1e-8
    assert np.max(found.delta) < 1e-8
    assert (found.model.inputs, found.model.outputs, found.model.step) == (true.inputs, true.outputs, STEP)


@given(seed=st.integers(0, 10_000), weighting=st.sampled_from(WEIGHTINGS))
@settings(max_examples=25, deadline=None)
def test_any_stable_system_is_recovered_and_a_record_may_be_split(seed: int, weighting: Weighting) -> None:
    true = random_system(seed)
    whole = record_of(true, 600, seed)
    for records in ([whole], [whole.rows(0, 250), whole.rows(250, 600)]):
        found = subspace(records, true.order, all_free(8, weighting))
        assert distance(found.model, true) < 1e-7
        assert np.max(found.delta) < 1e-7


@given(st.integers(0, 10_000))
@settings(max_examples=15, deadline=None)
def test_units_of_the_signals_do_not_change_what_is_found(seed: int) -> None:
    record = record_of(random_system(seed, outputs=1), 600, seed, noise=0.05)
    plain = subspace(record, 5, all_free(8)).model
    scaled = subspace(replace(record, u=record.u * 1e3, y=record.y * 1e-4), 5, all_free(8)).model
    assert distance(replace(scaled, b=scaled.b * 1e7, d=scaled.d * 1e7), plain) < 1e-6


def test_weights_stand_for_units_of_the_outputs() -> None:
    record = record_of(random_system(5, outputs=3), 800, noise=0.2)
    factors = np.array([100.0, 1.0, 0.01])
    weighted = subspace(record, 5, all_free(8, weights=tuple(factors)))
    rescaled = subspace(replace(record, y=record.y * factors), 5, all_free(8)).model
    back = replace(rescaled, c=rescaled.c / factors[:, None], d=rescaled.d / factors[:, None])
    assert distance(weighted.model, back) < 1e-8
    assert (
        np.abs(
            subspace(record, 5, all_free(8)).model.frequency_response(np.ones(1)) - back.frequency_response(np.ones(1))
        ).max()
        > 1e-4
    )


def test_compression_does_not_change_what_is_found() -> None:
    record = record_of(random_system(6), 3000, noise=0.1)
    for weighting in WEIGHTINGS:
        one, other = (subspace(record, 5, all_free(10, weighting, compression=kind)) for kind in ("gram", "qr"))
        assert (one.space.compression, other.space.compression) == ("gram", "qr")
        assert distance(one.model, other.model) < 1e-8


def test_a_hundred_thousand_samples_are_as_good_as_the_written_out_matrices() -> None:
    record = record_of(random_system(2, pairs=2, real=0, outputs=1), 100_000, noise=0.1, settled=True)
    found = subspace(record, 4, all_free(5, initial_states=False))
    assert distance(found.model, as_published(record, 5, 4)) < 1e-8


@pytest.mark.parametrize("weighting", ["moesp", "n4sid", "cva"])
def test_predictions_of_unseen_data_are_as_good_as_the_true_system_s_to_two_per_cent(weighting: Weighting) -> None:
    true = random_system(9, outputs=4)
    seen, unseen = record_of(true, 4000, 1, noise=0.1), record_of(true, 2000, 2, settled=True)
    model = subspace(seen, 5, all_free(12, weighting)).model
    theirs = control.forced_response(model.control(), inputs=unseen.u.T).outputs.T
    assert np.all(delta(unseen.y, theirs) < 0.02)


def test_past_inputs_alone_are_instruments_against_noise_that_resonates_itself() -> None:
    true = system([0.9 * np.exp(0.5j)])
    record, noise = record_of(true, 40_000), record_of(system([0.97 * np.exp(0.8j)], seed=1), 40_000, 5).y
    noisy = replace(record, y=record.y + noise / noise.std() * record.y.std())
    published = subspace(noisy, 2, all_free(8)).model
    instrumental = subspace(noisy, 2, all_free(8, "moesp", past=20, instruments="inputs")).model
    pole = 0.9 * np.exp(0.5j)
    assert np.abs(instrumental.eigenvalues - pole).min() < 0.005
    assert np.abs(published.eigenvalues - pole).min() > 0.1


def test_no_feedthrough_is_none() -> None:
    record = record_of(replace(random_system(3), d=np.zeros((2, 1))), 500, noise=0.1)
    for closed_loop in (False, True):
        found = subspace(record, 5, SubspaceSettings(8, feedthrough=False, closed_loop=closed_loop)).model
        assert not found.d.any()
    exact = subspace(
        record_of(replace(random_system(3), d=np.zeros((2, 1))), 500), 5, SubspaceSettings(8, feedthrough=False)
    )
    assert np.max(exact.delta) < 1e-8


def test_initial_states_are_those_of_the_records() -> None:
    true = random_system(7)
    records = [record_of(true, 400, 1), record_of(true, 300, 2)]
    found = subspace(records, 5, all_free(8))
    for record, start in zip(records, found.initial_states, strict=True):
        assert found.model.simulate(record.u[:40], start) == pytest.approx(record.y[:40], abs=1e-7)
    assert not subspace(records, 5, all_free(8, initial_states=False)).initial_states.any()


def test_the_errors_are_those_of_the_free_run() -> None:
    record = record_of(random_system(7), 400, noise=0.3)
    found = subspace(record, 5, all_free(8))
    run = found.model.simulate(record.u, found.initial_states[0])
    assert found.delta[0] == pytest.approx(delta(record.y, run))
    assert found.rms[0] == pytest.approx(np.sqrt(np.mean((record.y - run) ** 2, axis=0)))


def test_gaps_split_a_record_and_are_counted() -> None:
    true = random_system(7)
    record = record_of(true, 900)
    y = record.y.copy()
    y[300, 0] = y[305, 1] = np.nan
    record = replace(record, y=y)
    found = subspace(record, 5, all_free(8))
    assert distance(found.model, true) < 1e-8
    assert [len(piece) for piece in found.records] == [300, 594]
    assert (found.space.pieces.dropped, found.space.pieces.lost) == (1, 4)


def test_an_order_is_read_from_noise_free_singular_values_by_threshold_and_gap() -> None:
    record = record_of(random_system(1), 500)
    for rule in (Threshold(1e-6), Gap(1, 12)):
        found = subspace(record, rule, all_free(8))
        assert found.order == 5
        assert "5" in found.why


def test_the_best_order_is_the_smallest_that_predicts_about_as_well_as_any() -> None:
    true = random_system(1)
    record, other = record_of(true, 3000, 1, noise=0.05), record_of(true, 1000, 2, noise=0.05)
    for rule in (Best(range(2, 9)), Best(range(2, 9), validation=[other])):
        found = subspace(record, rule, all_free(8, "cva"))
        assert found.order == 5
        assert "order 5" in found.why


def test_free_runs_start_from_the_state_that_fits_them_best() -> None:
    true = random_system(1)
    record = record_of(true, 300, 4)
    for horizon in (None, 50):
        (run,) = simulated(true, [record], horizon)
        assert run == pytest.approx(record.y, abs=1e-9)


class TestUnstable:
    """Poles on and outside the unit circle."""

    TRUE = system([1.03, 0.9 * np.exp(0.8j)], outputs=2)

    def test_an_unstable_system_held_by_feedback_is_recovered_from_a_record_over_which_it_would_overflow(self) -> None:
        rng = np.random.default_rng(0)
        u, x, rows = rng.standard_normal((2400, 1)), np.zeros(3), []
        for k in range(len(u)):
            u[k] -= self._feedback(x)
            rows.append(self.TRUE.c @ x + self.TRUE.d @ u[k])
            x = self.TRUE.a @ x + self.TRUE.b @ u[k]
        found = subspace(InputOutputData(u, np.array(rows), STEP), 3, all_free(8))
        assert sorted_poles(found.model) == pytest.approx(sorted_poles(self.TRUE), abs=1e-8)
        assert distance(found.model, self.TRUE) < 1e-6

    def _feedback(self, x: np.ndarray) -> np.ndarray:
        """A pulse against the unstable mode."""
        values, left = np.linalg.eig(self.TRUE.a.T)
        w = left[:, np.argmax(np.abs(values))].real
        return np.atleast_1d(0.1 * (w @ x) / (w @ self.TRUE.b[:, 0]))

    def test_stable_poles_are_kept_and_the_unstable_one_is_reflected(self) -> None:
        record = record_of(self.TRUE, 300)
        found = subspace(record, 3, all_free(8, poles="stable"))
        assert [move.before for move in found.moves] == pytest.approx([1.03])
        assert [move.after for move in found.moves] == pytest.approx([1 / 1.03])
        assert np.abs(found.model.eigenvalues).max() < 1
        assert np.isfinite(found.delta).all()

    def test_a_run_that_overflows_without_initial_states_is_refused(self) -> None:
        runaway = system([3.0], outputs=1)
        u = np.random.default_rng(0).standard_normal((3000, 1))
        y = np.concatenate([runaway.simulate(u[:50]), np.random.default_rng(1).standard_normal((2950, 1))])
        with pytest.raises(IdentificationError, match="overflows within a record; estimate initial states"):
            realise(_with_pole(range_space(InputOutputData(u, y, STEP), all_free(4, initial_states=False)), 3.0), 1)


def _with_pole(space, pole):  # type: ignore[no-untyped-def]
    """The range space of another system."""
    return replace(space, basis=pole ** np.arange(4.0)[:, None])


def test_an_integrating_model_has_a_pole_on_one() -> None:
    true = system([1.0, 0.9 * np.exp(0.8j)], outputs=2)
    found = subspace(record_of(true, 2000, noise=0.02), 3, all_free(8, "cva", poles="integrating"))
    nearest = found.model.eigenvalues[np.argmin(np.abs(found.model.eigenvalues - 1))]
    assert nearest == pytest.approx(1, abs=1e-12)
    assert len(found.moves) == 1
    assert np.mean(found.delta) < 0.1


def test_an_integrating_model_without_a_real_pole_is_refused() -> None:
    true = system([0.9 * np.exp(0.8j)])
    with pytest.raises(IdentificationError, match="has no real pole to put on 1; choose another order"):
        subspace(record_of(true, 500), 2, all_free(6, poles="integrating"))


class TestClosedLoop:
    """A light mode and a slow one, held by feedback from an output with coloured noise."""

    TRUE = replace(system([0.97 * np.exp(0.6j), 0.95]), d=np.zeros((1, 1)))

    def record(self, samples: int, seed: int) -> InputOutputData:
        rng = np.random.default_rng(seed)
        true, x, v, last = self.TRUE, np.zeros(3), 0.0, 0.0
        aim, e = 0.5 * rng.standard_normal(samples), 0.5 * rng.standard_normal(samples)
        u, y = np.zeros((samples, 1)), np.zeros((samples, 1))
        gain = self.stabilising()
        for k in range(samples):
            v, last = 0.9 * v + e[k] + 0.5 * last, e[k]
            y[k] = true.c @ x + v
            u[k] = aim[k] - gain * y[k]
            x = true.a @ x + true.b @ u[k]
        return InputOutputData(u, y, STEP)

    def stabilising(self) -> float:
        """The gain that damps best among a few, with its sign."""
        gains = np.linspace(-1, 1, 81)
        radii = [np.abs(np.linalg.eigvals(self.TRUE.a - g * self.TRUE.b @ self.TRUE.c)).max() for g in gains]
        return float(0.7 * gains[int(np.argmin(radii))])

    @staticmethod
    def pole_error(model: LinearModel) -> float:
        return float(np.abs(model.eigenvalues - 0.97 * np.exp(0.6j)).min())

    def test_feedback_biases_the_plain_estimates_and_the_remedy_is_consistent(self) -> None:
        errors: dict[str, list[float]] = {}
        for samples in (4_000, 40_000):
            record = self.record(samples, 1)
            for weighting in ("orse", "moesp"):
                plain = subspace(record, 3, SubspaceSettings(15, weighting, past=30, feedthrough=False))
                errors.setdefault(weighting, []).append(distance(plain.model, self.TRUE))
            whitened = subspace(record, 4, SubspaceSettings(15, past=30, feedthrough=False, closed_loop=True))
            errors.setdefault("closed loop", []).append(distance(whitened.model, self.TRUE))
            assert self.pole_error(whitened.model) < self.pole_error(plain.model)
        assert min(errors["orse"][1], errors["moesp"][1]) > 3 * errors["closed loop"][1]
        assert errors["closed loop"][1] < 0.5 * errors["closed loop"][0]

    def test_its_gain_whitens_the_one_step_error(self) -> None:
        record = self.record(20_000, 2)
        found = subspace(record, 4, SubspaceSettings(15, past=30, feedthrough=False, closed_loop=True))
        assert found.gain is not None
        b = np.hstack([found.model.b, found.gain])
        predictor = LinearModel(
            found.model.a - found.gain @ found.model.c,
            b,
            found.model.c,
            np.zeros((1, 2)),
            STEP,
            ("u1", "measured y1"),
            ("y1",),
        )
        error = record.y - predictor.simulate(np.hstack([record.u, record.y]), found.initial_states[0])
        e = error[50:, 0]
        assert np.std(e) == pytest.approx(0.5, rel=0.03)
        correlations = [e[:-k] @ e[k:] / (e @ e) for k in range(1, 20)]
        assert np.abs(correlations).max() < 4 / np.sqrt(len(e))

    def test_poles_on_request_leave_the_predictor_alone(self) -> None:
        found = subspace(
            self.record(20_000, 2),
            4,
            SubspaceSettings(15, past=30, feedthrough=False, closed_loop=True, poles="integrating"),
        )
        assert np.abs(found.model.eigenvalues - 1).min() < 1e-9
        assert found.gain is not None
        assert np.abs(np.linalg.eigvals(found.model.a - found.gain @ found.model.c)).max() < 1
        assert [move.after for move in found.moves] == [1]

    def test_a_past_shorter_than_the_block_is_refused(self) -> None:
        with pytest.raises(IdentificationError, match="past 5 is below block 15"):
            all_free(15, past=5, closed_loop=True)


class TestBadInput:
    """What the data do not bear is refused by name."""

    RECORD = record_of(random_system(3), 400, noise=0.1)

    def test_a_record_too_short_for_the_block(self) -> None:
        with pytest.raises(
            IdentificationError, match="record 0: the longest piece without a gap has 30 samples, 40 ar"
        ):
            subspace(self.RECORD.rows(0, 30), 3, all_free(40))

    def test_fewer_columns_than_rows(self) -> None:
        with pytest.raises(IdentificationError, match="60 samples give 41 columns for the 60 rows"):
            subspace(self.RECORD.rows(0, 60), 3, all_free(20))

    @pytest.mark.parametrize(("u", "rank"), [(np.ones(400), 1), (np.zeros(400), 0), (np.sin(0.3 * np.arange(400)), 2)])
    @pytest.mark.parametrize("weighting", ["orse", "moesp"])
    def test_an_input_that_does_not_excite_with_its_rank(self, u: np.ndarray, rank: int, weighting: Weighting) -> None:
        needed = 8 if weighting == "orse" else 16
        with pytest.raises(IdentificationError, match=f"record 0.u1: .* has rank {rank}, {needed} is needed"):
            subspace(replace(self.RECORD, u=u), 3, all_free(8, weighting))

    def test_an_output_that_never_changes(self) -> None:
        record = replace(self.RECORD, y=np.column_stack([self.RECORD.y[:, 0], np.full(400, 2.0)]))
        with pytest.raises(IdentificationError, match=r"record 0.y2: is constant"):
            subspace(record, 3, all_free(8))

    def test_unequal_sampling(self) -> None:
        with pytest.raises(IdentificationError, match="resample them to one step"):
            subspace([self.RECORD, replace(self.RECORD, step=0.02, name="slow")], 3, all_free(8))

    def test_an_order_that_the_block_cannot_determine(self) -> None:
        with pytest.raises(IdentificationError, match="15 is more than the 14 states that this block size determines"):
            subspace(self.RECORD, 15, all_free(8))

    def test_an_order_that_the_data_do_not_bear(self) -> None:
        with pytest.raises(IdentificationError, match="the data bear no more than 5 states, not 6"):
            subspace(record_of(random_system(3), 400), 6, all_free(8))

    @pytest.mark.parametrize("order", [0, -2])
    def test_an_order_that_is_not_positive(self, order: int) -> None:
        with pytest.raises(IdentificationError, match="not positive"):
            subspace(self.RECORD, order, all_free(8))

    @pytest.mark.parametrize("rule", [Best(()), Best((40, 50)), Gap(30, 40)])
    def test_a_range_of_orders_without_one_that_can_be_had(self, rule: Best | Gap) -> None:
        with pytest.raises(IdentificationError, match="order"):
            subspace(self.RECORD, rule, all_free(8))

    @pytest.mark.parametrize("weights", [(1.0,), (1.0, 0.0), (1.0, np.nan)])
    def test_weights_that_do_not_fit(self, weights: tuple[float, ...]) -> None:
        with pytest.raises(IdentificationError, match="for 2 outputs; give each output a positive one"):
            subspace(self.RECORD, 3, all_free(8, weights=weights))

    @pytest.mark.parametrize("change", [{"block": 1}, {"block": 8, "weighting": "moesp", "past": 0}])
    def test_block_sizes_that_make_no_sense(self, change: dict[str, int]) -> None:
        with pytest.raises(IdentificationError, match="use at least"):
            all_free(**change)  # type: ignore[arg-type]
