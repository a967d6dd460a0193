"""What all controllers promise about their command: its limit, the flag of saturation, enabling without a jump."""

from __future__ import annotations

import numpy as np
import pytest

from fmus import library
from fmus.modelling.instance import Instance
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import sampled

CONTROLLERS = [name for name in library.names() if "enabled" in library.find(name).by_name]
T = 1 / 300


def bypass(name: str) -> str:
    """The input whose value is the command while the controller is not enabled."""
    return "manual" if "manual" in library.find(name).by_name else "effort"


def enabled_at(name: str, first: int, count: int, **inputs: float) -> FloatArray:
    """(count, 2) voltage and flag of saturation, with inputs at rest and `enabled` from a sample on."""
    model = library.find(name)
    rest = {variable.name: np.full(count, 0.4) for variable in model.of("input")}
    given = {input_: np.full(count, value) for input_, value in inputs.items()}
    enabled = {"enabled": (np.arange(count) >= first).astype(float)}
    return sampled(model, {}, ["voltage", "saturated"], rest | given | enabled)


def test_all_of_them_are_here() -> None:
    assert {"pi", "pdpc", "gain_schedule", "ilqr", "lqg", "disturbance_observer", "notch"} <= set(CONTROLLERS)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_until_it_is_enabled_it_is_bypassed_and_the_instant_of_enabling_makes_no_jump(name: str) -> None:
    found = enabled_at(name, 20, 60, **{bypass(name): 1.7})[:, 0]
    assert found[:21].tolist() == [1.7] * 21
    assert np.abs(np.diff(found)).max() < 0.02 * 4.5  # what fades in a sample of the most that there is to fade


@pytest.mark.parametrize("name", CONTROLLERS)
def test_the_command_keeps_its_limit_and_says_so(name: str) -> None:
    found = enabled_at(name, 10**6, 5, **{bypass(name): -14.0})
    assert found.tolist() == [[-10.0, 1.0]] * 5
    assert enabled_at(name, 10**6, 5, **{bypass(name): 9.0}).tolist() == [[9.0, 0.0]] * 5


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_snapshot_restores_the_states_and_a_new_beginning_resets_them(name: str) -> None:
    """The same samples give the same command again."""
    instance = Instance(library.find(name))
    runs = []
    for _ in range(2):
        instance.begin(0.0)
        for k in range(20):
            for variable in instance.model.of("input"):
                instance.set(variable.name, 0.3 + 0.01 * k)
            instance.step(k * T, T)
        runs.append(instance.get("voltage"))
    assert runs[0] == runs[1]
