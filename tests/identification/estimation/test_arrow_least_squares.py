"""The search for a minimum: which points it takes, and what robust losses make of outliers."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np
import pytest
from scipy.optimize import least_squares, lsq_linear

from fmus.errors import IdentificationError
from identification.estimation.arrow_least_squares import (
    ArrowModel,
    Box,
    Loss,
    LossKind,
    Minimum,
    Point,
    SearchLimits,
    WindowBlock,
    evaluated,
    minimise,
)
from orchestrator.trace import FloatArray


@dataclass
class Bent:
    """One residual of one parameter, 1 - x - bend x^2: the linear model promises a residual of 0 at x = 1."""

    bend: float
    tried: list[float] = field(default_factory=list)

    def residuals(self, point: Point) -> list[FloatArray] | None:
        (x,) = point.parameters
        self.tried.append(float(x))
        return [np.array([1 - x - self.bend * x**2])]

    def linearise(self, point: Point, residuals: list[FloatArray]) -> list[WindowBlock]:
        (x,) = point.parameters
        return [WindowBlock(residuals[0], np.array([[-1 - 2 * self.bend * x]]), np.zeros((1, 0)))]


def at(x: float) -> Point:
    return Point(np.array([x]), np.zeros((1, 0)))


def search(system: Bent, limits: SearchLimits, largest: float = 10.0) -> Minimum:
    start = evaluated(system, at(0.0), Loss())
    assert start is not None
    box = Box(at(-10.0), at(largest))
    return minimise(system, start, box, Loss(), limits=limits, report=lambda iteration, there: None)


def one_step(system: Bent) -> Minimum:
    return search(system, SearchLimits(iterations=1))


@pytest.mark.parametrize("share", [0.1, 0.01, 0.001])
def test_a_point_that_is_better_by_little_of_what_was_promised_is_taken_at_once(share: float) -> None:
    """Any real fall of the cost counts: shorter steps would cost a free run each, and reach less far."""
    system = Bent(bend=float(np.sqrt(1 - share)))
    found = one_step(system)
    assert len(system.tried) == 2
    assert found.at.point.parameters == pytest.approx([1.0], abs=2e-3)


def test_a_point_that_is_worse_is_not_taken() -> None:
    found = one_step(Bent(bend=1.5))
    assert found.at.cost < 0.5 and found.at.point.parameters[0] < 0.9


@pytest.mark.parametrize(("bend", "damping"), [(0.4, 1e-4), (0.7, 1e-3), (0.95, 3e-3)])
def test_damping_falls_after_a_step_that_keeps_its_promise_and_grows_after_one_that_hardly_does(
    bend: float, damping: float
) -> None:
    """Gains of 0.84, 0.51 and 0.10 of what was promised; the next step tells the damping it was made with."""
    system = Bent(bend)
    search(system, SearchLimits(iterations=2))
    start, first, second = system.tried[:3]
    assert first - start == pytest.approx(1 / (1 + 1e-3), rel=1e-12)
    undamped = (1 - first - bend * first**2) / (1 + 2 * bend * first)
    assert undamped / (second - first) - 1 == pytest.approx(damping, rel=1e-6)


def test_a_search_ends_at_the_minimum_within_the_bounds() -> None:
    root = (np.sqrt(1 + 4 * 0.3) - 1) / 0.6
    free, held = search(Bent(0.3), SearchLimits()), search(Bent(0.3), SearchLimits(), largest=0.5)
    assert free.converged and free.at.point.parameters == pytest.approx([root], rel=1e-7)
    assert held.converged and held.at.point.parameters == [0.5]


def test_no_step_goes_further_than_its_reach_and_the_search_still_ends_at_the_minimum() -> None:
    system, start = Bent(0.3), evaluated(Bent(0.3), at(-3.0), Loss())
    assert start is not None
    box = Box(at(-10.0), at(10.0), reach=np.array([0.4]))
    found = minimise(system, start, box, Loss(), limits=SearchLimits(), report=lambda *step: None)
    steps = np.diff([-3.0, *system.tried])
    assert found.converged and abs(1 - found.at.point.parameters[0] - 0.3 * found.at.point.parameters[0] ** 2) < 1e-7
    assert np.max(np.abs(steps)) <= 0.4 + 1e-12 and abs(steps[0]) == pytest.approx(0.4)


@pytest.mark.parametrize(
    ("bend", "limits", "end"),
    [
        (0.7, SearchLimits(), "steps have become negligible"),
        (0.95, SearchLimits(cost=0.5), "the cost no longer falls"),
    ],
)
def test_every_step_is_reported_with_its_number_and_a_lower_cost(bend: float, limits: SearchLimits, end: str) -> None:
    system, told = Bent(bend), []
    start = evaluated(system, at(0.0), Loss())
    assert start is not None
    found = minimise(
        system, start, Box(at(-9.0), at(9.0)), Loss(), limits=limits, report=lambda *step: told.append(step)
    )
    assert found.converged and found.message == end
    numbers, costs = [number for number, _ in told], [start.cost, *(there.cost for _, there in told)]
    assert numbers == list(range(1, found.iterations + 1))
    assert costs == sorted(costs, reverse=True) and costs[-1] == found.at.cost


def test_a_search_that_is_cut_short_says_so() -> None:
    cut, spent = (
        search(Bent(0.7), SearchLimits(iterations=2)),
        search(hopeless := Bent(1.5), SearchLimits(evaluations=3)),
    )
    assert (cut.converged, cut.iterations, cut.message) == (False, 2, "stopped after 2 iterations")
    assert (spent.converged, spent.iterations, spent.message) == (False, 0, "stopped: no evaluations left")
    assert spent.at.point.parameters == [0.0] and len(hopeless.tried) == 1 + 3


@dataclass
class Rough:
    """Forty noisy residuals at the minimum of their cost but for a slope that promises `share` of it.

    Wherever else the cost is looked at it is higher, or cannot be had: in steps of a friction or a play it is so.
    """

    share: float
    fails: bool = False

    def residuals(self, point: Point) -> list[FloatArray] | None:
        moved = bool(point.parameters[0])
        if moved and self.fails:
            return None
        return [np.array([1.0, -1.0] * 20) * (1.001 if moved else 1.0)]

    def linearise(self, point: Point, residuals: list[FloatArray]) -> list[WindowBlock]:
        slope = np.sqrt(self.share) * residuals[0] + np.sqrt(1 - self.share) * np.ones(40)
        return [WindowBlock(residuals[0], slope[:, None], np.zeros((40, 0)))]


@pytest.mark.parametrize(
    ("system", "converged", "end"),
    [
        (Rough(0.009), True, "the cost falls no further than its own roughness"),
        (Rough(0.009, fails=True), True, "the cost falls no further than its own roughness"),
        (Rough(0.3), False, "stopped: no better point was found however short the step"),
        (Rough(0.3, fails=True), False, r"stopped: \d+ points ahead could not be simulated"),
    ],
)
def test_a_search_without_a_better_point_is_judged_by_what_is_still_promised(
    system: Rough, converged: bool, end: str
) -> None:
    start = evaluated(system, at(0.0), Loss())
    assert start is not None
    found = minimise(
        system, start, Box(at(-9.0), at(9.0)), Loss(), limits=SearchLimits(cost=1e-5), report=lambda *step: None
    )
    assert found.converged is converged and re.fullmatch(end, found.message)
    promised = 0.0 if "could not" in found.message else system.share
    assert found.promised == pytest.approx(promised, rel=1e-3)


@pytest.mark.parametrize(("tolerance", "tried"), [(0.99, 0), (0.97, 1)])
def test_a_step_is_negligible_by_the_size_of_what_it_changes(tolerance: float, tried: int) -> None:
    """From 100 to 1 it is 99 long, against a tolerance of 101 times the relative one."""
    system, start = Bent(0.0), evaluated(Bent(0.0), at(100.0), Loss())
    assert start is not None
    limits = SearchLimits(iterations=1, step=tolerance)
    box = Box(at(-200.0), at(200.0))
    minimise(system, start, box, Loss(), limits=limits, report=lambda *step: None)
    assert len(system.tried) == tried


def test_states_alone_take_the_step_of_each_window() -> None:
    blocks = blocks_of(9, 12, n=0)
    step = ArrowModel(blocks).step(
        1e-12, everywhere(1.0, 2, n=0), Box(everywhere(-9.0, 2, n=0), everywhere(9.0, 2, n=0))
    )
    wanted = [np.linalg.lstsq(block.states, -block.residual, rcond=None)[0] for block in blocks]
    assert step.parameters.shape == (0,)
    np.testing.assert_allclose(step.states, wanted, rtol=1e-6)


def dense(blocks: list[WindowBlock]) -> tuple[FloatArray, FloatArray]:
    """The whole Jacobian, columns as in `Point.flat`, and the whole residual."""
    windows, s = len(blocks), blocks[0].states.shape[1]
    rows = [
        np.hstack([block.parameters, *(block.states * (w == v) for v in range(windows))])
        for w, block in enumerate(blocks)
    ]
    assert rows[0].shape[1] == blocks[0].parameters.shape[1] + windows * s
    return np.vstack(rows), np.concatenate([block.residual for block in blocks])


def blocks_of(*samples: int, n: int = 3, s: int = 2, seed: int | np.random.Generator = 3) -> list[WindowBlock]:
    rng = np.random.default_rng(seed)
    return [WindowBlock(rng.normal(size=k), rng.normal(size=(k, n)), 0.3 * rng.normal(size=(k, s))) for k in samples]


def everywhere(value: float, windows: int, n: int = 3, s: int = 2) -> Point:
    return Point(np.full(n, value), np.full((windows, s), value))


@pytest.mark.parametrize("samples", [(9, 12, 7), (4, 3, 3)])
@pytest.mark.parametrize("damping", [1e-12, 1e-3, 10.0])
def test_a_step_and_its_promise_are_those_of_the_whole_jacobian(samples: tuple[int, ...], damping: float) -> None:
    blocks = blocks_of(*samples)
    jacobian, residual = dense(blocks)
    model, (n, windows) = ArrowModel(blocks), (3, len(samples))
    scale = Point(np.array([0.5, 1.0, 4.0]), np.arange(1.0, 7.0).reshape(windows, 2))
    step = model.step(damping, scale, Box(everywhere(-1e3, windows), everywhere(1e3, windows)))
    damped = np.vstack([jacobian, np.sqrt(damping) * np.diag(scale.flat)])
    wanted = np.linalg.lstsq(damped, -np.concatenate([residual, np.zeros(len(scale.flat))]), rcond=None)[0]
    np.testing.assert_allclose(step.parameters, wanted[:n], rtol=1e-8)
    np.testing.assert_allclose(step.flat, wanted, rtol=1e-8)
    fall = 0.5 * np.sum(residual**2) - 0.5 * np.sum((residual + jacobian @ wanted) ** 2)
    assert model.reduction(step) == pytest.approx(fall, rel=1e-8)


def test_columns_are_scaled_by_their_length_and_those_without_effect_by_1() -> None:
    blocks = blocks_of(9, 12)
    for block in blocks:
        block.parameters[:, 1] = 0.0
        block.parameters[:, 2] *= 0.01
    blocks[1].states[:, 0] = 0.0
    wanted = np.linalg.norm(dense(blocks)[0], axis=0)
    np.testing.assert_allclose(ArrowModel(blocks).norms().flat, np.where(wanted > 0, wanted, 1.0), rtol=1e-12)


def test_a_bounded_step_is_the_best_one_within_the_bounds_of_the_parameters() -> None:
    blocks = blocks_of(9, 12)
    jacobian, residual = dense(blocks)
    scale, free = Point(np.array([0.5, 1.0, 4.0]), np.ones((2, 2))), Box(everywhere(-9.0, 2), everywhere(9.0, 2))
    unbounded = ArrowModel(blocks).step(1e-12, scale, free)
    limit = 0.5 * np.abs(unbounded.parameters[0])
    lower, upper = everywhere(-9.0, 2), everywhere(9.0, 2)
    lower.parameters[0], upper.parameters[0] = -limit, limit
    step = ArrowModel(blocks).step(1e-12, scale, Box(lower, upper))
    wanted = lsq_linear(jacobian, -residual, bounds=(lower.flat, upper.flat), method="bvls").x
    assert abs(step.parameters[0]) == limit
    np.testing.assert_allclose(step.flat, wanted, rtol=1e-6)


@pytest.mark.parametrize("outward", [True, False])
@pytest.mark.parametrize("side", ["lower", "upper"])
@pytest.mark.parametrize(("window", "state"), [(0, 0), (0, 1), (1, 0), (1, 1)])
def test_a_state_at_its_bound_stays_when_the_cost_falls_outward_only(
    outward: bool, side: str, window: int, state: int
) -> None:
    blocks = blocks_of(9, 12)
    sign = -1.0 if side == "lower" else 1.0
    slope = blocks[window].states[:, state] @ blocks[window].residual
    if (slope * sign < 0) != outward:
        blocks[window].states[:, state] *= -1.0
    room = Box(everywhere(-9.0, 2), everywhere(9.0, 2))
    (room.lower if side == "lower" else room.upper).states[window, state] = 0.0
    step = ArrowModel(blocks).step(1e-12, everywhere(1.0, 2), room)
    jacobian, residual = dense(blocks)
    if outward:
        jacobian[:, 3 + 2 * window + state] = 0.0
    wanted = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
    free = Point(wanted[:3], wanted[3:].reshape(2, 2)).clipped(room)
    np.testing.assert_allclose(step.flat, free.flat, rtol=1e-6, atol=1e-12)


RESIDUALS = np.array([0.0, 0.3, -0.9, 1.1, -4.0, 30.0, 1e4])


@pytest.mark.parametrize("kind", ["linear", "soft_l1", "huber", "cauchy"])
def test_a_scaled_block_has_the_gradient_of_the_loss_and_never_less_than_a_tenth_of_its_weight(kind: LossKind) -> None:
    """An outlier's own curvature vanishes or is negative: without a floor steps would be endless, or lead uphill."""
    loss, slopes = Loss(kind, 0.7), np.linspace(1, 2, len(RESIDUALS))
    scaled = loss.scaled(WindowBlock(RESIDUALS, slopes[:, None], np.zeros((len(RESIDUALS), 0))))
    rows = scaled.parameters[:, 0]
    np.testing.assert_allclose(rows * scaled.residual, slopes * loss.influence(RESIDUALS), rtol=1e-12)
    weight = np.divide(loss.influence(RESIDUALS), RESIDUALS, out=np.ones_like(RESIDUALS), where=RESIDUALS != 0)
    curvature = (rows / slopes) ** 2
    np.testing.assert_allclose(curvature, np.maximum(loss.curvature(RESIDUALS), 0.1 * weight), rtol=1e-12)
    assert np.all(curvature >= 0.1 * weight * (1 - 1e-12)) and np.all(curvature > 0)


