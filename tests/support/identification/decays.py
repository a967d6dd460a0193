"""Free decays of an oscillator in closed form, whose damping and stiffness are known."""

from __future__ import annotations

import numpy as np

from identification.estimation.arrow_least_squares import LEAST_SQUARES
from identification.estimation.parameters import InitialState, Parameter, ParameterSet
from identification.estimation.workers import LocalPool
from identification.output_error.search.free_run import FreeRun, Tally
from identification.output_error.search.options import SearchOptions
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.closed_form import INSTANTS, Oscillator, oscillation

TRUE = {"rig.damping": 0.3, "rig.stiffness": 9.0}
PARAMETERS = (Parameter("rig.damping", 0.2, 0.0, 2.0), Parameter("rig.stiffness", 7.0, 1.0, 100.0, scale="log"))
STARTS = np.random.default_rng(0).uniform([0.5, -2.0], [1.5, 2.0], (40, 2))

# For simulators in closed form, exact to the last bits: FMUs deserve the coarser default.
TIGHT = SearchOptions(cost_tolerance=1e-7, step_tolerance=1e-7, difference_step=1e-5)


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
