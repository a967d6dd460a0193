"""Recalibration near a motion, against exact solutions of the closed loop and against FMUs."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fmus.errors import IdentificationError, TraceError
from identification.estimation.estimated_value import EstimatedValue
from identification.motion.decay import Recalibration, recalibrate
from identification.motion.motion import Motion, recorded_motion
from identification.motion.published import one_step_errors, recalibrate_as_published
from orchestrator.assembly.assembly import OpenSystem, assemble
from orchestrator.scenario.schema import load_scenario
from orchestrator.trace import Trace

TRUE = {"p1": 0.00325, "p2": 0.001, "p3": 0.04905, "p4": 10.0}
GAIN = 0.02
TARGET = TRUE["p3"] * (1 - np.cos(1.0))
SCENARIO = Path(__file__).parents[3] / "scenarios" / "butterfly" / "energy_control.yaml"
START = (0.724, 0.868)  # 0.6 times the energy of the orbit


@lru_cache
def swing(
    p1: float = TRUE["p1"],
    p3: float = TRUE["p3"],
    target: float = TARGET,
    gain: float = GAIN,
    compensated: float = TRUE["p2"],
    start: tuple[float, float] = START,
    step: float = 0.01,
) -> Trace:
    """The pendulum under the continuous control of Eqs. 103 and 109 with these p1, p3, p2 in the controller, 6 s."""

    def closed_loop(t: float, x: np.ndarray) -> list[float]:
        energy = 0.5 * p1 * x[1] ** 2 + p3 * (1 - np.cos(x[0]))
        voltage = compensated / TRUE["p4"] * x[1] - gain * x[1] * (energy - target)
        return [x[1], (TRUE["p4"] * voltage - TRUE["p2"] * x[1] - TRUE["p3"] * np.sin(x[0])) / TRUE["p1"]]

    time = np.linspace(0.0, 6.0, round(6 / step) + 1)
    run = solve_ivp(closed_loop, (0, time[-1]), start, t_eval=time, rtol=1e-11, atol=1e-12)
    return Trace(time, {"angle": run.y[0], "speed": run.y[1]})


def noisy(trace: Trace, rng: np.random.Generator, angle: float, speed: float) -> Trace:
    noise = {"angle": angle, "speed": speed}
    return Trace(trace.time, {n: y + noise[n] * rng.normal(size=len(y)) for n, y in trace.signals.items()})


def values(found: Recalibration) -> list[float]:
    return [found.parameters[name].value for name in ("p1", "p3", "p4")]


EXACT = [TRUE[name] for name in ("p1", "p3", "p4")]


def test_the_invariant_decays_as_the_action_grows_however_far_from_the_orbit() -> None:
    for start in (START, (0.373, 4.165), (0.0, 0.5)):
        motion = recorded_motion(swing(start=start, step=0.002))
        invariant = motion.invariant(TRUE["p1"], TRUE["p3"], TARGET)
        expected = invariant[0] * np.exp(-TRUE["p4"] * GAIN * motion.action)
        assert invariant == pytest.approx(expected, abs=1e-8 * TARGET)


def test_an_exact_motion_gives_the_parameters_back() -> None:
    found = recalibrate(recorded_motion(swing()), GAIN, TARGET)
    assert values(found) == pytest.approx(EXACT, rel=1e-6)
    assert found.ratio.value == pytest.approx(TRUE["p3"] / TRUE["p1"], rel=1e-6)
    assert found.level.value == pytest.approx(TARGET / TRUE["p1"], rel=1e-6)
    assert found.rate.value == pytest.approx(TRUE["p4"] * GAIN, rel=1e-6)


def test_the_angle_alone_gives_the_parameters_back() -> None:
    found = recalibrate(recorded_motion(swing(step=0.002), speed=None), GAIN, TARGET)
    assert values(found) == pytest.approx(EXACT, rel=1e-4)


def test_a_shifted_equilibrium_is_taken_into_account() -> None:
    trace = swing()
    shifted = Trace(trace.time, {"q": trace["angle"] + 0.996, "w": trace["speed"]})
    found = recalibrate(recorded_motion(shifted, "q", "w", 0.996), GAIN, TARGET)
    assert values(found) == pytest.approx(EXACT, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("case", [0, 1])  # below and above the orbit's energy
def test_sampled_control_of_fmus_gives_the_parameters_back(case: int, tmp_path: Path) -> None:
    scenario = load_scenario(SCENARIO)
    given = scenario.cases[case].values
    assembled = assemble(scenario.system, tmp_path)
    with OpenSystem(assembled) as opened, opened.simulation(scenario.timing) as simulation:
        trace = simulation.run(given, record=["hand.angle", "hand.speed"]).trace
    motion = recorded_motion(trace, "hand.angle", "hand.speed")
    found = recalibrate(motion, float(given["controller.gain"]), TARGET)
    # The control is held over 5 ms, which Eq. 109 does not know.
    assert values(found)[:2] == pytest.approx(EXACT[:2], rel=1e-3)
    assert values(found)[2] == pytest.approx(EXACT[2], rel=1e-2)
    assert found.white is False


def inside(intervals: list[EstimatedValue], true: float) -> float:
    return float(np.mean([each.ci95[0] <= true <= each.ci95[1] for each in intervals]))


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "speed"), [(1e-3, 1e-2), (5e-3, 3e-2), (5e-3, 0.0), (1e-3, None)])
def test_intervals_cover_the_truth_in_95_percent_of_draws(angle: float, speed: float | None) -> None:
    found = []
    for draw in range(200):
        trace = noisy(swing(), np.random.default_rng([5, draw]), angle, speed or 0.0)
        found.append(recalibrate(recorded_motion(trace, speed=None if speed is None else "speed"), GAIN, TARGET))
    for name in ("p1", "p3", "p4"):
        share = inside([each.parameters[name] for each in found], TRUE[name])
        assert 0.92 <= share <= 0.985, (name, share)
    assert 0.92 <= inside([each.ratio for each in found], TRUE["p3"] / TRUE["p1"]) <= 0.985
    assert np.mean([each.angle_noise for each in found]) == pytest.approx(angle, rel=0.05)
    if speed:
        assert np.mean([each.speed_noise for each in found]) == pytest.approx(speed, rel=0.05)
        assert np.mean([each.white for each in found]) > 0.9


def test_noise_in_the_regressor_does_not_bias_the_ratio_as_it_does_ordinary_least_squares() -> None:
    rng, found, naive = np.random.default_rng(8), [], []
    for _ in range(100):
        motion = recorded_motion(noisy(swing(), rng, 0.03, 0.05))
        found.append(recalibrate(motion, GAIN, TARGET).ratio.value)
        decay = np.exp(-TRUE["p4"] * GAIN * motion.action)
        columns = np.column_stack([np.cos(motion.angle) - 1, np.ones_like(decay), decay])
        naive.append(np.linalg.lstsq(columns, 0.5 * motion.speed**2, rcond=None)[0][0])
    true = TRUE["p3"] / TRUE["p1"]
    error = np.std(found) / 10
    assert abs(np.mean(found) - true) < 4 * error
    assert abs(np.mean(naive) - true) > 10 * error


def test_the_scale_of_the_parameters_is_that_of_the_target() -> None:
    motion = recorded_motion(swing())
    once, twice = recalibrate(motion, GAIN, TARGET), recalibrate(motion, GAIN / 2, 2 * TARGET)
    assert values(twice) == pytest.approx([2 * each for each in values(once)])
    assert (twice.ratio, twice.level, twice.rate) == (once.ratio, once.level, once.rate)


def test_a_controller_in_another_unit_of_energy_reveals_only_ratios_of_the_plant() -> None:
    trace = swing(p1=2 * TRUE["p1"], p3=2 * TRUE["p3"], target=2 * TARGET)
    found = recalibrate(recorded_motion(trace), GAIN, 2 * TARGET)
    assert values(found) == pytest.approx([2 * each for each in EXACT], rel=1e-6)


def test_left_over_viscous_friction_moves_the_level_alone() -> None:
    left = TRUE["p2"] - 0.0006
    found = recalibrate(recorded_motion(swing(compensated=0.0006)), GAIN, TARGET)
    assert found.ratio.value == pytest.approx(TRUE["p3"] / TRUE["p1"], rel=1e-6)
    assert found.rate.value == pytest.approx(TRUE["p4"] * GAIN, rel=1e-6)
    shift = -left / (TRUE["p4"] * GAIN * TRUE["p1"])
    assert found.level.value - TARGET / TRUE["p1"] == pytest.approx(shift, rel=1e-5)


def test_a_controller_with_a_wrong_ratio_still_reveals_the_plants() -> None:
    for gain, tolerance in ((GAIN, 5e-3), (GAIN / 4, 5e-4)):
        found = recalibrate(recorded_motion(swing(p1=1.1 * TRUE["p1"], gain=gain)), gain, TARGET)
        assert found.ratio.value == pytest.approx(TRUE["p3"] / TRUE["p1"], rel=tolerance)


def test_the_rate_is_the_slope_of_the_logarithm_of_the_invariant() -> None:
    motion = recorded_motion(swing())
    early = motion.action < 15
    invariant = np.abs(motion.invariant(TRUE["p1"], TRUE["p3"], TARGET))
    slope = np.polyfit(motion.action[early], np.log(invariant[early]), 1)[0]
    assert recalibrate(motion, GAIN, TARGET).rate.value == pytest.approx(-slope, rel=1e-5)


def test_the_published_index_vanishes_at_the_truth_and_without_a_pendulum() -> None:
    motion = recorded_motion(swing(step=0.002))
    assert one_step_errors(motion, np.array(EXACT), GAIN, TARGET) == pytest.approx(0, abs=1e-9 * TARGET)
    assert not one_step_errors(motion, np.zeros(3), GAIN, TARGET).any()
    assert np.abs(one_step_errors(motion, np.array([1.05, 1, 1]) * EXACT, GAIN, TARGET)).max() > 1e-4 * TARGET


def test_the_published_recalibration_is_right_for_exact_signals_and_biased_by_noise() -> None:
    start = 1.1 * np.array(EXACT)
    assert recalibrate_as_published([recorded_motion(swing())], GAIN, TARGET, start) == pytest.approx(EXACT, rel=1e-4)
    motion = recorded_motion(noisy(swing(), np.random.default_rng(4), 1e-3, 1e-2))
    published, corrected = recalibrate_as_published([motion], GAIN, TARGET, start), recalibrate(motion, GAIN, TARGET)
    assert np.all(published < 0.7 * np.array(EXACT))
    assert values(corrected) == pytest.approx(EXACT, rel=1e-2)


def on_orbit() -> Motion:
    start = (0.0, float(np.sqrt(2 * TARGET / TRUE["p1"])))
    return recorded_motion(noisy(swing(start=start), np.random.default_rng(6), 1e-3, 1e-2))


REFUSED: list[tuple[Callable[[], object], str]] = [
    (lambda: recalibrate(on_orbit(), GAIN, TARGET), "off the orbit"),
    (lambda: recalibrate(recorded_motion(swing()), 0.0, TARGET), "gain: 0 is not positive"),
    (lambda: recalibrate(recorded_motion(swing()), GAIN, float("nan")), "target: nan is not positive"),
    (lambda: recorded_motion(swing().between(0, 0.1)), "holds 11 samples"),
    (lambda: recorded_motion(swing(), "theta"), "no signal 'theta'"),
]


@pytest.mark.parametrize(("ask", "message"), REFUSED)
def test_what_cannot_be_answered_is_refused(ask: Callable[[], object], message: str) -> None:
    with pytest.raises((IdentificationError, TraceError), match=message):
        ask()


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10**6), st.sampled_from(["noise", "turning", "growing"]))
def test_what_is_no_approach_to_an_orbit_is_refused_or_uncertain_but_never_crashes(seed: int, kind: str) -> None:
    rng, time = np.random.default_rng(seed), np.linspace(0.0, 1.99, 200)
    speed = {"noise": rng.normal(size=200), "turning": np.full(200, 3.0), "growing": np.exp(time) * np.cos(9 * time)}
    measured = np.asarray(speed[kind] + 1e-3 * rng.normal(size=200))
    signals = {"angle": np.asarray(0.01 * np.cumsum(speed[kind])), "speed": measured}
    try:
        found = recalibrate(recorded_motion(Trace(time, signals)), GAIN, TARGET)
    except IdentificationError:
        return
    assert np.all(np.isfinite(values(found))) and min(values(found)) > 0
