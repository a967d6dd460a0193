"""An adapter's milliseconds become times of day that keep its distances."""

from __future__ import annotations

import random

import pytest

from orchestrator.can.slcan.adapter_clock import AdapterClock

NOW = 1.7e9 + 0.123


def dated(drift: float, seconds: int, scale: float = 1000.0) -> tuple[AdapterClock, list[float]]:
    """A clock, and the errors of its times: frames every 10 ms or so, read up to 20 ms later."""
    random.seed(1)
    clock, errors, time = AdapterClock(), [], 0.0
    while time < seconds:
        time += random.uniform(0.005, 0.015)
        stamp = int(scale * (7.0 + time * (1 + drift))) % 60_000
        errors.append(clock.dated(stamp, NOW + time + random.uniform(0.0005, 0.02)) - NOW - time)
    return clock, errors


@pytest.mark.parametrize("drift", [0.0, 1e-4, -1e-4])
def test_distances_are_those_of_the_adapter_over_minutes(drift: float) -> None:
    clock, errors = dated(drift, 400)
    settled = errors[len(errors) // 20 :]
    assert max(settled) - min(settled) < 0.0025 + 90 * abs(drift)
    assert clock.used == len(errors)


def test_a_pause_of_the_reader_does_not_move_stamps() -> None:
    clock = AdapterClock()
    clock.dated(1000, NOW)
    times = [clock.dated(1000 + 100 * k, NOW + 5.0 + 1e-4 * k) for k in range(1, 20)]
    assert times == pytest.approx([NOW + 0.1 * k for k in range(1, 20)], abs=1e-6)


def test_a_gap_of_minutes_is_kept() -> None:
    clock = AdapterClock()
    clock.dated(1000, NOW)
    assert clock.dated(31_000, NOW + 210.0) == pytest.approx(NOW + 210.0, abs=1e-6)


@pytest.mark.parametrize("scale", [1e6, 100.0])
def test_stamps_that_are_no_milliseconds_are_left_out(scale: float) -> None:
    clock, errors = dated(0.0, 200, scale)
    assert clock.odd or max(map(abs, errors)) < 0.03
    assert max(map(abs, errors[-1000:])) < 0.03


def test_frames_without_a_stamp_have_the_time_at_which_they_were_read() -> None:
    clock = AdapterClock()
    assert clock.dated(None, NOW) == NOW
    assert (clock.used, clock.odd) == (0, False)
    assert clock.dated(0xFFFF, NOW) == NOW
    assert clock.odd
