"""A signal that stops at an end of its range is told from one that turns there, rests, holds or counts."""

from __future__ import annotations

import numpy as np
import pytest

from identification.signals.clipping import clipped
from orchestrator.trace import FloatArray

TIME = np.arange(2001) * 0.01
SWING = np.sin(3 * TIME) + 0.4 * np.sin(7.3 * TIME)
STEP = np.clip(TIME - 5, 0, 1)


@pytest.mark.parametrize("count", [0.0, 0.01])
@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_both_ends_of_a_range_are_found_with_how_long_a_signal_is_there(count: float, noise: float) -> None:
    signal = np.clip(SWING + noise * np.random.default_rng(0).standard_normal(len(TIME)), -0.9, 1.1)
    signal = count * np.round(signal / count) if count else signal
    high, low = clipped(signal)
    assert (high.highest, low.highest) == (True, False)
    assert (high.value, low.value) == pytest.approx((1.1, -0.9))
    assert high.share == pytest.approx(np.mean(signal == signal.max()), abs=0.02)
    assert all(np.all(signal[first:after] == low.value) for first, after in low.stretches)


@pytest.mark.parametrize(
    "signal",
    [
        SWING,
        np.round(SWING / 0.2) * 0.2,  # a coarse encoder, whose turns lie at one count
        np.round(np.sin(3 * TIME) / 0.03) * 0.03,
        np.repeat(SWING[::5], 5)[: len(TIME)],  # held over samples
        np.sign(np.sin(3 * TIME)),  # two values
        STEP,  # a move to rest, once
        np.zeros(2001),
    ],
)
def test_turns_rest_holds_and_switches_are_no_ends(signal: FloatArray) -> None:
    assert list(clipped(signal)) == []
