"""Where a search begins: declared, spread over the bounds, and followed on a few windows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fmus.errors import FmuError, IdentificationError
from identification.estimation.parameters import Parameter
from identification.output_error.search.estimator import estimate
from identification.output_error.search.options import SearchOptions
from tests.support.identification.closed_form import Oscillator
from tests.support.identification.decays import PARAMETERS, TRUE, decays


def test_a_start_that_cannot_be_simulated_is_an_error_with_the_reason():
    with pytest.raises(FmuError, match=r"start: cannot be simulated: rig: stiffness 7 is beyond"):
        estimate(decays(), lambda: Oscillator(fails_above=5.0))


def test_several_starts_escape_a_local_optimum():
    far = (Parameter("rig.damping", 0.3, 0.1, 0.5), Parameter("rig.stiffness", 80.0, 1.0, 150.0))
    problem = decays(noise=0.01, parameters=far, free=False, error=0.0)
    one = estimate(problem, Oscillator)
    many = estimate(problem, Oscillator, SearchOptions(starts=12, seed=1))
    assert abs(one.values["rig.stiffness"] - 9.0) > 5.0
    assert many.values["rig.stiffness"] == pytest.approx(9.0, rel=1e-2)
    assert len(many.starts) == 12
    assert many.starts[0].values["rig.stiffness"] == pytest.approx(80.0)
    assert all(report.cost <= report.start_cost for report in many.starts)
    again = estimate(problem, Oscillator, SearchOptions(starts=12, seed=1))
    assert again.values == many.values


def test_a_start_vector_that_fails_does_not_stop_the_others():
    parameters = (PARAMETERS[0], Parameter("rig.stiffness", 7.0, 5.0, 100.0))
    result = estimate(decays(parameters=parameters), lambda: Oscillator(fails_above=30.0), SearchOptions(starts=6))
    failed = [report for report in result.starts if math.isinf(report.cost)]
    assert 0 < len(failed) < 6
    assert all(report.values["rig.stiffness"] > 30 for report in failed)
    assert result.values["rig.stiffness"] == pytest.approx(9.0, rel=1e-6)


@pytest.mark.parametrize("bounds", [{}, {"lower": 0.0}, {"upper": 2.0}])
def test_several_starts_need_bounds(bounds):
    damping = Parameter("rig.damping", 0.2, **bounds)
    with pytest.raises(IdentificationError, match=r"rig\.damping: has an open bound"):
        estimate(decays(parameters=(damping, PARAMETERS[1])), Oscillator, SearchOptions(starts=2))


def test_starts_after_the_declared_one_share_the_bounds_evenly():
    """One in each fifth of either range: of the value on a linear scale, of its logarithm on the other."""
    result = estimate(decays(count=2), Oscillator, SearchOptions(starts=6, start_iterations=1))
    damping, stiffness = ([start.values[name] for start in result.starts[1:]] for name in TRUE)
    assert sorted(np.floor(5 * np.array(damping) / 2.0)) == [0, 1, 2, 3, 4]
    assert sorted(np.floor(5 * np.log(stiffness) / np.log(100.0))) == [0, 1, 2, 3, 4]


def test_a_start_is_followed_on_windows_from_the_first_to_the_last():
    simulated = []

    class Watched(Oscillator):
        def simulate(self, window, values):
            simulated.append(window)
            return super().simulate(window, values)

    estimate(decays(count=9), Watched, SearchOptions(start_windows=3, start_iterations=1))
    assert simulated[:3] == [0, 4, 8]


def test_many_windows_begin_from_what_a_few_of_them_say():
    problem, simulator = decays(count=40, noise=0.02), Oscillator()
    result = estimate(problem, lambda: simulator, SearchOptions(start_windows=5))
    direct = estimate(problem, Oscillator, SearchOptions(start_windows=20))
    assert len(result.starts) == 1 and not direct.starts
    assert result.iterations < direct.iterations
    assert [result.values[k] for k in TRUE] == pytest.approx([direct.values[k] for k in TRUE], rel=1e-4)
    assert result.tally.simulations == simulator.runs
