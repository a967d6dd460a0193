"""How long stretches are chosen, and which of them move."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from identification.signals.excitation import Picked, most_moving, motion, spreads, stretch_length
from orchestrator.trace import Trace

STEP = Fraction(1, 100)


def sine(period: float, duration: float, name: str = "sine") -> Trace:
    time = np.arange(0, duration, 0.003)
    return Trace(time, {"y": 0.3 + np.sin(2 * np.pi * time / period)}, name=name)


@pytest.mark.parametrize("period", [0.4, 1.0, 2.5])
def test_a_stretch_is_four_periods_long(period: float) -> None:
    found = stretch_length([sine(period, 40 * period)], ["y"], STEP, Fraction(0))
    assert found.period == pytest.approx(period, rel=0.03)
    assert float(found.seconds) == pytest.approx(4 * period, rel=0.03)
    assert found.seconds % STEP == 0


def test_what_goes_slowly_leaves_room_for_four_stretches_in_the_shortest_recording() -> None:
    found = stretch_length([sine(9.0, 90.0), sine(9.0, 10.0)], ["y"], STEP, Fraction(2))
    assert float(found.seconds) == pytest.approx((10.0 - 2) / 4, abs=0.02)


def test_a_recording_that_holds_less_is_taken_as_it_is() -> None:
    found = stretch_length([sine(0.1, 0.3)], ["y"], STEP, Fraction(0))
    assert 0 < found.seconds <= Fraction(3, 10)


def test_rest_does_not_move_and_motion_does() -> None:
    time = np.arange(0, 10, 0.01)
    trace = Trace(time, {"y": np.where(time < 5, np.sin(6 * time), np.sin(30.0)), "still": np.ones(len(time))})
    spread = spreads([trace], ["y", "still"])
    assert motion(trace, 0.0, 4.0, spread)["y"] > 0.9
    assert motion(trace, 6.0, 10.0, spread)["y"] < 1e-6
    assert motion(trace, 0.0, 4.0, spread)["still"] == 0.0


@given(scores=st.lists(st.floats(0, 10), max_size=20), data=st.data(), most=st.one_of(st.none(), st.integers(1, 5)))
def test_those_that_move_most_are_taken_in_their_order(
    scores: list[float], data: st.DataObject, most: int | None
) -> None:
    moves = data.draw(st.lists(st.booleans(), min_size=len(scores), max_size=len(scores)))
    taken, picked = most_moving(scores, moves, most)
    assert taken == sorted(set(taken)) and all(moves[number] for number in taken)
    left = [scores[n] for n, move in enumerate(moves) if move and n not in taken]
    assert not left or max(left) <= min(scores[number] for number in taken)
    assert picked == Picked(len(taken), moves.count(False), len(left))
    assert len(taken) == min(sum(moves), most or len(scores))
