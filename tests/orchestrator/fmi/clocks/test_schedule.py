"""Clocks that tick by time do so where arithmetic has their ticks, however far they are from the start."""

from __future__ import annotations

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from orchestrator.fmi.clocks.declared import Clock, TickInterval
from orchestrator.fmi.clocks.schedule import ClockSchedule

LENGTHS = st.fractions(Fraction(1, 10**6), Fraction(10), max_denominator=10**6)


def one(kind: TickInterval, interval: Fraction | None = None, shift: Fraction = Fraction(0)) -> ClockSchedule:
    return ClockSchedule([Clock("c", 1, "input", kind, interval, shift)])


def ticked(schedule: ClockSchedule, count: int) -> list[float]:
    times = []
    for _ in range(count):
        times.append(schedule.next)
        assert schedule.due(schedule.next) == {1}
    return times


@given(LENGTHS, st.fractions(0, Fraction(10), max_denominator=1000), st.integers(0, 10**6).map(lambda n: n / 8))
def test_periodic_ticks_are_rounded_once(interval: Fraction, shift: Fraction, start: float) -> None:
    schedule = one(TickInterval.CONSTANT, interval, shift)
    schedule.begin(start)
    first = Fraction(start) + shift
    assert ticked(schedule, 50) == [float(first + number * interval) for number in range(50)]


@given(st.lists(st.integers(1, 1000), min_size=1, max_size=20))
def test_a_changing_clock_ticks_at_the_sum_of_its_intervals(milliseconds: list[int]) -> None:
    schedule = one(TickInterval.CHANGING)
    schedule.begin(0.0)
    times = []
    for length in milliseconds:
        times += ticked(schedule, 1)
        assert schedule.next == float("inf") and schedule.asking({1}, beginning=False) == [1]
        schedule.told(1, length / 1000, times[-1])
    expected = [sum(milliseconds[:number]) / 1000 for number in range(len(milliseconds))]
    assert times == expected


def test_a_countdown_ticks_once_after_it_was_told() -> None:
    schedule = one(TickInterval.COUNTDOWN)
    schedule.begin(0.0)
    assert schedule.next == float("inf")
    schedule.told(1, 0.25, 1.0)
    assert ticked(schedule, 1) == [1.25] and schedule.next == float("inf")


def test_a_tunable_clock_goes_on_from_its_latest_tick() -> None:
    schedule = one(TickInterval.TUNABLE, Fraction(1, 10), Fraction(1, 20))
    schedule.begin(0.0)
    schedule.told(1, 0.1, 0.0)
    assert ticked(schedule, 3) == [0.05, 0.15, 0.25]
    schedule.told(1, 0.5, 0.3)
    assert ticked(schedule, 2) == [0.75, 1.25]


def test_going_back_to_a_copy_gives_the_same_ticks() -> None:
    schedule = one(TickInterval.CONSTANT, Fraction(1, 3))
    schedule.begin(0.0)
    ticked(schedule, 5)
    saved = schedule.saved()
    first = ticked(schedule, 5)
    schedule.restore(saved)
    assert ticked(schedule, 5) == first
