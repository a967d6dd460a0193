"""How an instance is initialised and stepped: exact holds, start values, snapshots, failures with their reason."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from fmus import library
from fmus.modelling.instance import Instance, StepError
from fmus.modelling.model import Model, Requirement, State, input_, output, parameter

INTEGRATOR = Model(
    name="integrator",
    description="Counts its samples and integrates the last one",
    variables=(
        input_("rate", "1/s", "Input"),
        output("area", "1", "Integral of the sampled rate"),
        output("held", "1/s", "Sampled rate"),
        output("twice", "1", "Twice the area"),
        parameter("period", "s", 0.1, "Sample period"),
        parameter("area_start", "1", 0.0, "Start of the integral"),
    ),
    states=(State("area", "area_start"), State("held", 0.0, sampled=True)),
    derivatives=lambda t, x, u, p: {"area": x.held},
    update=lambda t, x, u, p: {"held": u.rate},
    outputs=lambda t, x, u, p: {"twice": 2 * x.area},
    solver_step=lambda p: 1.0,
    sample_time="period",
)


def oscillator(**functions: Any) -> Model:
    defaults: dict[str, Any] = {
        "derivatives": lambda t, x, u, p: {"a": x.b, "b": u.drive - p.k * x.a - p.d * x.b},
        "solver_step": lambda p: 0.002,
    }
    return Model(
        name="oscillator",
        description="Mass on a spring",
        variables=(
            input_("drive", "1", "Input"),
            output("a", "1", "Output"),
            parameter("k", "1", 4.0, "Stiffness"),
            parameter("d", "1", 0.5, "Damping"),
            parameter("a_start", "1", 1.0, "Start"),
        ),
        states=(State("a", "a_start"), State("b")),
        **(defaults | functions),
    )


@given(k=st.floats(0.5, 20), d=st.floats(0, 2), drive=st.floats(-5, 5), step=st.floats(0.01, 0.5))
def test_a_linear_model_steps_as_the_matrix_exponential_with_its_input_held(
    k: float, d: float, drive: float, step: float
) -> None:
    instance = Instance(oscillator(), {"k": k, "d": d})
    instance.set("drive", drive)
    exact = expm(np.array([[0, 1, 0], [-k, -d, drive], [0, 0, 0]]) * step) @ [1.0, 0.0, 1.0]
    instance.step(0.0, step)
    assert [instance.x.a, instance.x.b] == pytest.approx(exact[:2], rel=1e-8, abs=1e-9)


def test_a_model_that_depends_on_time_is_integrated_over_the_time_of_the_step() -> None:
    model = oscillator(derivatives=lambda t, x, u, p: {"a": t**3, "b": 0.0}, solver_step=lambda p: 1.0)
    instance = Instance(model, {"a_start": 0.0})
    instance.begin(2.0)
    instance.step(2.0, 1.0)
    assert instance.get("a") == pytest.approx((3**4 - 2**4) / 4, rel=1e-14)


def test_a_sample_within_a_step_splits_the_integration() -> None:
    """In a step of 0.25 the samples at 0, 0.1 and 0.2 are taken; the last one holds until 0.3."""
    instance = Instance(INTEGRATOR)
    instance.set("rate", 1.0)
    instance.step(0.0, 0.25)
    instance.set("rate", 5.0)
    instance.step(0.25, 0.25)
    assert instance.get("area") == pytest.approx(0.3 + 5 * 0.2, rel=1e-12)
    assert instance.get("twice") == 2 * instance.get("area")


def test_samples_count_from_the_start_time() -> None:
    instance = Instance(INTEGRATOR)
    instance.begin(0.03)
    instance.set("rate", 1.0)
    instance.step(0.03, 0.05)
    instance.set("rate", 2.0)
    instance.step(0.08, 0.05)
    assert instance.get("held") == 1.0
    instance.step(0.13, 0.05)
    assert instance.get("held") == 2.0


@given(st.integers(1, 20_000_000), st.sampled_from([0.001, 0.005, 0.01, 1 / 300]))
def test_one_sample_falls_in_each_step_of_one_period_wherever_rounding_puts_its_end(k: int, period: float) -> None:
    instance = Instance(INTEGRATOR, {"period": period})
    instance.restore(instance.snapshot() | {"samples": k, "stepped": True})
    instance.set("rate", 7.0)
    instance.step(k * period, period)
    assert (instance.samples, instance.get("held")) == (k + 1, 7.0)
    assert instance.get("area") == pytest.approx(7 * period, rel=1e-6)


def test_start_values_follow_their_parameter_until_the_first_step_and_not_after() -> None:
    instance = Instance(INTEGRATOR)
    instance.set("area_start", 3.0)
    assert (instance.get("area"), instance.get("twice")) == (3.0, 6.0)
    instance.step(0.0, 0.1)
    instance.set("area_start", 9.0)
    assert instance.get("area") == 3.0


def test_outputs_follow_an_input_at_once() -> None:
    motor = Instance(library.find("dc_motor"))
    for voltage in (1.0, -2.0):
        motor.set("voltage", voltage)
        assert motor.get("torque") == 10 * voltage


def test_defaults_given_to_an_instance_are_its_parameters() -> None:
    instance = Instance(INTEGRATOR, {"period": 0.5, "rate": 2.0})
    assert (instance.get("period"), instance.get("rate")) == (0.5, 2.0)


@pytest.mark.parametrize("name", ["perod", "area", "twice", "held"])
def test_a_name_that_is_no_input_or_parameter_cannot_be_set(name: str) -> None:
    with pytest.raises(KeyError, match=f"integrator has no input or parameter '{name}'"):
        Instance(INTEGRATOR, {name: 1.0})
    with pytest.raises(KeyError, match=f"integrator has no input or parameter '{name}'"):
        Instance(INTEGRATOR).set(name, 1.0)


def test_a_table_cannot_be_overwritten_by_a_number() -> None:
    with pytest.raises(KeyError, match="playback"):
        Instance(library.find("excitation")).set("playback", 1.0)


def test_an_unknown_name_cannot_be_read() -> None:
    for model in (INTEGRATOR, library.find("daq")):
        with pytest.raises(KeyError, match="nothing"):
            Instance(model).get("nothing")


def test_begin_forgets_everything_but_inputs_and_parameters() -> None:
    instance = Instance(INTEGRATOR)
    instance.set("rate", 4.0)
    instance.step(0.0, 1.0)
    instance.begin(0.0)
    assert (instance.get("area"), instance.get("held"), instance.get("rate"), instance.samples) == (0.0, 0.0, 4.0, 0)


def advance(instance: Instance, first: int, last: int) -> None:
    for k in range(first, last):
        instance.set("signal", math.sin(k))
        instance.step(k * 0.01, 0.01)


@pytest.mark.parametrize("fresh", [False, True])
def test_a_run_continues_from_a_snapshot_as_if_it_had_not_been_interrupted(fresh: bool) -> None:
    values = {"sample_time": 0.004, "filter_order": 2, "cutoff": 20.0, "noise": 0.1}
    model = library.find("daq")
    instance = Instance(model, values)
    advance(instance, 0, 7)
    text = json.dumps(instance.snapshot())
    advance(instance, 7, 15)
    expected = instance.snapshot()
    if fresh:
        instance = Instance(model)
    instance.restore(json.loads(text))
    advance(instance, 7, 15)
    assert instance.snapshot() == expected


def test_a_snapshot_does_not_change_when_the_run_goes_on() -> None:
    instance = Instance(INTEGRATOR)
    instance.set("rate", 1.0)
    instance.step(0.0, 0.1)
    taken = instance.snapshot()
    before = json.dumps(taken)
    instance.set("rate", 3.0)
    instance.step(0.1, 0.1)
    assert json.dumps(taken) == before


def test_a_requirement_that_does_not_hold_stops_the_first_step_with_its_reason() -> None:
    model = oscillator(requirements=(Requirement(lambda t, x, u, p: p.k > 0, "stiffness is not positive"),))
    Instance(model).step(0.0, 0.1)
    with pytest.raises(StepError, match="stiffness is not positive"):
        Instance(model, {"k": -1.0}).step(0.0, 0.1)


def test_requirements_see_the_inputs_of_the_first_step() -> None:
    model = oscillator(requirements=(Requirement(lambda t, x, u, p: u.drive > 1, "no drive"),))
    instance = Instance(model)
    instance.set("drive", 2.0)
    instance.step(0.0, 0.1)
    with pytest.raises(StepError, match="no drive"):
        Instance(model).step(0.0, 0.1)


def test_a_state_that_is_not_finite_is_named_with_the_time() -> None:
    instance = Instance(oscillator())
    instance.set("drive", math.nan)
    with pytest.raises(StepError, match=r"state '[ab]' is nan at t = 0\.1 s"):
        instance.step(0.0, 0.1)


def test_an_unstable_model_ends_in_an_error_not_in_infinities() -> None:
    instance = Instance(oscillator(derivatives=lambda t, x, u, p: {"a": x.a**2, "b": 0.0}), {"a_start": 10.0})
    with pytest.raises((StepError, OverflowError)):
        for k in range(100):
            instance.step(k * 0.1, 0.1)
