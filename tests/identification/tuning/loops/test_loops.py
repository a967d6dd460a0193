"""Closed loops: their responses are those of samples taken one by one, delays are exact, noise is what it comes to."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet, delayed
from orchestrator.trace import FloatArray
from tests.support.identification.tuned_loops import WIRING, loops, plant

PI = LinearModel(np.eye(1), np.array([[0.01, -0.01]]), np.eye(1), np.array([[0.3, -0.3]]), 0.01, ("r", "y"), ("u",))


def by_hand(
    model: LinearModel, reference: float, count: int, disturbance: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Outputs and commands of the loop with PI, sample by sample."""
    x, integral, outputs, inputs = np.zeros(model.order), np.zeros(1), [], []
    for _ in range(count):
        y = model.c @ x
        v = np.array([reference, y[0]])
        u = PI.c @ integral + PI.d @ v
        integral = PI.a @ integral + PI.b @ v
        x = model.a @ x + model.b @ (u + disturbance)
        outputs.append(y[0])
        inputs.append(u[0])
    return np.array(outputs), np.array(inputs)


@given(seed=st.integers(0, 1000), count=st.integers(2, 130))
@settings(deadline=None, max_examples=25)
def test_steps_are_those_of_samples_one_by_one(seed: int, count: int) -> None:
    model = plant(seed)
    loop = Loops(PlantSet.of({"plant": model}), ControllerSet.of([PI]), WIRING)
    for response, wanted in (
        (loop.reference_step(2.0, count), by_hand(model, 2.0, count)),
        (loop.disturbance_step(0, 0.5, count), by_hand(model, 0.0, count, 0.5)),
    ):
        assert response.outputs[0, :, 0] == pytest.approx(wanted[0], abs=1e-9)
        assert response.inputs[0, :, 0] == pytest.approx(wanted[1], abs=1e-9)


def test_poles_are_the_zeros_of_one_plus_l() -> None:
    loop = loops(plant(5), 0.9)
    model, gain = plant(5), 0.9
    for pole in loop.poles[0]:
        inner = np.linalg.solve(pole * np.eye(model.order) - model.a, model.b.astype(complex))
        assert abs(1 + gain * (model.c @ inner)[0, 0]) < 1e-8


def test_noise_comes_to_the_command_as_a_long_run_shows() -> None:
    model, gain = plant(2), 0.5
    loop, rng = loops(model, gain), np.random.default_rng(0)
    assert loop.stable[0]
    noise = rng.standard_normal(200_000)
    closed = LinearModel(loop.a[0], -gain * model.b, -gain * model.c, [[-gain]], model.step, ("n",), ("u",))  # type: ignore[arg-type]
    seen = closed.simulate(noise[:, None]).std()
    assert loop.noise_gain(0)[0, 0] == pytest.approx(seen, rel=0.02)


@pytest.mark.parametrize("samples", [0.25, 1.0, 1.6, 3.0])
def test_a_delay_is_exact_between_samples(samples: float) -> None:
    """The double integrator with a lag, whose input moves at the delayed instants in continuous time."""
    rate = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, -3.0]])
    drive, step = np.array([[0.0], [0.0], [3.0]]), 0.02
    block = np.zeros((4, 4))
    block[:3, :3], block[:3, 3:] = rate, drive

    def over(duration: float) -> FloatArray:
        return np.asarray(expm(block * duration))

    whole = over(step)
    model = LinearModel(whole[:3, :3], whole[:3, 3:], np.eye(1, 3), np.zeros((1, 1)), step, ("u",), ("y",))
    late = delayed("plant", model, samples * step, ["u"])
    u = np.random.default_rng(1).standard_normal(40)
    x, found = np.zeros(3), []
    lag, part = divmod(samples * step, step)
    for k in range(40):
        found.append(x[0])
        before, now = (u[i] if i >= 0 else 0.0 for i in (k - int(lag) - 1, k - int(lag)))
        x = (over(part) @ np.append(x, before))[:3]
        x = (over(step - part) @ np.append(x, now))[:3]
    assert late.simulate(u[:, None])[:, 0] == pytest.approx(found, abs=1e-9)


def test_a_plant_that_reacts_at_once_needs_a_delay() -> None:
    model = LinearModel(np.eye(1) * 0.5, np.eye(1), np.eye(1), np.eye(1), 0.01, ("u",), ("y",))
    with pytest.raises(IdentificationError, match="reacts at once"):
        PlantSet.of({"plant": model})
    late = PlantSet.of({"plant": delayed("plant", model, 0.01, ["u"])})
    step = Loops(late, ControllerSet.of([PI]), WIRING).reference_step(1.0, 3)
    assert step.outputs[0, 1, 0] == pytest.approx(step.inputs[0, 0, 0])


def test_plants_that_do_not_fit_together_are_refused() -> None:
    one, other = plant(1), plant(2)
    slower = LinearModel(other.a, other.b, other.c, other.d, 0.02, other.inputs, other.outputs)
    with pytest.raises(IdentificationError, match=r"plants\.b: is sampled every 0\.02 s"):
        PlantSet.of({"a": one, "b": slower})
    renamed = LinearModel(other.a, other.b, other.c, other.d, 0.01, ("v",), other.outputs)
    with pytest.raises(IdentificationError, match=r"plants\.b: has no input 'u'"):
        PlantSet.of({"a": one, "b": renamed})


def test_an_unstable_loop_has_no_noise_gain() -> None:
    assert math.isnan(loops(plant(4), 40.0).noise_gain(0)[0, 0])
