"""The direction logic of the bounded-position experiment against a mass that it drives to and fro."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.instance import Instance
from tests.support.fmus.stepping import grid, stepped

RELAY = library.find("relay_bound")


def directions(positions: list[float], **values: float) -> list[float]:
    """The direction after each sample of the position."""
    relay, found = Instance(RELAY, dict(values)), []
    for k, position in enumerate(positions):
        relay.set("position", position)
        relay.step(k / 300, 1 / 300)
        found.append(relay.get("direction"))
    return found


def test_it_begins_towards_the_upper_bound_and_turns_at_each() -> None:
    assert directions([0.0, 2.9, 3.0, 1.0, -2.9, -3.0, 0.0, 3.5]) == [1, 1, -1, -1, -1, 1, 1, -1]


@given(st.lists(st.floats(-5, 5), min_size=1, max_size=40))
def test_the_direction_is_away_from_the_bound_that_was_reached_last(positions: list[float]) -> None:
    reached = [np.sign(p) for p in positions if abs(p) >= 3.0]
    assert directions(positions)[-1] == (-reached[-1] if reached else 1.0)


@given(st.floats(0, 10), st.floats(-5, 5))
def test_the_voltage_has_the_magnitude_of_its_input_and_the_sign_of_the_direction(
    magnitude: float, position: float
) -> None:
    relay = Instance(RELAY)
    relay.set("magnitude", magnitude)
    relay.set("position", position)
    relay.step(0.0, 1 / 300)
    assert relay.get("voltage") == (-magnitude if position >= 3.0 else magnitude)


def test_a_mass_is_driven_to_and_fro_between_the_bounds() -> None:
    """It overshoots each bound, since it has to be slowed down, and returns."""
    relay, position, speed, step = Instance(RELAY), 0.0, 0.0, 1 / 300
    found = []
    for k in range(6000):
        relay.set("position", position)
        relay.set("magnitude", 2.0)
        relay.step(k * step, step)
        force = relay.get("voltage") - 0.4 * speed
        position, speed = position + step * speed, speed + step * force
        found.append(position)
    late = np.array(found[2000:])
    assert late.max() > 3.0
    assert late.min() < -3.0
    assert np.abs(late).max() < 6.0
    assert np.count_nonzero(np.diff(np.sign(late))) >= 2


def test_the_voltage_changes_sign_where_the_position_passes_a_bound() -> None:
    signals = {"position": lambda t: 4.0 * math.sin(t), "magnitude": lambda t: 1.5}
    found = stepped(RELAY, {}, ["voltage"], grid(20.0, 1 / 30), signals)[1:, 0]
    changes = np.flatnonzero(np.diff(found)) + 1
    passed = 30 * (math.asin(0.75) + math.pi * np.arange(7))
    assert np.all((changes >= passed) & (changes < passed + 1))
