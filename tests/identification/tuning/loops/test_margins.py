"""Margins of random loops are those of python-control, and mean what they say."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, assume, example, given, settings
from hypothesis import strategies as st

from identification.linear.model import LinearModel
from identification.tuning.loops import margins
from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet, delayed
from identification.tuning.loops.wiring import LoopWiring
from tests.support.identification.tuned_loops import (
    COMMANDED,
    MEASURED,
    WIRING,
    known,
    loops,
    plant,
    proportional,
    touches,
)

SEEDS = st.integers(0, 10_000)
GAINS = st.floats(0.1, 3.0)


def alike(found: float, wanted: float) -> bool:
    return (math.isinf(found) and math.isinf(wanted)) or abs(found - wanted) <= 1e-6 * max(1.0, abs(wanted))


@pytest.mark.slow
@given(seed=SEEDS, gain=GAINS)
@example(seed=1384, gain=2.0)  # the lowest |1 + L| on the grid is around another minimum, five points wide
@example(seed=3562, gain=1.03125)  # |L| is above 1 between two frequencies of the grid only
@example(seed=1115, gain=1.0)  # a crossing between the last frequency of the grid and half the sampling frequency
@settings(deadline=None, max_examples=40)
def test_margins_are_those_of_python_control(seed: int, gain: float) -> None:
    model = plant(seed)
    assume(not touches(model, gain))
    loop, wanted = loops(model, gain).opened(), known(model, gain)
    assert alike(margins.gain_margins(loop)[0], wanted.gain)
    assert alike(np.rad2deg(margins.phase_margins(loop)[0]), wanted.phase)
    assert alike(margins.modulus_margins(loop)[0], wanted.modulus)


@pytest.mark.slow
@given(seed=SEEDS, gain=GAINS)
@example(seed=1115, gain=1.0)
@settings(deadline=None, max_examples=25)
def test_a_stable_loop_becomes_unstable_at_its_gain_margin_and_not_before(seed: int, gain: float) -> None:
    model = plant(seed)
    assume(loops(model, gain).stable[0])
    decibels = margins.gain_margins(loops(model, gain).opened())[0]
    assume(1e-3 < decibels < 60)
    changed = [gain * 10 ** (sign * part * decibels / 20) for sign in (1, -1) for part in (0.999, 1.001)]
    stable = [bool(loops(model, other).stable[0]) for other in changed]
    assert stable[0] and stable[2]
    assert not (stable[1] and stable[3])


@given(seed=SEEDS, gain=GAINS)
@example(seed=32, gain=1.75)  # |L| is more than 1 at half the sampling frequency
@settings(deadline=None, max_examples=25, suppress_health_check=[HealthCheck.filter_too_much])
def test_a_stable_loop_stays_stable_under_every_delay_below_its_delay_margin(seed: int, gain: float) -> None:
    model = plant(seed)
    loop = loops(model, gain)
    assume(loop.stable[0])
    margin = margins.delay_margins(loop.opened())[0]
    assume(margin < 40 * model.step)
    for samples in range(1, math.ceil(margin / model.step)):
        assert loops(delayed("plant", model, samples * model.step, ["u"]), gain).stable[0]


@given(seed=SEEDS, gain=GAINS)
@settings(deadline=None, max_examples=20)
def test_a_disk_margin_is_within_the_other_margins(seed: int, gain: float) -> None:
    loop = loops(plant(seed), gain)
    assume(loop.stable[0])
    opened = loop.opened()
    disk = margins.disk_margins(opened)[0]
    if disk < 2:
        assert margins.gain_margins(opened)[0] >= 20 * np.log10((2 + disk) / (2 - disk)) - 1e-6
    assert margins.phase_margins(opened)[0] >= 2 * np.arctan(disk / 2) - 1e-6
    assert margins.modulus_margins(opened)[0] >= 2 * disk / (2 + disk) - 1e-6


def test_a_loop_of_one_sensor_and_one_command_has_one_margin_wherever_it_is_opened() -> None:
    found = loops(plant(3), 0.8)
    assert found.opened().values == pytest.approx(found.opened(COMMANDED).values)


def test_so_has_one_with_states_in_the_controller_and_outputs_that_go_nowhere() -> None:
    model = plant(3)
    lag = np.array([[0.5]]), np.array([[0.4, -0.4]]), np.ones((2, 1)), np.zeros((2, 2))
    controller = LinearModel(*lag, model.step, ("r", "y"), ("u", "v"))
    found = Loops(
        PlantSet.of({"plant": model}),
        ControllerSet.of([controller]),
        LoopWiring((MEASURED,), (COMMANDED,), 0, 0, (2, 2, 1, 1)),
    )
    assert found.opened().values == pytest.approx(found.opened(COMMANDED).values)


def test_many_plants_have_the_margins_that_each_has_alone() -> None:
    models = {f"plant {seed}": plant(seed, pairs=1 + seed % 3) for seed in range(6)}
    together = Loops(PlantSet.of(models), ControllerSet.of([proportional(0.7, 0.01)]), WIRING).opened()
    alone = [loops(model, 0.7).opened() for model in models.values()]
    for margin in (margins.gain_margins, margins.phase_margins, margins.modulus_margins, margins.delay_margins):
        assert margin(together) == pytest.approx([margin(one)[0] for one in alone], rel=1e-6)


def test_a_loop_with_an_integrator_has_the_margins_of_its_closed_form() -> None:
    """L = g / (z - 1): its phase is -90 degrees less half a turn of z, |L| is 1 at 2 asin(g / 2)."""
    step, gain = 0.01, 0.4
    one = np.ones((1, 1))
    loop = loops(LinearModel(one, one, one, np.zeros((1, 1)), step, ("u",), ("y",)), gain).opened()
    crossing = 2 * math.asin(gain / 2)
    assert margins.gain_margins(loop)[0] == pytest.approx(20 * math.log10(2 / gain), rel=1e-9)
    assert margins.phase_margins(loop)[0] == pytest.approx(math.pi / 2 - crossing / 2, rel=1e-9)
    assert margins.delay_margins(loop)[0] == pytest.approx((math.pi / 2 - crossing / 2) / crossing * step, rel=1e-9)