@pytest.mark.parametrize("kind", ["linear", "soft_l1", "huber", "cauchy"])
def test_a_loss_is_that_of_scipy(kind: LossKind) -> None:
    found = least_squares(lambda x: RESIDUALS + x, [0.0], loss=kind, f_scale=0.7, max_nfev=1)
    assert Loss(kind, 0.7).cost([RESIDUALS[:3], RESIDUALS[3:]]) == pytest.approx(found.cost, rel=1e-12)


@pytest.mark.parametrize("kind", ["linear", "soft_l1", "huber", "cauchy"])
def test_influence_and_curvature_are_the_derivatives_of_the_loss(kind: LossKind) -> None:
    loss, small = Loss(kind, 0.7), 1e-5
    for r in RESIDUALS[:6]:
        before, after = np.array([r - small]), np.array([r + small])
        slope = (loss.cost([after]) - loss.cost([before])) / (2 * small)
        bend = (loss.influence(after) - loss.influence(before)) / (2 * small)
        assert loss.influence(np.array([r])) == pytest.approx([slope], rel=1e-5, abs=1e-6)
        assert loss.curvature(np.array([r])) == pytest.approx(bend, rel=1e-5, abs=1e-6)


@pytest.mark.parametrize(("kind", "scale"), [("square", 1.0), ("huber", 0.0), ("huber", -1.0), ("huber", np.inf)])
def test_a_loss_that_means_nothing_is_refused(kind: LossKind, scale: float) -> None:
    with pytest.raises(IdentificationError):
        Loss(kind, scale)


def test_steps_stay_in_the_box_and_still_promise_a_reduction() -> None:
    rng = np.random.default_rng(8)
    for _ in range(20):
        model = ArrowModel(blocks_of(20, 20, 20, 20, 20, seed=rng))
        lower = Point(-rng.random(3) * 0.05, -rng.random((5, 2)) * (rng.random((5, 2)) > 0.5))
        room = Box(lower, Point(rng.random(3) * 0.05, rng.random((5, 2))))
        step = model.step(0.1, model.norms(), room)
        assert np.all((step.flat >= room.lower.flat) & (step.flat <= room.upper.flat))
        assert model.reduction(step) > 0
