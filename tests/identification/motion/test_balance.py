"""The energy balance of a motion against pendulums whose parameters are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fmus.errors import IdentificationError
from identification.estimation.estimated_value import EstimatedValue
from identification.motion.balance import Balance, Values, energy_balance
from identification.motion.motion import Motion, recorded_motion
from orchestrator.trace import Trace
from tests.support.identification.energy_swings import GENERIC, RIG, Swing

RATIOS = {"p3/p1": RIG["p3"] / RIG["p1"], "p4/p1": RIG["p4"] / RIG["p1"], "p2/p4": RIG["p2"] / RIG["p4"]}
GENERIC_MODEL: Values = {"p1": GENERIC["p1"], "p2": GENERIC["p2"], "p3": GENERIC["p3"], "p4": GENERIC["p4"]}
NOISE = (1e-4, 0.01)
DRY = (3.2e-3, 6.2e-3)


def motion(trace: Trace) -> Motion:
    return recorded_motion(trace, voltage="voltage")


def motions(swing: Swing, starts: tuple[float, ...] = (0.6, 1.4)) -> list[Motion]:
    """An approach from either side."""
    return [motion(replace(swing, start=start).recorded(seed=n)[0]) for n, start in enumerate(starts)]


SHORT = motions(Swing(noise=NOISE, duration=6))


def values(found: Balance) -> dict[str, float]:
    return {name: one.value for name, one in found.ratios.items()}


@pytest.mark.slow
def test_a_motion_gives_the_plants_ratios_back_whatever_model_its_controller_has() -> None:
    for model in (GENERIC, RIG, RIG | {"p1": 1.5 * RIG["p1"], "p2": 3e-4}):
        found = energy_balance(motions(Swing(model=model)), GENERIC_MODEL)
        assert values(found) == pytest.approx(RATIOS, rel=2e-3)


def test_the_angle_alone_gives_the_ratios_back() -> None:
    derived = [
        recorded_motion(trace.select(["angle", "voltage"]), "angle", None, voltage="voltage")
        for trace in (Swing().recorded()[0], Swing(start=1.4).recorded()[0])
    ]
    found = energy_balance(derived, GENERIC_MODEL)
    assert values(found) == pytest.approx(RATIOS, rel=1e-2)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from(["p1", "p3", "p4"]), st.floats(0.1, 10))
def test_what_is_held_scales_all_others_and_no_ratio(held: str, factor: float) -> None:
    once = energy_balance(SHORT, GENERIC_MODEL, held)  # type: ignore[arg-type]
    model: Values = {name: factor * value for name, value in GENERIC_MODEL.items()}
    more = energy_balance(SHORT, model, held)  # type: ignore[arg-type]
    assert once.values[held] == GENERIC_MODEL[held]  # type: ignore[index]
    assert {n: factor * v for n, v in once.values.items()} == pytest.approx(more.values, rel=1e-9)
    assert values(once) == pytest.approx(values(more), rel=1e-9)


def test_dry_friction_is_told_from_viscous_friction() -> None:
    found = energy_balance(motions(Swing(dry=DRY, noise=NOISE)), GENERIC_MODEL, dry_friction=True)
    scale = GENERIC["p4"] / RIG["p4"]
    assert found.values["dry_positive"] == pytest.approx(scale * DRY[0], rel=0.03)
    assert found.values["dry_negative"] == pytest.approx(scale * DRY[1], rel=0.03)
    assert found.values["p2"] == pytest.approx(scale * RIG["p2"], abs=0.1 * scale * RIG["p2"])
    assert found.values["p1"] == pytest.approx(scale * RIG["p1"], rel=0.02)


def test_folded_dry_friction_takes_the_same_energy() -> None:
    recorded = motions(Swing(dry=DRY, noise=NOISE))
    apart, folded = (energy_balance(recorded, GENERIC_MODEL, dry_friction=dry) for dry in (True, False))
    assert "dry_positive" not in folded.parameters
    action = sum(float(one.action[-1]) for one in recorded)
    ways = [sum(float(np.maximum(s * np.diff(one.angle), 0).sum()) for one in recorded) for s in (1, -1)]
    taken = (
        apart.values["p2"] * action + apart.values["dry_positive"] * ways[0] + apart.values["dry_negative"] * ways[1]
    )
    assert folded.values["p2"] * action == pytest.approx(taken, rel=0.01)
    assert [folded.values[n] for n in ("p1", "p3", "p4")] == [apart.values[n] for n in ("p1", "p3", "p4")]


def test_on_the_orbit_what_the_motor_gives_is_not_told_from_friction_and_stays_generic() -> None:
    """Without the approach, and with a control that hardly acts there, only p3/p1 and p2/p4 show."""
    settled = Swing(model=RIG, noise=(1e-3, 0.05), gain=0.002, start=1.0, duration=20.0)
    found = energy_balance([motion(settled.recorded()[0])], GENERIC_MODEL)
    assert any("p4/p1" in said for said in found.indistinct)
    assert not found.ratios["p4/p1"].known
    assert found.ratios["p3/p1"].known
    low, high = found.ratios["p3/p1"].ci95
    assert low <= RATIOS["p3/p1"] <= high
    assert found.ratios["p4/p1"].value == pytest.approx(GENERIC["p4"] / GENERIC["p1"], rel=0.25)
    assert "p1" in found.parameters and not found.parameters["p1"].known


def covered(intervals: list[EstimatedValue], truth: float) -> float:
    return float(np.mean([one.ci95[0] <= truth <= one.ci95[1] for one in intervals]))


@pytest.mark.slow
def test_intervals_from_the_sensors_noise_cover_the_truth_in_95_percent_of_draws() -> None:
    from_below, from_above = (
        Swing(noise=NOISE, start=start).recorded(200, seed=n) for n, start in enumerate((0.6, 1.4))
    )
    found = [
        energy_balance([motion(below), motion(above)], GENERIC_MODEL)
        for below, above in zip(from_below, from_above, strict=True)
    ]
    assert np.mean([one.method == "noise" for one in found]) > 0.9
    for name, truth in RATIOS.items():
        assert 0.91 <= covered([one.ratios[name] for one in found], truth) <= 0.985, name


def test_a_motion_without_voltage_or_swing_or_with_wrong_signs_is_refused() -> None:
    trace = Swing().recorded()[0]
    with pytest.raises(IdentificationError, match="holds no voltage"):
        energy_balance([recorded_motion(trace)], GENERIC_MODEL)
    rotating = Trace(trace.time, {**trace.signals, "angle": np.cumsum(np.abs(trace["angle"]))})
    with pytest.raises(IdentificationError, match="does not swing"):
        energy_balance([motion(rotating)], GENERIC_MODEL)
    turned = Trace(trace.time, {**trace.signals, "voltage": -trace["voltage"]})
    with pytest.raises(IdentificationError, match="check the signs"):
        energy_balance([motion(turned)], GENERIC_MODEL)
