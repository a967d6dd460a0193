"""Test signals against NumPy's and SciPy's, and random ones against what their seed promises."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal, stats

from fmus import library
from fmus.modelling.instance import Instance
from fmus.modelling.model import Table
from fmus.models.signals.excitation import SHAPES
from orchestrator.trace import FloatArray
from tests.support.fmus.stepping import grid, stepped

EXCITATION = library.find("excitation")
SWEEP: dict[str, Any] = {"frequency": 0.5, "frequency_end": 4.0, "duration": 3.0}


def played(shape: str, time: FloatArray, table: Table | None = None, **values: Any) -> FloatArray:
    """(K,) the signal of that shape at the instants (K,), as a running instance gives it."""
    given = {"shape": SHAPES.index(shape) + 1} | values
    return stepped(EXCITATION, given, ("signal",), time, tables={"playback": table} if table else None)[:, 0]


def sweep_phase(time: FloatArray) -> FloatArray:
    """Phase [rad] of the sweep: the integral of its frequency, summed finely."""
    fine = np.linspace(0, time[-1], 200_001)
    frequency = np.interp(fine, [0.0, 3.0], [0.5, 4.0])
    turns = np.concatenate(([0.0], np.cumsum((frequency[1:] + frequency[:-1]) / 2 * np.diff(fine))))
    return 2 * math.pi * np.interp(time, fine, turns)


def test_sine_is_that_of_numpy() -> None:
    time = grid(3.0, 0.01)
    found = played("sine", time, frequency=1.7, amplitude=2.5, offset=-1.0)
    assert found == pytest.approx(-1 + 2.5 * np.sin(2 * math.pi * 1.7 * time), abs=1e-12)


def test_sine_sweep_is_the_chirp_of_scipy() -> None:
    time = grid(3.0, 0.01)
    expected = signal.chirp(time, 0.5, 3.0, 4.0, phi=-90)
    assert played("sine sweep", time, **SWEEP) == pytest.approx(expected, abs=1e-9)


def test_after_the_sweep_its_last_frequency_goes_on_without_a_jump_of_phase() -> None:
    time = grid(5.0, 0.01)
    assert played("sine sweep", time, **SWEEP) == pytest.approx(np.sin(sweep_phase(time)), abs=1e-5)


def test_a_falling_sweep_is_the_falling_chirp() -> None:
    time = grid(2.0, 0.01)
    found = played("sine sweep", time, frequency=5.0, frequency_end=1.0, duration=2.0)
    assert found == pytest.approx(signal.chirp(time, 5.0, 2.0, 1.0, phi=-90), abs=1e-9)


def test_square_is_that_of_scipy() -> None:
    time = grid(4.0, 0.01) + 0.003
    assert np.array_equal(
        played("square", time, frequency=1.3, amplitude=2.0), 2 * signal.square(2 * math.pi * 1.3 * time)
    )


def test_square_switches_at_the_sample_its_edge_falls_on() -> None:
    found = played("square", grid(200.0, 0.05), frequency=0.5)
    assert np.array_equal(found, np.tile(np.repeat([1.0, -1.0], 20), 101)[: len(found)])


def test_varying_square_has_the_sign_of_the_sweep() -> None:
    time = grid(5.0, 0.01) + 0.0037
    phase = sweep_phase(time)
    clear = np.abs(np.sin(phase)) > 1e-3
    found = played("varying square", time, **SWEEP)
    assert np.array_equal(found[clear], np.sign(np.sin(phase))[clear])
    assert set(found) == {1.0, -1.0}


@pytest.mark.parametrize("shape", ["sine", "sine sweep", "square", "varying square"])
def test_a_phase_of_a_quarter_begins_where_a_signal_of_one_hertz_is_after_a_quarter_of_a_second(shape: str) -> None:
    time = grid(3.0, 0.01)
    steady = {"frequency": 1.0, "frequency_end": 1.0}
    later = played(shape, time, **steady)[25:]
    assert played(shape, time, phase=0.25, **steady)[: len(later)] == pytest.approx(later, abs=1e-9)


def test_a_varying_square_from_a_quarter_on_leaves_a_mass_about_where_it_was() -> None:
    """Force to position: without the phase the mass drifts off by many times the swing."""
    time = grid(20.0, 1 / 300)
    sweep = {"frequency": 0.6, "frequency_end": 3.0, "duration": 20.0}
    swings = [
        np.abs(np.cumsum(np.cumsum(played("varying square", time, phase=phase, **sweep)))).max() / 300**2
        for phase in (0.25, 0.0)
    ]
    assert swings[0] < 0.6
    assert swings[1] > 5


def test_alternating_random_is_a_square_of_random_heights() -> None:
    """The periodic random waveform of the flexible-manipulator thesis."""
    time = grid(9.99, 0.01)
    found = played("alternating random", time, frequency=0.5, amplitude=2.0, seed=5)
    assert np.array_equal(np.sign(found), played("square", time, frequency=0.5))
    assert stats.kstest(np.abs(found), stats.uniform(0, 2).cdf).pvalue > 1e-4
    assert len(set(found)) == len(found)


def test_steps_go_up_to_the_amplitude_and_down_again() -> None:
    found = played("steps", grid(1.7, 0.1), sample_time=0.1, levels=4, amplitude=8.0)
    up_and_down = [0, 2, 4, 6, 8, 6, 4, 2]
    assert found.tolist() == pytest.approx((up_and_down * 3)[:18])


@pytest.mark.parametrize("lines", [1, 3, 12])
def test_a_multisine_has_the_power_of_a_sine_in_its_lines_alone(lines: int) -> None:
    """Over a period: as many harmonics, of equal amplitude, and no others."""
    period = played("multisine", grid(1.99, 0.01), frequency=0.5, lines=lines, amplitude=2.0)
    spectrum = 2 * np.abs(np.fft.rfft(period)) / len(period)
    expected = np.zeros_like(spectrum)
    expected[1 : lines + 1] = 2.0 / math.sqrt(lines)
    assert spectrum == pytest.approx(expected, abs=1e-9)
    assert period.std() == pytest.approx(math.sqrt(2.0))


def test_the_phases_of_a_multisine_keep_its_peak_low() -> None:
    """Its lines in phase would reach far beyond; Schroeder's stay below twice the effective value."""
    time = grid(1.999, 0.001)
    found = played("multisine", time, frequency=0.5, lines=12)
    together = sum(np.sin(2 * math.pi * 0.5 * line * time) for line in range(1, 13)) / math.sqrt(12)
    peak = np.abs(found).max()
    assert peak < 2 * found.std()
    assert peak < 0.7 * np.abs(together).max()


