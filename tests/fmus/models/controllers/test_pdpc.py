"""The PDPC controller against Eqs. 4-6 to 4-8."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace
from tests.support.fmus.stepping import sampled

SCENARIOS = Path(__file__).parents[4] / "scenarios"
PDPC = library.find("pdpc")
ALWAYS = {"error_band": 0.0, "speed_band": 0.0}
volts = st.floats(-3, 3) | st.floats(-0.1, 0.1)


def once(error: float, speed: float, strain: float, **values: float) -> dict[str, float]:
    """The outputs after one sample."""
    names = ("voltage", "effort", "compensation")
    inputs = {"reference": [error], "position": [0.0], "speed": [speed], "strain": [strain]}
    return dict(zip(names, sampled(PDPC, values, names, inputs)[0].tolist(), strict=True))


@given(volts, volts, volts)
def test_it_is_equations_4_6_to_4_8(error: float, speed: float, strain: float) -> None:
    effort = 0.5935 * error - 4.2664 * speed - 0.2538 * strain
    away = abs(error) >= 0.05 or abs(speed) >= 0.05
    found = once(error, speed, strain)
    assert found["effort"] == pytest.approx(effort, abs=1e-12)
    assert found["compensation"] == ((0.7 if found["effort"] >= 0 else -0.7) if away else 0.0)
    assert found["voltage"] == pytest.approx(np.clip(found["effort"] + found["compensation"], -10, 10), abs=1e-12)


@pytest.mark.parametrize(
    ("error", "speed", "height"),
    [(0.049, 0.049, 0.0), (0.05, 0.0, 0.7), (0.0, 0.05, -0.7), (-0.05, 0.0, -0.7), (0.0, 0.0, 0.0)],
)
def test_a_threshold_reached_by_either_brings_the_compensation(error: float, speed: float, height: float) -> None:
    assert once(error, speed, 0.0)["compensation"] == height


@given(volts, volts, st.floats(0, 2))
def test_bands_of_zero_compensate_everywhere(error: float, speed: float, height: float) -> None:
    found = once(error, speed, 0.0, compensation_voltage=height, **ALWAYS)
    assert found["compensation"] == (height if found["effort"] >= 0 else -height)


@given(volts, volts, volts)
def test_without_height_it_is_the_pdp(error: float, speed: float, strain: float) -> None:
    inputs = {"reference": [error], "position": [0.0], "speed": [speed], "strain": [strain]}
    [[expected]] = sampled(library.find("pdp"), {}, ["voltage"], inputs)
    assert once(error, speed, strain, compensation_voltage=0.0)["voltage"] == expected


def recorded(file: str, names: Sequence[str]) -> list[Trace]:
    """What these cases of a scenario of the arm recorded."""
    scenario = load_scenario(SCENARIOS / "flexible_arm" / "control" / file)
    result = run_scenario(replace(scenario, cases=tuple(case for case in scenario.cases if case.name in names)))
    traces = {case.name: case.result.trace for case in result.cases if case.result is not None}
    return [traces[name] for name in names]


def residual(trace: Trace, after: float) -> float:
    """Root mean square of the strain at standstill."""
    return float(np.std(trace["arm.middle_strain"][trace.time > after]))


def hits(trace: Trace, play: float, after: float) -> int:
    """How often a side of the gear comes into touch at standstill."""
    touching = np.abs(trace["arm.gear_twist"][trace.time > after]) > play / 2
    return int(np.sum(touching[1:] & ~touching[:-1]))


@pytest.mark.slow
def test_conditional_compensation_rests_where_unconditional_hunts() -> None:
    """On the nonlinear arm without play, 0 g at 3 V: residual strain at least 3 times lower."""
    conditional, unconditional = recorded("pdpc.yaml", ["3 V with 0 g", "3 V with 0 g, unconditional"])
    assert residual(conditional, 5) < residual(unconditional, 5) / 3


@pytest.mark.slow
@pytest.mark.parametrize("move", ["3 V, 0 g", "5 V, 400 g"])
def test_resting_through_hits_leaves_a_third_of_hits_and_strain_or_less(move: str) -> None:
    """On the nonlinear arm with 2 mrad of play, from 8 s on; the error is no larger, and there is less overshoot."""
    published, resting = recorded("gear_hitting.yaml", [f"PDPC, {move}", f"PDPC that rests through hits, {move}"])
    assert hits(resting, 0.002, 8) < hits(published, 0.002, 8) / 3
    assert residual(resting, 8) < residual(published, 8) / 3
    wanted = float(move[0])
    for largest in (np.max, lambda t: np.max(np.abs(t[-19_200:-1] - wanted))):
        assert largest(resting["potentiometer.measured"]) <= largest(published["potentiometer.measured"]) + 0.01


def compensations(errors: list[float], speeds: list[float], references: list[float] | None = None) -> list[float]:
    """The compensation after each sample, with a band that it wakes beyond."""
    reference = references or [0.0] * len(errors)
    position = [wanted - error for wanted, error in zip(reference, errors, strict=True)]
    inputs = {"reference": reference, "position": position, "speed": speeds, "strain": [0.0] * len(errors)}
    return sampled(PDPC, {"waking_band": 0.1}, ["compensation"], inputs)[:, 0].tolist()


def test_a_compensation_that_rests_is_woken_by_an_error_and_not_by_a_hit() -> None:
    assert compensations([0.06, 0.04, 0.09, 0.09, 0.11, 0.09], [0.0, 0.0, -0.3, 0.0, 0.0, 0.0]) == [
        *(0.7, 0.0, 0.0, 0.0, 0.7, 0.7)
    ]


def test_a_compensation_that_rests_is_woken_by_a_new_reference() -> None:
    assert compensations([0.0, 0.06, 0.06], [0.0] * 3, [0.0, 0.06, 0.06]) == [0.0, 0.7, 0.7]


def test_the_low_pass_of_the_speed_lets_through_what_its_pole_says() -> None:
    speed = np.repeat(0.3, 50)
    inputs = {"reference": np.zeros(50), "position": np.zeros(50), "speed": speed, "strain": np.zeros(50)}
    found = sampled(PDPC, {"speed_cutoff": 10.0}, ["effort"], inputs)[:, 0]
    expected = -4.2664 * 0.3 * (1 - np.exp(-2 * np.pi * 10 / 300 * np.arange(1, 51)))
    assert found == pytest.approx(expected, rel=1e-12)
