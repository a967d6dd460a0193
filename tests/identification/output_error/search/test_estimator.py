"""The estimator against systems whose parameters are known, and against brute force."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from fmus.errors import FmuError
from identification.estimation.arrow_least_squares import Loss
from identification.estimation.parameters import Parameter, ParameterSet, Tie
from identification.output_error.search.estimator import estimate, predict
from identification.output_error.search.options import SearchOptions
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.closed_form import INSTANTS, Oscillator, ServoHand, oscillation
from tests.support.identification.decays import PARAMETERS, STARTS, TIGHT, TRUE, decays, run_over


def test_noise_free_windows_give_back_parameters_and_initial_states():
    result = estimate(decays(), Oscillator)
    assert result.converged
    assert {name: result.values[name] for name in TRUE} == pytest.approx(TRUE, rel=1e-7)
    assert result.initial_states["rig.angle_start"] == pytest.approx(STARTS[:4, 0], abs=1e-7)
    assert result.initial_states["rig.speed_start"] == pytest.approx(STARTS[:4, 1], abs=1e-7)
    assert result.fit == pytest.approx(np.ones((4, 1)), abs=1e-6)


def test_the_optimum_is_that_of_scipy_on_the_dense_problem():
    problem = decays(noise=0.05)
    result = estimate(problem, Oscillator, TIGHT)

    def residuals(x):
        rows = []
        for i, window in enumerate(problem.windows):
            names, numbers = (*TRUE, "rig.angle_start", "rig.speed_start"), (*x[:2], *x[2 + 2 * i : 4 + 2 * i])
            values = dict(zip(names, numbers, strict=True))
            rows.append(oscillation(values, INSTANTS) - window.measured)
        return np.concatenate(rows).ravel()

    dense = least_squares(residuals, [0.2, 7.0, *STARTS[:4].ravel()], xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert result.cost == pytest.approx(dense.cost, rel=1e-9)
    assert [result.values[name] for name in TRUE] == pytest.approx(dense.x[:2], rel=1e-5)
    covariance = np.linalg.inv(dense.jac.T @ dense.jac)[:2, :2] * 2 * dense.cost / (len(dense.fun) - 10)
    assert result.covariance == pytest.approx(covariance, rel=1e-4)
    assert result.initial_states["rig.speed_start"] == pytest.approx(dense.x[3::2], rel=1e-4)


def test_bounds_are_respected_and_an_active_one_is_reported():
    tried = []

    class Watched(Oscillator):
        def simulate(self, window, values):
            tried.append((values["rig.stiffness"], values["rig.angle_start"]))
            return super().simulate(window, values)

    problem = decays(noise=0.01, parameters=(PARAMETERS[0], Parameter("rig.stiffness", 7.0, 6.5, 8.0)))
    angle = replace(problem.initial_states[0], upper=float(STARTS[:4, 0].max()) + 0.1)
    result = estimate(replace(problem, initial_states=(angle, problem.initial_states[1])), Watched)
    stiffness, angles = np.array(tried).T
    assert stiffness.min() >= 6.5 and stiffness.max() <= 8.0 and angles.max() <= angle.upper
    assert result.values["rig.stiffness"] == 8.0
    assert result.converged
    assert any("rig.stiffness is at its upper bound 8" in warning for warning in result.warnings)


def test_the_bounded_optimum_is_that_of_scipy():
    parameters = (PARAMETERS[0], Parameter("rig.stiffness", 7.0, 6.5, 8.0))
    problem = decays(noise=0.01, parameters=parameters, free=False, error=0.0)
    result = estimate(problem, Oscillator, TIGHT)

    def residuals(x):
        rows = []
        for window, (x0, v0) in zip(problem.windows, STARTS, strict=False):
            values = dict(zip(TRUE, x, strict=True)) | {"rig.angle_start": x0, "rig.speed_start": v0}
            rows.append(oscillation(values, INSTANTS) - window.measured)
        return np.concatenate(rows).ravel()

    dense = least_squares(residuals, [0.2, 7.0], bounds=([0, 6.5], [2, 8]), xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert result.cost == pytest.approx(dense.cost, rel=1e-6)
    assert result.values["rig.damping"] == pytest.approx(dense.x[0], rel=1e-4)


def test_fixed_and_tied_parameters_are_simulated_as_declared():
    parameters = (Parameter("rig.damping", 0.25), Parameter("rig.gain", 1.0, fixed=True))
    result = estimate(decays(parameters=parameters, ties=(Tie("rig.stiffness", "rig.damping", 30.0),)), Oscillator)
    assert result.values == pytest.approx({"rig.damping": 0.3, "rig.gain": 1.0, "rig.stiffness": 9.0}, rel=1e-6)
    assert result.free == ("rig.damping",)
    assert result.std["rig.stiffness"] == pytest.approx(30 * result.std["rig.damping"])
    low, high = result.ci95["rig.damping"]
    assert result.ci95["rig.stiffness"] == pytest.approx((30 * low, 30 * high))
    assert "rig.gain" not in result.std


def test_failing_simulations_are_counted_and_survived():
    def factory():
        return Oscillator(fails_above=9.5)

    problem = decays(noise=0.02, parameters=(PARAMETERS[0], Parameter("rig.stiffness", 4.0, 1.0, 100.0)))
    result = estimate(problem, factory, TIGHT)
    undisturbed = estimate(problem, Oscillator, TIGHT)
    assert result.tally.failures > 0 == undisturbed.tally.failures
    assert result.tally.reasons[0].startswith("rig: stiffness")
    assert result.converged
    assert [result.values[k] for k in TRUE] == pytest.approx([undisturbed.values[k] for k in TRUE], rel=1e-5)
    assert any("simulations failed, first: rig: stiffness" in warning for warning in result.warnings)


def test_the_simulator_is_closed_whatever_happens():
    simulators = [Oscillator(), Oscillator(fails_above=5.0)]
    estimate(decays(), lambda: simulators[0])
    with pytest.raises(FmuError):
        estimate(decays(), lambda: simulators[1])
    assert all(simulator.closed for simulator in simulators)


@pytest.mark.parametrize("kind", ["soft_l1", "huber", "cauchy"])
def test_a_robust_loss_resists_outliers(kind):
    def spoiled(loss):
        problem = decays(count=6, noise=0.02, loss=loss)
        rng = np.random.default_rng(9)
        windows = []
        for window in problem.windows:
            measured = window.measured.copy()
            measured[rng.choice(len(INSTANTS), 8, replace=False)] += 2.0
            windows.append(replace(window, measured=measured))
        return replace(problem, windows=tuple(windows))

    robust = estimate(spoiled(Loss(kind, 0.05)), Oscillator)
    plain = estimate(spoiled(Loss()), Oscillator)
    error = abs(robust.values["rig.damping"] - 0.3)
    assert robust.converged
    assert error < 4 * robust.std["rig.damping"] < 0.02
    assert error < 0.25 * abs(plain.values["rig.damping"] - 0.3)


class Interrupted(Oscillator):
    """Somebody presses Ctrl-C in the run of this number."""

    def __init__(self, run):
        super().__init__()
        self.last = run

    def simulate(self, window, values):
        if self.runs >= self.last:
            raise KeyboardInterrupt
        return super().simulate(window, values)


def test_an_interrupted_estimation_carries_the_best_point_so_far_and_no_intervals():
    problem, whole = decays(noise=0.02), estimate(decays(noise=0.02), Oscillator)
    with pytest.raises(KeyboardInterrupt) as caught:
        estimate(problem, lambda: Interrupted(60))
    found = caught.value.result
    assert not found.converged and found.message == "stopped: interrupted" and 0 < found.iterations < whole.iterations
    assert whole.cost < found.cost < 0.5 * float(np.sum(run_over(problem).residuals(problem.start(range(4)))[0] ** 2))
    assert all(math.isinf(std) for std in found.std.values()) and found.fit.shape == whole.fit.shape
    predicted = predict(replace(problem, initial_states=problem.initial_states).fixed_at(found.values), Oscillator)
    assert np.median(predicted.fit) >= np.median(found.fit) - 1e-6


def test_an_estimation_that_is_interrupted_before_its_first_step_has_nothing_to_carry():
    with pytest.raises(KeyboardInterrupt) as caught:
        estimate(decays(), lambda: Interrupted(6))
    assert not hasattr(caught.value, "result")


def test_a_rough_cost_is_followed_by_coarser_differences():
    """Outputs in steps, as a coarse converter gives them: fine differences see the steps, not the slope."""

    class Stepped(Oscillator):
        def simulate(self, window, values):
            return np.round(super().simulate(window, values), 4)

    found = estimate(decays(), Stepped, SearchOptions(difference_step=1e-5))
    assert [found.values[name] for name in TRUE] == pytest.approx(list(TRUE.values()), rel=5e-3)
    assert np.all(found.fit > 0.999)


def test_the_result_does_not_depend_on_the_number_of_processes():
    problem = decays(count=3, noise=0.05)
    here, there = (estimate(problem, Oscillator, SearchOptions(processes=n)) for n in (1, 2))
    assert here.values == there.values and here.std == there.std and here.ci95 == there.ci95
    assert all(np.array_equal(a, b) for a, b in zip(here.simulated, there.simulated, strict=True))
    assert here.tally == there.tally


def test_progress_is_told_with_a_falling_cost():
    told = []
    result = estimate(decays(noise=0.05), Oscillator, watch=told.append)
    costs = [step.cost for step in told]
    assert costs == sorted(costs, reverse=True)
    assert [step.stage for step in told] == ["fit"] * result.iterations + ["uncertainty"]


def test_running_out_of_evaluations_is_said():
    result = estimate(decays(noise=0.05), Oscillator, SearchOptions(max_evaluations=1))
    assert not result.converged
    assert result.message.startswith("stopped")


def test_residuals_and_simulated_outputs_are_in_the_units_of_the_outputs():
    problem = decays(noise=0.05)
    weighted = tuple(replace(window, weight=np.array([20.0])) for window in problem.windows)
    plain, scaled = estimate(problem, Oscillator), estimate(replace(problem, windows=weighted), Oscillator)
    assert scaled.cost == pytest.approx(400 * plain.cost, rel=1e-6)
    for window, simulated, residual in zip(problem.windows, scaled.simulated, scaled.residuals, strict=True):
        assert residual == pytest.approx(window.measured - simulated)
        assert np.std(residual) == pytest.approx(0.05, rel=0.3)
    assert scaled.std["rig.damping"] == pytest.approx(plain.std["rig.damping"], rel=1e-4)


def test_prediction_of_unseen_windows_fits_only_their_initial_states():
    known = estimate(decays(noise=0.02), Oscillator)
    unseen = decays(count=6, noise=0.02, seed=1)
    guessed = predict(unseen.fixed_at(known.values), Oscillator)
    wrong = predict(unseen.fixed_at(known.values | {"rig.stiffness": 7.0}), Oscillator)
    assert guessed.initial_states["rig.angle_start"] == pytest.approx(STARTS[:6, 0], abs=0.05)
    assert np.all(guessed.fit > 0.9) and np.median(wrong.fit) < 0.8
    measured = predict(replace(unseen, initial_states=decays(6, free=False).initial_states), Oscillator)
    assert measured.initial_states["rig.angle_start"] == pytest.approx(STARTS[:6, 0] + 0.1)
    with pytest.raises(FmuError, match="a window cannot be simulated: rig: stiffness"):
        predict(unseen, lambda: Oscillator(fails_above=5.0))


def test_initial_states_alone_can_be_estimated():
    fixed = tuple(replace(p, start=TRUE[p.name], fixed=True) for p in PARAMETERS)
    result = estimate(decays(noise=0.02, parameters=fixed), Oscillator)
    assert result.initial_states["rig.speed_start"] == pytest.approx(STARTS[:4, 1], abs=0.1)
    assert result.free == () and result.std == {} and result.converged


def test_a_nonlinear_plant_gives_back_its_parameters():
    true = {"hand.inertia": 0.01, "hand.viscous_friction": 0.02, "hand.gravity_torque": 0.1}
    others = (Parameter("motor.torque_gain", 0.05, fixed=True), Parameter("motor.back_emf", 0.1, fixed=True))
    simulator = ServoHand()
    fixed = {p.name: p.start for p in others}
    windows = tuple(Window(str(w), "bench", simulator.simulate(w, true | fixed), np.ones(1)) for w in range(2))
    begin = tuple(Parameter(name, 2.0 * value, 0.0, 1.0) for name, value in true.items())
    result = estimate(Problem(ParameterSet(begin + others), windows, ("angle",)), ServoHand)
    assert {name: result.values[name] for name in true} == pytest.approx(true, rel=1e-6)