def test_playback_interpolates_the_table_from_the_beginning_on() -> None:
    table = Table("playback", (0.0, 0.5, 2.0), (1.0, 3.0, -1.0))
    time = grid(4.0, 0.1)
    expected = np.where(time >= 1 - 1e-9, 0.5 + 2 * np.interp(time - 1, table.time, table.values), 0.0)
    assert played("playback", time, table, begin=1.0, amplitude=2.0, offset=0.5) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("shape", SHAPES)
def test_every_signal_is_zero_before_it_begins_and_only_delayed_by_its_beginning(shape: str) -> None:
    table = Table("playback", (0.0, 1.0), (1.0, 2.0))
    time = grid(2.0, 0.01)
    now = played(shape, time, table, offset=0.3)
    later = played(shape, time, table, offset=0.3, begin=0.5)
    assert np.all(later[:50] == 0.0)
    assert later[50:] == pytest.approx(now[:-50], abs=1e-9)


@pytest.mark.parametrize("shape", ["random", "periodic random"])
def test_random_values_repeat_with_their_seed_and_differ_with_another(shape: str) -> None:
    time = grid(1.0, 0.01)
    first, again, other = (played(shape, time, seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert np.mean(first == other) < 0.05


def test_random_values_are_uniform_between_minus_and_plus_the_amplitude() -> None:
    found = played("random", grid(100.0, 0.01), amplitude=2.0, seed=11)
    assert abs(found.mean()) < 4 * 2 / math.sqrt(3 * 10_000)
    assert found.var() == pytest.approx(4 / 3, rel=0.05)
    assert stats.kstest(found, stats.uniform(-2, 4).cdf).pvalue > 1e-4


def test_random_values_are_white() -> None:
    found = played("random", grid(100.0, 0.01), seed=2)
    centred = found - found.mean()
    correlation = [np.dot(centred[:-lag], centred[lag:]) / np.dot(centred, centred) for lag in range(1, 20)]
    assert np.max(np.abs(correlation)) < 4.5 / math.sqrt(len(found))


def test_periodic_random_repeats_exactly() -> None:
    found = played("periodic random", grid(4.99, 0.01), period_samples=50)
    assert np.array_equal(found.reshape(10, 50), np.tile(found[:50], (10, 1)))
    assert len(set(found[:50])) == 50


def test_a_random_value_is_held_for_its_sample_time() -> None:
    found = played("random", grid(9.99, 0.01), sample_time=0.1)
    held = found.reshape(100, 10)
    assert np.all(held == held[:, :1])
    assert len(set(held[:, 0])) == 100


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
@given(divisor=st.integers(2, 7), start=st.integers(0, 5000))
def test_the_signal_does_not_depend_on_the_step_or_on_where_it_is_entered(shape: str, divisor: int, start: int) -> None:
    table = Table("playback", (0.0, 20.0), (1.0, 2.0))
    coarse = np.arange(start, start + 6, dtype=np.float64) * 0.01
    fine = np.arange(start * divisor, (start + 5) * divisor + 1, dtype=np.float64) * (0.01 / divisor)
    found = played(shape, fine, table)[::divisor]
    assert found == pytest.approx(played(shape, coarse, table), abs=1e-9)


def test_samples_are_counted_right_after_hours() -> None:
    """Rounding of the time must not put the value of one sample into its neighbour."""
    first = 36_000_000
    instance = Instance(EXCITATION, {"shape": SHAPES.index("random") + 1, "sample_time": 0.001})
    found = []
    for k in range(first, first + 3000):
        instance.begin(k / 1000)
        found.append(instance.get("signal"))
    assert len(set(found)) == 3000
