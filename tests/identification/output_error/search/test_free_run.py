"""The residuals of free runs and their slopes, by brute force, and where runs fail."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from identification.estimation.arrow_least_squares import Point
from tests.support.identification.closed_form import INSTANTS, Oscillator
from tests.support.identification.decays import PARAMETERS, decays, run_over


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
