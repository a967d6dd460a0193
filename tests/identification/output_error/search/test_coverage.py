"""Intervals on rigs of real FMUs hold the truth as often as they say, on fewer draws than the benchmark takes."""

from __future__ import annotations

import pytest
from scipy import stats

from tests.benchmarks.figure import share_inside
from tests.benchmarks.identification.coverage import unsaid
from tests.support.covered_rigs import BUTTERFLY, RIGS, SMALL, WRONG, Draw, Rig, draws

DRAWS = 30
LEAST = stats.binom.ppf(1e-3, DRAWS, 0.95) / DRAWS


@pytest.mark.slow
@pytest.mark.parametrize("rig", RIGS, ids=lambda rig: rig.name)
def test_profiles_hold_the_truth(rig: Rig) -> None:
    found = draws(rig, DRAWS, 1)
    shares = {name: share_inside([draw.profile[name] for draw in found], true) for name, true in rig.truth.items()}
    assert min(shares.values()) >= LEAST, shares
    if rig is BUTTERFLY:
        local = [share_inside([draw.local[name] for draw in found], true) for name, true in rig.truth.items()]
        assert min(local) >= LEAST, local
        assert sum(local) < len(local), "intervals that always hold it are too wide"
    if rig is not SMALL:  # there, one side of most intervals is open
        assert sum(shares.values()) < len(shares), "intervals that always hold it are too wide"


@pytest.mark.slow
def test_at_small_motion_profiles_stay_where_friction_can_be() -> None:
    """Local intervals reach below no friction at all in many draws, where profiles are open and say so."""
    found = draws(SMALL, 10, 1)
    name = "hand.viscous_friction"
    below = [draw for draw in found if draw.local[name][0] < 0]
    assert len(below) >= 3
    assert all(draw.profile[name][0] > 0 or draw.profile[name][0] == -float("inf") for draw in found)


@pytest.mark.slow
def test_a_wrong_constant_puts_truths_outside_and_that_is_said() -> None:
    found = draws(WRONG, 12, 1)
    assert sum(_outside(draw) for draw in found) > 6, "a constant that does no harm shows nothing"
    assert unsaid(WRONG, found).holds


def _outside(draw: Draw) -> bool:
    return any(not low <= WRONG.truth[name] <= high for name, (low, high) in draw.profile.items())
