"""Intervals must cover, and what the data cannot see must be named."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter

from identification.estimation.arrow_least_squares import LEAST_SQUARES, Loss, WindowBlock
from identification.estimation.identifiability import identifiability
from identification.estimation.noise import coloured
from identification.estimation.parameters import InitialState, Parameter, ParameterSet
from identification.estimation.uncertainty import covariance, without
from identification.output_error.search.estimator import estimate
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.closed_form import INSTANTS, Oscillator, ServoHand, oscillation

TRUE = {"rig.damping": 0.3, "rig.stiffness": 9.0}
STARTS = np.random.default_rng(0).uniform([0.5, -2.0], [1.5, 2.0], (12, 2))
FREE = (Parameter("rig.damping", 0.28, 0.0, 2.0), Parameter("rig.stiffness", 8.5, 1.0, 100.0, scale="log"))
BENCH = {
    "hand.inertia": 0.01,
    "hand.viscous_friction": 0.02,
    "hand.gravity_torque": 0.1,
    "motor.torque_gain": 0.05,
    "motor.back_emf": 0.1,
}


def noisy_decays(noises, loss=LEAST_SQUARES):
    windows = []
    for i, noise in enumerate(noises):
        values = TRUE | {"rig.angle_start": STARTS[i, 0], "rig.speed_start": STARTS[i, 1]}
        windows.append(Window(str(i), "bench", oscillation(values, INSTANTS) + noise[:, None], np.ones(1)))
    count = len(windows)
    states = tuple(
        InitialState(f"rig.{name}_start", tuple(STARTS[:count, i] + 0.02), estimated=True)
        for i, name in enumerate(("angle", "speed"))
    )
    return Problem(ParameterSet(FREE), tuple(windows), ("angle",), states, loss)


def coverage(draws, make):
    """Share of draws whose intervals hold the true value, for each parameter and for the initial states."""
    inside: dict[str, list[float]] = {name: [] for name in (*TRUE, "rig.angle_start", "rig.speed_start")}
    methods = []
    for _ in range(draws):
        result = estimate(make(), Oscillator)
        methods.append(result.uncertainty.method)
        for name, true in TRUE.items():
            low, high = result.ci95[name]
            inside[name].append(low <= true <= high)
        for i, (name, std) in enumerate(result.initial_std.items()):
            errors = np.abs(result.initial_states[name] - STARTS[: len(std), i])
            inside[name].append(np.mean(errors <= result.uncertainty.quantile * std))
    return {name: float(np.mean(share)) for name, share in inside.items()}, methods


@pytest.mark.slow
def test_intervals_cover_the_truth_in_95_percent_of_draws_with_estimated_initial_states():
    rng = np.random.default_rng(10)
    shares, methods = coverage(200, lambda: noisy_decays(0.05 * rng.normal(size=(3, len(INSTANTS)))))
    assert all(0.92 <= share <= 0.98 for share in shares.values()), shares
    assert methods.count("white") > 190


@pytest.mark.slow
def test_window_intervals_cover_the_truth_when_the_noise_is_correlated():
    rng = np.random.default_rng(11)

    def make():
        return noisy_decays(lfilter([0.02], [1, -0.9], rng.normal(size=(12, 200)))[:, -len(INSTANTS) :])

    shares, methods = coverage(60, make)
    assert set(methods) == {"window"}
    assert all(0.87 <= shares[name] < 1 for name in TRUE), shares
    result = estimate(make(), Oscillator)
    assert np.all(np.diag(result.uncertainty.matrices["window"]) > 4 * np.diag(result.uncertainty.matrices["white"]))


@pytest.mark.slow
def test_intervals_cover_the_truth_under_a_robust_loss_with_outliers():
    rng = np.random.default_rng(12)

    def make():
        noise = 0.05 * rng.normal(size=(3, len(INSTANTS)))
        return noisy_decays(noise * np.where(rng.random(noise.shape) < 0.1, 20, 1), Loss("huber", 0.1))

    shares, _ = coverage(80, make)
    assert all(0.87 <= shares[name] < 1 for name in TRUE), shares


@pytest.mark.slow
def test_correlated_noise_in_few_windows_is_modelled_and_warned_of():
    rng = np.random.default_rng(13)

    def make():
        return noisy_decays(lfilter([0.02], [1, -0.9], rng.normal(size=(4, 200)))[:, -len(INSTANTS) :])

    shares, methods = coverage(80, make)
    assert set(methods) == {"coloured"}
    assert all(share >= 0.86 for share in shares.values()), shares
    result = estimate(make(), Oscillator)
    assert any("4 windows are too few" in warning for warning in result.warnings)
    white, coloured = (np.diag(result.uncertainty.matrices[method]) for method in ("white", "coloured"))
    assert np.all(coloured > 2 * white)


def test_coloured_noise_is_recovered_from_its_residuals():
    rng = np.random.default_rng(14)
    residuals = [lfilter([1], [1, -1.2, 0.5], rng.normal(size=4200))[200:] for _ in range(5)]
    model = coloured(residuals, 1, [np.zeros((4000, 0))] * 5)
    impulse = lfilter([1], [1, -1.2, 0.5], np.eye(1, 400)[0])
    expected = [impulse[: 400 - k] @ impulse[k:] for k in range(40)]
    assert model.autocovariance[0, :40] == pytest.approx(expected, abs=0.06 * expected[0])
    columns = rng.normal(size=(60, 2))
    dense = toeplitz(model.autocovariance[0, :60])
    assert model.times(columns) == pytest.approx(dense @ columns)


def test_coloured_noise_keeps_the_outputs_apart():
    rng = np.random.default_rng(15)
    residual = np.column_stack([lfilter([1], [1, -0.8], rng.normal(size=3000)), 0.1 * rng.normal(size=3000)])
    model = coloured([residual.ravel()], 2, [np.zeros((6000, 0))])
    columns = rng.normal(size=(40, 3))
    for i in range(2):
        expected = toeplitz(model.autocovariance[i, :20]) @ columns[i::2]
        assert model.times(columns)[i::2] == pytest.approx(expected)
    assert model.autocovariance[0, 1] / model.autocovariance[0, 0] == pytest.approx(0.8, abs=0.05)
    assert np.abs(model.autocovariance[1, 1:]).max() < 0.1 * model.autocovariance[1, 0]


def test_silent_residuals_have_no_noise():
    assert not coloured([np.zeros(50)], 1, [np.zeros((50, 0))]).autocovariance.any()


def test_coloured_noise_gets_back_most_of_the_power_that_a_fit_took_away():
    rng = np.random.default_rng(16)
    constant = np.full((40, 1), 1 / np.sqrt(40))
    noises = [lfilter([1], [1, -0.5], rng.normal(size=240))[200:] for _ in range(500)]
    residuals = [e - e.mean() for e in noises]
    restored = coloured(residuals, 1, [constant] * 500).autocovariance[0, 0]
    naive, true = (float(np.mean(np.square(e))) for e in (residuals, noises))
    assert naive < restored < true
    assert true - restored < 0.5 * (true - naive)


def random_blocks(rng, windows=15, samples=30, n=2, s=1):
    return [
        WindowBlock(rng.normal(size=samples), rng.normal(size=(samples, n)), rng.normal(size=(samples, s)))
        for _ in range(windows)
    ]


def test_white_covariance_is_the_textbook_one():
    blocks = random_blocks(np.random.default_rng(1))
    dense = np.zeros((450, 17))
    for w, block in enumerate(blocks):
        dense[30 * w : 30 * w + 30, :2], dense[30 * w : 30 * w + 30, 2 + w : 3 + w] = block.parameters, block.states
    r = np.concatenate([block.residual for block in blocks])
    expected = np.linalg.inv(dense.T @ dense) * (r @ r) / (450 - 17)
    found = covariance(blocks, Loss(), 1)
    assert found.matrices["white"] == pytest.approx(expected[:2, :2])
    assert found.states[:, 0] == pytest.approx(np.sqrt(np.diag(expected)[2:]))
    assert found.freedom == 433 and found.method == "white"


def test_white_covariance_lets_every_output_have_its_own_noise():
    rng = np.random.default_rng(1)
    blocks = random_blocks(rng, windows=4, samples=4000, n=2, s=0)
    sigma = np.tile([0.1, 3.0], 2000)
    blocks = [replace(block, residual=block.residual * sigma) for block in blocks]
    J = np.concatenate([block.parameters for block in blocks])
    H = np.linalg.inv(J.T @ J)
    expected = H @ (J.T * np.tile(sigma, 4) ** 2) @ J @ H
    found = covariance(blocks, Loss(), 2).matrices["white"]
    assert np.diag(found) == pytest.approx(np.diag(expected), rel=0.05)


def test_outliers_alone_leave_a_covariance_although_the_loss_is_concave_there():
    blocks = [replace(b, residual=np.full(30, 5.0)) for b in random_blocks(np.random.default_rng(1), s=0)]
    assert np.all(Loss("cauchy").curvature(blocks[0].residual) < 0)
    assert np.all(np.isfinite(covariance(blocks, Loss("cauchy"), 1).matrices["white"]))


def test_window_covariance_is_the_jackknife_over_windows():
    blocks = random_blocks(np.random.default_rng(2), s=0)
    J, r = np.concatenate([b.parameters for b in blocks]), np.concatenate([b.residual for b in blocks])
    full = np.linalg.lstsq(J, -r, rcond=None)[0]
    # The covariance is taken where the gradient vanishes, so move the residuals there first.
    at_optimum = [replace(b, residual=b.residual + b.parameters @ full) for b in blocks]
    left_out = []
    for w in range(len(blocks)):
        kept = [b for i, b in enumerate(blocks) if i != w]
        rows, target = np.concatenate([b.parameters for b in kept]), np.concatenate([b.residual for b in kept])
        left_out.append(np.linalg.lstsq(rows, -target, rcond=None)[0])
    deviations = np.array(left_out) - np.mean(left_out, axis=0)
    expected = deviations.T @ deviations * (len(blocks) - 1) / len(blocks)
    assert covariance(at_optimum, Loss(), 1).matrices["window"] == pytest.approx(expected)


def test_a_parameter_that_only_one_window_sees_has_no_window_covariance():
    blocks = random_blocks(np.random.default_rng(3), s=0)
    for block in blocks[1:]:
        block.parameters[:, 1] = 0.0
    assert set(covariance(blocks, Loss(), 1).matrices) == {"white", "coloured"}


def bench(free, windows=2, noise=1e-4):
    rng, simulator = np.random.default_rng(4), ServoHand()
    measured = [simulator.simulate(w, BENCH) for w in range(windows)]
    parameters = tuple(Parameter(name, value, fixed=name not in free) for name, value in BENCH.items())
    cut = tuple(
        Window(str(w), "bench", y + noise * rng.normal(size=y.shape), np.ones(1)) for w, y in enumerate(measured)
    )
    return Problem(ParameterSet(parameters), cut, ("angle",))


def test_viscous_friction_and_back_emf_are_named_as_seen_only_in_one_sum():
    free = ("hand.inertia", "hand.viscous_friction", "hand.gravity_torque", "motor.back_emf")
    result = estimate(bench(free), ServoHand)
    (combination,) = result.identifiability.unseen
    assert set(combination.coefficients) == {"hand.viscous_friction", "motor.back_emf"}
    friction, emf = (combination.coefficients[k] for k in ("hand.viscous_friction", "motor.back_emf"))
    assert friction / emf == pytest.approx(-BENCH["motor.torque_gain"], rel=1e-4)
    assert combination.message == (
        "hand.viscous_friction and motor.back_emf: only a sum of them is seen, "
        "hand.viscous_friction + 0.05 * motor.back_emf"
    )
    assert combination.message in result.warnings
    assert result.identifiability.condition > 1e4
    assert math.isinf(result.std["motor.back_emf"]) and math.isinf(result.std["hand.viscous_friction"])
    assert 0 < result.std["hand.inertia"] < 1e-4
    braking = result.values["hand.viscous_friction"] + 0.05 * result.values["motor.back_emf"]
    assert braking == pytest.approx(0.025, rel=1e-2)


def test_without_a_known_scale_only_ratios_are_seen():
    free = ("hand.inertia", "hand.viscous_friction", "hand.gravity_torque", "motor.torque_gain")
    problem = bench(free)
    parameters = tuple(
        replace(p, start=0.0) if p.name == "motor.back_emf" else p for p in problem.parameters.parameters
    )
    result = estimate(replace(problem, parameters=ParameterSet(parameters)), ServoHand)
    (combination,) = result.identifiability.unseen
    assert set(combination.coefficients) == set(free)
    told, _, said = combination.message.partition(": ")
    assert said == "only their ratios are seen"
    assert set(told.replace(" and ", ", ").split(", ")) == set(free)


def test_what_is_determined_is_not_called_unseen():
    result = estimate(bench(("hand.inertia", "hand.viscous_friction", "hand.gravity_torque")), ServoHand)
    assert result.identifiability.unseen == () and result.warnings == ()
    assert result.identifiability.condition < 100
    assert np.diag(result.identifiability.correlation) == pytest.approx(np.ones(3))


def named(jacobian, scales=("linear",) * 3, states=None):
    names = ("a", "b", "c")
    parameters = [Parameter(n, 2.0 + i, scale=s) for i, (n, s) in enumerate(zip(names, scales, strict=True))]
    states = np.zeros((len(jacobian), 0)) if states is None else states
    values = np.array([p.start for p in parameters])
    block = WindowBlock(np.zeros(len(jacobian)), jacobian, states)
    return identifiability([block], parameters, values, np.array([p.slope(0.0) for p in parameters]))


def columns(count):
    return np.random.default_rng(6).normal(size=(50, count))


def test_a_parameter_without_effect_is_named():
    x = columns(2)
    report = named(np.column_stack([x, np.zeros(50)]))
    assert [c.message for c in report.unseen] == ["c has no effect on the outputs"]
    assert math.isinf(report.condition)


def test_a_parameter_that_initial_states_explain_is_named():
    x = columns(4)
    report = named(np.column_stack([x[:, :2], 3 * x[:, 2]]), states=x[:, 2:])
    assert [c.message for c in report.unseen] == ["c cannot be told from the estimated initial states"]


def test_states_that_act_alike_explain_no_more_of_a_parameter_than_one_of_them():
    x = columns(3)
    alike = without(x[:, :2], x[:, 2:] @ [[1.0, -2.0]])
    assert alike == pytest.approx(without(x[:, :2], x[:, 2:]), abs=1e-12)


def test_a_product_on_log_scales_is_named():
    x = columns(2)
    report = named(np.column_stack([x[:, 0], 2 * x[:, 0], x[:, 1]]), scales=("log",) * 3)
    assert [c.message for c in report.unseen] == ["a and b: only a product of them is seen, a * b^2"]


def test_a_difference_is_named():
    x = columns(2)
    # One unit of z is 2 of a and 3 of b: per value a moves the outputs by x / 2, b by -2 x / 3.
    report = named(np.column_stack([x[:, 0], -2 * x[:, 0], x[:, 1]]))
    assert [c.message for c in report.unseen] == ["a and b: only a difference of them is seen, a - 1.33 * b"]


def test_unrelated_combinations_come_apart():
    x = columns(1)
    report = named(np.column_stack([x, 2 * x, np.zeros(50)]))
    assert sorted(len(c.coefficients) for c in report.unseen) == [1, 2]


def test_the_report_does_not_depend_on_the_unit_of_the_outputs():
    J = columns(3)
    J[:, 2] = J[:, 0] + 1e-7 * J[:, 2]
    small, large = named(J * 1e-6), named(J * 1e6)
    assert [c.message for c in small.unseen] == [c.message for c in large.unseen] != []
    assert small.singular_values == pytest.approx(large.singular_values)


@pytest.mark.parametrize(("free", "fewest"), [(2, 10), (8, 13)])
def test_windows_are_judged_by_each_other_where_there_are_ten_and_five_more_than_parameters(free, fewest):
    rng = np.random.default_rng(1)
    blocks = [WindowBlock(rng.normal(size=20), rng.normal(size=(20, free)), np.zeros((20, 0))) for _ in range(fewest)]
    assert "window" in covariance(blocks, Loss(), 1).matrices
    assert "window" not in covariance(blocks[:-1], Loss(), 1).matrices
