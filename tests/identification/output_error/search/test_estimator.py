"""The estimator against systems whose parameters are known, and against brute force."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import least_squares

from fmus.errors import FmuError, IdentificationError
from identification.estimation.arrow_least_squares import LEAST_SQUARES, ArrowModel, Box, Loss, Point, WindowBlock
from identification.estimation.workers import LocalPool
from identification.output_error.search.doubts import parameter_warnings
from identification.output_error.search.estimator import (
    InitialState,
    Options,
    Parameter,
    ParameterSet,
    Problem,
    Tie,
    Window,
    estimate,
    predict,
    spread_weights,
)
from identification.output_error.search.free_run import FreeRun, Tally
from tests.support.identification.closed_form import INSTANTS, Oscillator, ServoHand, oscillation

TRUE = {"rig.damping": 0.3, "rig.stiffness": 9.0}
PARAMETERS = (Parameter("rig.damping", 0.2, 0.0, 2.0), Parameter("rig.stiffness", 7.0, 1.0, 100.0, scale="log"))
STARTS = np.random.default_rng(0).uniform([0.5, -2.0], [1.5, 2.0], (40, 2))

# For simulators in closed form, exact to the last bits: FMUs deserve the coarser default.
TIGHT = Options(cost_tolerance=1e-7, step_tolerance=1e-7, difference_step=1e-5)


def decays(count=4, noise=0.0, seed=0, parameters=PARAMETERS, ties=(), loss=LEAST_SQUARES, free=True, error=0.1):
    """A problem over `count` free decays; the declared initial states are off by `error`."""
    rng, windows = np.random.default_rng(seed), []
    for i, (x0, v0) in enumerate(STARTS[:count]):
        y = oscillation(TRUE | {"rig.angle_start": x0, "rig.speed_start": v0}, INSTANTS)
        windows.append(Window(f"decay {i}", "bench", y + noise * rng.normal(size=y.shape), np.ones(1)))
    states = tuple(
        InitialState(f"rig.{name}_start", tuple(STARTS[:count, i] + error), estimated=free)
        for i, name in enumerate(("angle", "speed"))
    )
    return Problem(ParameterSet(parameters, ties), tuple(windows), ("angle",), states, loss)


def run_over(problem, simulator=None):
    windows = tuple(range(len(problem.windows)))
    return FreeRun(problem, LocalPool(lambda: simulator or Oscillator()), Tally(), windows, 1e-5)


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


@pytest.mark.parametrize("central", [False, True])
def test_the_structured_jacobian_is_the_brute_force_one(central):
    problem = decays(count=3, noise=0.02)
    run, point = run_over(problem), problem.start(range(3))
    point = Point(np.array([0.1, -0.2]), np.random.default_rng(1).normal(size=(3, 2)) * 0.1)
    base = run.residuals(point)
    blocks = run.linearise(point, base, central=central)
    h = 1e-6

    def everything(flat):
        return np.concatenate(run.residuals(Point(flat[:2], flat[2:].reshape(3, 2))))

    steps = h * np.eye(8)
    dense = np.column_stack([(everything(point.flat + d) - everything(point.flat - d)) / (2 * h) for d in steps])
    structured, size = np.zeros_like(dense), len(INSTANTS)
    for w, block in enumerate(blocks):
        rows = slice(w * size, (w + 1) * size)
        structured[rows, :2], structured[rows, 2 + 2 * w : 4 + 2 * w] = block.parameters, block.states
    assert structured == pytest.approx(dense, abs=1e-5 if central else 2e-4)


def test_a_jacobian_costs_one_window_pass_for_each_unknown_of_one_window():
    problem, simulator = decays(count=20), Oscillator()
    run = run_over(problem, simulator)
    base = run.residuals(problem.start(range(20)))
    run.linearise(problem.start(range(20)), base)
    assert simulator.runs == 20 * (1 + len(PARAMETERS) + 2)
    assert run.tally.simulations == simulator.runs


def random_blocks(rng, windows=5, n=3, s=2):
    return [
        WindowBlock(rng.normal(size=20), rng.normal(size=(20, n)), rng.normal(size=(20, s))) for _ in range(windows)
    ]


def test_an_arrow_step_solves_the_dense_damped_problem():
    blocks = random_blocks(np.random.default_rng(7))
    model, damping = ArrowModel(blocks), 0.3
    scale = model.norms()
    unbounded = Box(
        Point(np.full(3, -np.inf), np.full((5, 2), -np.inf)), Point(np.full(3, np.inf), np.full((5, 2), np.inf))
    )
    step = model.step(damping, scale, unbounded)
    dense = np.zeros((100, 13))
    for w, block in enumerate(blocks):
        dense[20 * w : 20 * w + 20, :3], dense[20 * w : 20 * w + 20, 3 + 2 * w : 5 + 2 * w] = (
            block.parameters,
            block.states,
        )
    r = np.concatenate([block.residual for block in blocks])
    D = np.diag(scale.flat)
    expected = -np.linalg.solve(dense.T @ dense + damping * D @ D, dense.T @ r)
    assert step.flat == pytest.approx(expected)
    assert model.reduction(step) == pytest.approx(0.5 * (r @ r - np.sum((r + dense @ expected) ** 2)))
    assert scale.flat == pytest.approx(np.linalg.norm(dense, axis=0))


def test_steps_stay_in_the_box_and_still_promise_a_reduction():
    rng = np.random.default_rng(8)
    for _ in range(20):
        model = ArrowModel(random_blocks(rng))
        room = Box(
            Point(-rng.random(3) * 0.05, -rng.random((5, 2)) * (rng.random((5, 2)) > 0.5)),
            Point(rng.random(3) * 0.05, rng.random((5, 2))),
        )
        step = model.step(0.1, model.norms(), room)
        assert np.all((step.flat >= room.lower.flat) & (step.flat <= room.upper.flat))
        assert model.reduction(step) > 0


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


@dataclass
class Rough(Oscillator):
    """Answers with nan in a strip of stiffness right above the declared start."""

    def simulate(self, window, values):
        outputs = super().simulate(window, values)
        return outputs * math.nan if 7.0 < values["rig.stiffness"] < 7.001 else outputs


def test_a_perturbed_run_that_fails_is_replaced_by_the_other_side():
    problem = decays(count=2)
    run, smooth = run_over(problem, Rough()), run_over(problem)
    point = problem.start(range(2))
    base = run.residuals(point)
    for rough, block in zip(run.linearise(point, base), smooth.linearise(point, base), strict=True):
        assert rough.parameters == pytest.approx(block.parameters, abs=1e-3)
    assert run.tally.failures == 2
    assert run.tally.reasons == [
        "decay 0: a simulated output is not finite",
        "decay 1: a simulated output is not finite",
    ]


def test_a_start_that_cannot_be_simulated_is_an_error_with_the_reason():
    with pytest.raises(FmuError, match=r"start: cannot be simulated: rig: stiffness 7 is beyond"):
        estimate(decays(), lambda: Oscillator(fails_above=5.0))


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


@pytest.mark.parametrize("kind", ["soft_l1", "huber", "cauchy"])
def test_losses_are_those_of_scipy(kind):
    r = np.array([-3.0, -0.2, 0.0, 0.4, 1.0, 8.0])
    scipy_cost = least_squares(lambda x: r + x, 0.0, loss=kind, f_scale=0.5, max_nfev=1, bounds=(-1e-12, 1e-12)).cost
    loss, h = Loss(kind, 0.5), 1e-6
    assert loss.cost([r]) == pytest.approx(scipy_cost)
    slope = [(loss.cost([ri + h]) - loss.cost([ri - h])) / (2 * h) for ri in r[:, None]]
    assert loss.influence(r) == pytest.approx(slope, abs=1e-6)
    bend = (loss.influence(r + h) - loss.influence(r - h)) / (2 * h)
    assert loss.curvature(r) == pytest.approx(bend, abs=1e-6)


def test_several_starts_escape_a_local_optimum():
    far = (Parameter("rig.damping", 0.3, 0.1, 0.5), Parameter("rig.stiffness", 80.0, 1.0, 150.0))
    problem = decays(noise=0.01, parameters=far, free=False, error=0.0)
    one = estimate(problem, Oscillator)
    many = estimate(problem, Oscillator, Options(starts=12, seed=1))
    assert abs(one.values["rig.stiffness"] - 9.0) > 5.0
    assert many.values["rig.stiffness"] == pytest.approx(9.0, rel=1e-2)
    assert len(many.starts) == 12
    assert many.starts[0].values["rig.stiffness"] == pytest.approx(80.0)
    assert all(report.cost <= report.start_cost for report in many.starts)
    again = estimate(problem, Oscillator, Options(starts=12, seed=1))
    assert again.values == many.values


class Once(Oscillator):
    """Runs with the stiffness it is given first, and with no other."""

    known: float | None = None

    def simulate(self, window, values):
        self.known = self.known or values["rig.stiffness"]
        if values["rig.stiffness"] != self.known:
            raise FmuError("rig", "stiffness is not what it was")
        return super().simulate(window, values)


def test_a_parameter_whose_runs_failed_is_not_said_to_be_without_effect():
    result = estimate(decays(), Once)
    (unseen,) = result.identifiability.unseen
    assert unseen.coefficients.keys() == {"rig.stiffness"}
    assert unseen.message == (
        "rig.stiffness may have an effect or none: every run beside its estimate failed in 4 windows"
    )
    assert not any("no effect" in warning for warning in result.warnings)
    assert any("simulations failed, first: rig: stiffness" in warning for warning in result.warnings)


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

    found = estimate(decays(), Stepped, Options(difference_step=1e-5))
    assert [found.values[name] for name in TRUE] == pytest.approx(list(TRUE.values()), rel=5e-3)
    assert np.all(found.fit > 0.999)


def test_a_start_vector_that_fails_does_not_stop_the_others():
    parameters = (PARAMETERS[0], Parameter("rig.stiffness", 7.0, 5.0, 100.0))
    result = estimate(decays(parameters=parameters), lambda: Oscillator(fails_above=30.0), Options(starts=6))
    failed = [report for report in result.starts if math.isinf(report.cost)]
    assert 0 < len(failed) < 6
    assert all(report.values["rig.stiffness"] > 30 for report in failed)
    assert result.values["rig.stiffness"] == pytest.approx(9.0, rel=1e-6)


@pytest.mark.parametrize("bounds", [{}, {"lower": 0.0}, {"upper": 2.0}])
def test_several_starts_need_bounds(bounds):
    damping = Parameter("rig.damping", 0.2, **bounds)
    with pytest.raises(IdentificationError, match=r"rig\.damping: has an open bound"):
        estimate(decays(parameters=(damping, PARAMETERS[1])), Oscillator, Options(starts=2))


def test_starts_after_the_declared_one_share_the_bounds_evenly():
    """One in each fifth of either range: of the value on a linear scale, of its logarithm on the other."""
    result = estimate(decays(count=2), Oscillator, Options(starts=6, start_iterations=1))
    damping, stiffness = ([start.values[name] for start in result.starts[1:]] for name in TRUE)
    assert sorted(np.floor(5 * np.array(damping) / 2.0)) == [0, 1, 2, 3, 4]
    assert sorted(np.floor(5 * np.log(stiffness) / np.log(100.0))) == [0, 1, 2, 3, 4]


def test_a_start_is_followed_on_windows_from_the_first_to_the_last():
    simulated = []

    class Watched(Oscillator):
        def simulate(self, window, values):
            simulated.append(window)
            return super().simulate(window, values)

    estimate(decays(count=9), Watched, Options(start_windows=3, start_iterations=1))
    assert simulated[:3] == [0, 4, 8]


def test_many_windows_begin_from_what_a_few_of_them_say():
    problem, simulator = decays(count=40, noise=0.02), Oscillator()
    result = estimate(problem, lambda: simulator, Options(start_windows=5))
    direct = estimate(problem, Oscillator, Options(start_windows=20))
    assert len(result.starts) == 1 and not direct.starts
    assert result.iterations < direct.iterations
    assert [result.values[k] for k in TRUE] == pytest.approx([direct.values[k] for k in TRUE], rel=1e-4)
    assert result.tally.simulations == simulator.runs


def test_the_result_does_not_depend_on_the_number_of_processes():
    problem = decays(count=3, noise=0.05)
    here, there = (estimate(problem, Oscillator, Options(processes=n)) for n in (1, 2))
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
    result = estimate(decays(noise=0.05), Oscillator, Options(max_evaluations=1))
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


def test_spread_weights_make_outputs_comparable():
    rng = np.random.default_rng(0)
    weights = spread_weights([rng.normal(size=(500, 2)) * [3.0, 0.1] for _ in range(3)])
    assert weights == pytest.approx([1 / 3.0, 10.0], rel=0.05)
    with pytest.raises(IdentificationError, match="output 1: is constant"):
        spread_weights([np.column_stack([np.arange(5.0), np.ones(5)])])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Window("w", "t", np.array([[1.0], [np.nan]]), np.ones(1)), "w: a measured output is not finite"),
        (lambda: Window("w", "t", np.ones(3), np.ones(1)), r"w: measured has shape \(3,\)"),
        (lambda: Window("w", "t", np.ones((1, 2)), np.ones(2)), r"w: measured has shape \(1, 2\)"),
        (lambda: Window("w", "t", np.ones((3, 1)), np.zeros(1)), "w: a weight is not positive"),
        (lambda: Window("w", "t", np.ones((3, 1)), np.ones(2)), "w: weight has shape"),
        (lambda: replace(decays(), windows=()), "windows: there are none"),
        (lambda: replace(decays(), outputs={"a": "1", "b": "1"}), "decay 0: has 1 measured columns"),
        (lambda: replace(decays(), windows=decays(2).windows), r"rig\.angle_start: has 4 start values for 2"),
        (lambda: replace(decays(), initial_states=(InitialState("rig.damping", (0.0,) * 4),)), "declared twice"),
        (lambda: Loss("l1"), "loss: 'l1' is unknown"),  # type: ignore[arg-type]
        (lambda: Loss("huber", 0.0), "loss: scale 0 is not positive"),
        (lambda: Options(starts=0), "options.starts: 0 is too few"),
        (lambda: Options(difference_step=0.0), "options.difference_step"),
        (lambda: estimate(decays(free=False).fixed_at({}), Oscillator), "parameters: nothing is free"),
    ],
)
def test_a_question_that_makes_no_sense_is_refused_in_one_line(make, message):
    with pytest.raises(IdentificationError, match=message) as caught:
        make()
    assert "\n" not in str(caught.value)


def test_too_few_samples_are_refused():
    window = Window("short", "t", np.ones((2, 1)), np.ones(1))
    with pytest.raises(IdentificationError, match="hold 2 samples for 2 unknowns"):
        Problem(ParameterSet(PARAMETERS), (window,), ("angle",))


def test_outputs_of_the_wrong_shape_are_refused():
    with pytest.raises(IdentificationError, match=r"decay 0: simulated outputs have shape \(9, 1\)"):
        estimate(decays(), lambda: Oscillator(time=INSTANTS[:9]))


@pytest.mark.parametrize("value", [0.4, -0.4])
@pytest.mark.parametrize(
    ("share", "warned"), [(0.34, False), (0.99, False), (1.01, True), (3.0, True), (np.inf, False)]
)
def test_an_estimate_is_hardly_determined_when_its_standard_deviation_exceeds_its_size(value, share, warned):
    """An infinite deviation is told by what is not seen at all."""
    told = parameter_warnings(Parameter("rig.gain", 1.0), value, share * abs(value))
    assert any("rig.gain is hardly determined" in warning for warning in told) == warned
