"""Figures of the pendulum thesis: published methods reproduce its tables, corrected ones find the truth."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.io import loadmat
from scipy.signal import ss2tf

from fmus import library
from fmus.errors import IdentificationError, TraceError
from fmus.modelling.instance import Instance
from identification.linear.records import InputOutputData
from identification.resonance.added_mass import AddedMassBounds, fit_damped, resonances
from identification.resonance.log_gain import fit_magnitude
from identification.resonance.resonance import resonance_from_two_largest_as_published
from identification.resonance.steps import (
    RECORDINGS_SCRIPT,
    SYNTHETIC_SCRIPT,
    Experiment,
    ResonanceStudy,
    point_as_published,
    study,
    study_as_published,
)
from identification.subspace.range_space import SubspaceSettings
from identification.subspace.subspace import subspace
from orchestrator.stamps import ordered
from orchestrator.trace import Trace
from tests.support.identification.pendulum_resonance import TABLE_5_BOUNDS, bounds_around, resonance_frequency

P1, P2, P3, P4 = 0.00325, 0.001, 0.04905, 10.0
FREQUENCIES = np.arange(1, 7.01, 0.5)
MASSES, LENGTHS = 0.05 * np.arange(5), 0.005 * np.arange(5)
AMPLITUDE = 1e-5
SYNTHETIC_BOUNDS = bounds_around(P1, P2, P3, 10)
EQ_79 = [3.8788, 3.9741, 4.2436, 4.6489, 5.1447]


@pytest.fixture(scope="module")
def campaign() -> list[Experiment]:
    """Section 2.3: the nonlinear Eq. 78 from 0.01 rad over 70 s, five added masses times 13 frequencies."""
    mass, omega = np.repeat(MASSES, 13), np.tile(FREQUENCIES, 5)
    length = np.repeat(LENGTHS, 13)
    inertia, torque = P1 + mass * length**2, P3 + mass * 9.81 * length

    def derivatives(t: float, state: np.ndarray) -> np.ndarray:
        angle, speed = np.split(state, 2)
        drive = P4 * AMPLITUDE * np.sin(omega * t)
        return np.concatenate([speed, (drive - P2 * speed - torque * np.sin(angle)) / inertia])

    time = np.linspace(0, 70, 7001)
    start = np.concatenate([np.full(65, 0.01), np.zeros(65)])
    run = solve_ivp(derivatives, (0, 70), start, "DOP853", time, rtol=1e-9, atol=1e-12)
    return [
        Experiment(Trace(time, {"angle": angle}), m, length_, AMPLITUDE, w)
        for m, length_, w, angle in zip(mass, length, omega, run.y[:65], strict=True)
    ]


def test_a_model_identified_from_small_swings_has_the_coefficients_of_eq_66() -> None:
    period, volts = 0.04, 1e-6 * np.random.default_rng(66).uniform(-1, 1, 1500)
    pendulum, angle = Instance(library.find("pendulum")), np.empty(len(volts))
    for k, volt in enumerate(volts):
        angle[k] = pendulum.get("angle")
        pendulum.set("torque", P4 * volt)
        pendulum.step(k * period, period)
    record = InputOutputData(volts, angle, period)
    model = subspace([record], 2, SubspaceSettings(block=10)).model
    numerator, denominator = ss2tf(model.a, model.b, model.c, model.d)
    assert denominator == pytest.approx([1, -1.9638, 0.9878], abs=1e-4)
    assert numerator[0] == pytest.approx([0, 2.4465, 2.4365], abs=1e-4)


def resonances_of(result: ResonanceStudy) -> list[float]:
    return [load.resonance.value for load in result.loads]


def test_eq_79_at_the_masses_of_table_1() -> None:
    assert resonance_frequency(P1, P2, P3, MASSES, LENGTHS) == pytest.approx(EQ_79, abs=1e-4)


def test_column_3_of_table_1_counts_the_load_twice() -> None:
    """The script starts from p1 and p3 that hold k times the first load, and its model adds the whole load again."""
    k = np.arange(5)
    inertia, torque = P1 + k * 0.05 * 0.005**2, P3 + k * 0.05 * 9.81 * 0.005
    printed = [3.8788, 4.0671, 4.4156, 4.8812, 5.4194]
    assert resonance_frequency(inertia, P2, torque, MASSES, LENGTHS) == pytest.approx(printed, abs=1e-4)


def test_eq_100_in_decibels_on_the_synthetic_campaign(campaign: list[Experiment]) -> None:
    result = study_as_published(campaign, SYNTHETIC_SCRIPT, SYNTHETIC_BOUNDS)
    assert resonances_of(result) == pytest.approx([3.7739, 3.7704, 4.2643, 4.7614, 5.2448], abs=1e-4)


def test_eq_100_in_plain_amplitudes_on_the_synthetic_campaign(campaign: list[Experiment]) -> None:
    found = []
    for group in np.array_split(np.arange(65), 5):
        gains = [point_as_published(campaign[k], SYNTHETIC_SCRIPT, "angle")[1] for k in group]
        found.append(resonance_from_two_largest_as_published(FREQUENCIES, gains))
    assert found == pytest.approx([3.7291, 3.7217, 4.2621, 4.7839, 5.2839], abs=2e-4)


def test_log_gain_least_squares_on_the_scripts_amplitudes_is_within_a_twentieth_of_a_percent(
    campaign: list[Experiment],
) -> None:
    for group, true in zip(np.array_split(np.arange(65), 5), EQ_79, strict=True):
        gains = [point_as_published(campaign[k], SYNTHETIC_SCRIPT, "angle")[1] for k in group]
        assert fit_magnitude(FREQUENCIES, gains).omega_opt.value == pytest.approx(true, rel=5e-4)


def test_the_corrected_study_finds_the_synthetic_truth(campaign: list[Experiment]) -> None:
    result = study(campaign, 45.0)
    truth = resonance_frequency(P1, P2, P3, MASSES, LENGTHS)
    assert resonances_of(result) == pytest.approx(truth, rel=5e-5)
    for name, true in (("p1", P1), ("p2", P2), ("p3", P3), ("p4", P4)):
        assert result.parameters[name].value == pytest.approx(true, rel=2e-4), name
    assert result.warnings == ()


def with_noise(campaign: list[Experiment], std: float, seed: int) -> list[Experiment]:
    rng = np.random.default_rng(seed)
    return [
        Experiment(
            Trace(e.trace.time[::4], {"angle": e.trace["angle"][::4] + rng.normal(0, std, 1751)}),
            e.added_mass,
            e.added_length,
            e.amplitude,
            e.frequency,
        )
        for e in campaign
    ]


def inside(result: ResonanceStudy) -> list[bool]:
    bounds = [result.parameters[name].ci95 for name in ("p1", "p2", "p3", "p4")]
    return [low <= true <= high for (low, high), true in zip(bounds, (P1, P2, P3, P4), strict=True)]


@pytest.mark.slow
def test_the_95_percent_intervals_hold_the_truth_in_92_to_98_percent_of_200_runs(
    campaign: list[Experiment],
) -> None:
    shares = np.mean([inside(study(with_noise(campaign, 1e-3, seed), 45.0)) for seed in range(200)], axis=0)
    assert np.all((shares >= 0.92) & (shares <= 0.98)), shares


def test_table_2_follows_from_column_4_of_table_1() -> None:
    data = resonances([3.7740, 3.7705, 4.0492, 4.4680, 5.0265], MASSES, LENGTHS)
    free = fit_damped(data, SYNTHETIC_BOUNDS).parameters
    assert [free[name].value for name in ("p1", "p2", "p3")] == pytest.approx([0.0033, 0.0100, 0.0606], abs=6e-5)
    held = AddedMassBounds((P1 / 2, P2, P3 / 2), (0, P2, 0), (1, P2, 1))
    two = fit_damped(data, held).parameters
    assert [two["p1"].value, two["p3"].value] == pytest.approx([0.0033, 0.0453], abs=1e-4)


def test_table_5_lies_on_the_valley_floor_but_short_of_the_minimum() -> None:
    data = resonances([4.1889, 5.7606, 6.281], [0.052, 0.1205, 0.154], 0.104)
    free = fit_damped(data, TABLE_5_BOUNDS)
    assert free.at_bound == ("p2",)
    at_printed = AddedMassBounds((0.002, 0.0188, 0.05), (0, 0.0188, 0), (0.1, 0.0188, 4))
    floor = fit_damped(data, at_printed)
    assert floor.parameters["p1"].value == pytest.approx(0.0028, abs=6e-5)
    assert floor.parameters["p3"].value == pytest.approx(0.0583, rel=0.01)
    assert floor.misfit > free.misfit


def recordings(folder: Path) -> list[Experiment]:
    """The real campaign; masses [g], frequencies and amplitudes are in the file names."""
    experiments = []
    for path in sorted(folder.glob("Data_*.mat")):
        grams, omega, amplitude = re.fullmatch(r"Data_(.+)__(.+)__(\d+)\.mat", path.name).groups()  # type: ignore[union-attr]
        columns = loadmat(path)["D"]
        trace, _ = ordered(columns[:, 0], {"angle": columns[:, 2]}, {"angle": "rad"}, path.name)
        experiments.append(
            Experiment(
                trace,
                float(grams.replace("_", ".")) / 1000,
                0.104,
                float(f"{amplitude[0]}.{amplitude[1:]}"),
                float(omega.replace("_", ".")),
            )
        )
    return experiments


def test_table_4_comes_out_of_the_real_recordings(butterfly_data: Path) -> None:
    result = study_as_published(recordings(butterfly_data), RECORDINGS_SCRIPT, TABLE_5_BOUNDS)
    assert resonances_of(result) == pytest.approx([4.1889, 5.7606, 6.281], rel=1e-3)
    assert [load.added_mass for load in result.loads] == pytest.approx([0.052, 0.1205, 0.154])
    assert "p2 ended on its bound" in result.warnings


@pytest.mark.slow
def test_the_corrected_study_on_the_real_recordings_owns_up_to_dry_friction(butterfly_data: Path) -> None:
    result = study(recordings(butterfly_data), 30.0)
    assert result.parameters["p1"].value == pytest.approx(2.13e-3, rel=0.1)
    assert result.parameters["p4"].value == pytest.approx(2.48, rel=0.1)
    assert any("from any linear pendulum" in warning for warning in result.warnings)
    assert any("p3" in warning for warning in result.warnings)


def test_studies_that_cannot_be_done_are_refused(campaign: list[Experiment]) -> None:
    with pytest.raises(IdentificationError, match="no experiments"):
        study([], 45.0)
    with pytest.raises(IdentificationError, match="only ratios"):
        study(campaign[:13], 45.0)
    with pytest.raises(IdentificationError, match="too few"):
        study_as_published(campaign[:26], SYNTHETIC_SCRIPT, SYNTHETIC_BOUNDS)
    with pytest.raises(TraceError, match="lasts 70 s"):
        study(campaign, 80.0)
    with pytest.raises(TraceError, match="has no signal 'theta'"):
        study(campaign, 45.0, signal="theta")
