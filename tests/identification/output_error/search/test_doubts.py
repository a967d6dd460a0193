"""What a reader of estimates is warned of."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from fmus.errors import FmuError, InputError
from identification.calibrate import calibrate
from identification.estimation.parameters import Parameter, ParameterSet
from identification.output_error.search.doubts import parameter_warnings
from identification.output_error.search.estimator import estimate
from identification.output_error.search.problem import Problem, Window
from tests.support.identification.closed_form import Oscillator
from tests.support.identification.decays import TIGHT, decays
from tests.support.simulation.ssps import gain


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


@pytest.mark.parametrize("value", [0.4, -0.4])
@pytest.mark.parametrize(
    ("share", "warned"), [(0.34, False), (0.99, False), (1.01, True), (3.0, True), (np.inf, False)]
)
def test_an_estimate_is_hardly_determined_when_its_standard_deviation_exceeds_its_size(value, share, warned):
    """An infinite deviation is told by what is not seen at all."""
    told = parameter_warnings(Parameter("rig.gain", 1.0), value, share * abs(value))
    assert any("rig.gain is hardly determined" in warning for warning in told) == warned


@pytest.mark.parametrize("count", [4, 20])
def test_windows_that_are_there_twice_leave_intervals_as_wide_and_that_is_told(count):
    """Of four windows noise is white by a model, of twenty it would be judged by windows were it not white."""
    once = decays(count, noise=0.02, seed=5)
    states = tuple(replace(state, start=state.start * 2) for state in once.initial_states)
    twice = replace(once, windows=once.windows * 2, initial_states=states, counted=2.0)
    alone, both = (estimate(problem, Oscillator, TIGHT) for problem in (once, twice))
    for name in once.parameters.names:
        assert both.values[name] == pytest.approx(alone.values[name], rel=1e-4)
        assert both.std[name] == pytest.approx(alone.std[name], rel=0.02)
        assert np.diff(both.ci95[name]) == pytest.approx(np.diff(alone.ci95[name]), rel=0.02)
    told = "windows overlap, a sample is in 2 of them on average: intervals are 1.4 times as wide"
    assert any(warning.startswith(told) for warning in both.warnings)
    assert not any("overlap" in warning for warning in alone.warnings)


def gain_study(folder: Path, sign: int, parameter: str, **block: Any) -> Path:
    """A study of y = k u + b, recorded with k = 3 and y of this sign."""
    time = np.arange(0, 6, 0.01)
    table = np.column_stack((time, np.sin(time), sign * 3 * np.sin(time)))
    np.savetxt(folder / "run.csv", table, delimiter=",", header="time,u,y", comments="")
    document = {
        "title": "a gain",
        "method": "output-error",
        "components": {"g": {"fmu": str(gain())}},
        "step": 0.01,
        "traces": {"files": "run.csv"},
        "inputs": {"g.u": {"signal": "u"}},
        "outputs": {"g.y": {"signal": "y"}},
        "windows": {"length": 2},
        "parameters": {parameter: {"min": 0.1, "max": 10, **block}},
    }
    (folder / "study.yaml").write_text(json.dumps(document))
    return folder / "study.yaml"


@pytest.mark.usefixtures("in_this_process")
@pytest.mark.parametrize(("sign", "told"), [(1, False), (-1, True)])
def test_a_signal_of_the_other_sign_is_told_as_one_that_its_mean_follows_better(
    tmp_path: Path, sign: int, told: bool
) -> None:
    warnings = calibrate(gain_study(tmp_path, sign, "g.k", start=1)).summary["warnings"]
    assert any("g.y is followed less well than by its own mean (FIT -" in line for line in warnings) is told


@pytest.mark.parametrize(("name", "kind"), [("n", "an Integer"), ("on", "a Boolean"), ("mode", "an Enumeration")])
def test_what_is_no_real_number_is_not_estimated(tmp_path: Path, name: str, kind: str) -> None:
    said = rf"parameters\.g\.{name}: is {kind}, and what is estimated is a real number; give its component a value"
    with pytest.raises(InputError, match=said):
        calibrate(gain_study(tmp_path, 1, f"g.{name}", start=1))


class Parabola:
    """Two terms that partly make up for each other."""

    time = np.linspace(0, 1, 201)

    def simulate(self, window, values):
        return (values["m.line"] * self.time + values["m.square"] * self.time**2)[:, None]

    def close(self):
        return None


def bounded(most, seed):
    """Of both terms truth is 1, and one may be `most`."""
    measured = Parabola().simulate(0, {"m.line": 1.0, "m.square": 1.0})
    measured = measured + np.random.default_rng(seed).normal(0, 0.05, measured.shape)
    free = ParameterSet((Parameter("m.line", 0.5), Parameter("m.square", 0.5, upper=most)))
    return estimate(Problem(free, (Window("w", "t", measured, np.full(1, 20.0)),), ("m.y",)), Parabola)


def test_a_bound_that_the_recordings_contradict_is_told_with_what_it_does_to_others():
    """By where the fit without the bound is: intervals hold the truth where it is at the bound, and not beyond."""
    found, free = bounded(0.7, 0), bounded(np.inf, 0)
    [line] = [warning for warning in found.warnings if "slopes lead beyond" in warning]
    beyond = (free.values["m.square"] - 0.7) / found.std["m.square"]
    off = (found.values["m.line"] - free.values["m.line"]) / found.std["m.line"]
    assert f"m.square by {beyond:.2g}; if these bounds are wrong, m.line is off by {off:.2g} of its own" in line
    assert not any("slopes lead" in warning for warning in free.warnings)


def test_a_truth_at_its_bound_is_hardly_ever_said_to_lie_beyond_and_intervals_hold():
    found = [bounded(1.0, seed) for seed in range(60)]
    assert sum("slopes lead" in warning for one in found for warning in one.warnings) <= stats.binom.ppf(
        0.999, len(found), stats.norm.sf(2)
    )
    for name in ("m.line", "m.square"):
        held = sum(low <= 1.0 <= high for low, high in (one.ci95[name] for one in found))
        assert held >= stats.binom.ppf(1e-3, len(found), 0.95)


class Alike:
    """Two terms of length 1 that share a part of what they do."""

    def __init__(self, shared):
        first, second = np.linalg.qr(np.random.default_rng(3).normal(size=(200, 2)))[0].T
        self.columns = np.column_stack((first, shared * first + np.sqrt(1 - shared**2) * second))

    def simulate(self, window, values):
        return self.columns @ [[values["m.one"]], [values["m.other"]]]

    def close(self):
        return None


@pytest.mark.parametrize(("shared", "told"), [(0.1, False), (0.25, True)])
def test_a_bound_is_told_from_half_a_standard_deviation_on_by_which_it_moves_another(shared, told):
    """Four beyond the bound move what shares a tenth by 0.4 and what shares a quarter by 1."""
    simulator = Alike(shared)
    measured = simulator.simulate(0, {"m.one": 1.0, "m.other": 1.0})
    measured = measured + np.random.default_rng(0).normal(0, 0.05, measured.shape)

    def found(most):
        free = ParameterSet((Parameter("m.one", 0.5), Parameter("m.other", 0.5, upper=most)))
        return estimate(Problem(free, (Window("w", "t", measured, np.full(1, 20.0)),), ("m.y",)), lambda: simulator)

    free = found(np.inf)
    held = found(free.values["m.other"] - 4 * free.std["m.other"])
    assert any("slopes lead beyond" in warning for warning in held.warnings) == told
