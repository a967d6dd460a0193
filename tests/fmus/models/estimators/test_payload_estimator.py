"""The payload estimator on a mass at the end of a spring, which a hub turns."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal

from fmus import library
from fmus.modelling import symbolic
from fmus.modelling.instance import Instance

ESTIMATOR = library.find("payload_estimator")
T = 1 / 300
TACHO, STIFFNESS, TURNED, BENT, DEFLECTION = (
    float(next(one.start for one in ESTIMATOR.variables if one.name == name))
    for name in ("tachometer", "stiffness", "turned_mass", "bent_mass", "deflection_per_volt")
)


SHOWN = ("payload", "known", "given", "half_width")


def seen(
    payload: float, height: float = 3.0, seconds: float = 3.0, swing: float = 0.0, **values: float
) -> list[tuple[float, ...]]:
    """What is shown, sample by sample, of an arm that is turned to and fro by so many rad/s2.

    Args:
        swing: added to the strain, a sine of 3 Hz [V].
    """
    time = np.arange(round(seconds / T)) * T
    rhythm = 2 * np.pi * 0.5
    beam = signal.lti([-(payload + TURNED)], [payload + BENT, 0.03, STIFFNESS])
    _, tip, _ = signal.lsim(beam, height * np.sin(rhythm * time), time)
    estimator, rows = Instance(ESTIMATOR, values), []
    for k, speed in enumerate(height / rhythm * (1 - np.cos(rhythm * time))):
        estimator.set("speed", TACHO * speed)
        estimator.set("strain", tip[k] / DEFLECTION + swing * np.sin(2 * np.pi * 3 * time[k]))
        estimator.step(k * T, T)
        rows.append(tuple(float(estimator.get(name)) for name in SHOWN))
    return rows


def estimated(payload: float, height: float = 3.0, **values: float) -> list[tuple[float, float]]:
    """Payload and whether it is known."""
    return [(payload, known) for payload, known, *_ in seen(payload, height, **values)]


@pytest.mark.parametrize("payload", [0.0, 0.13, 0.4])
def test_the_payload_is_found_of_speed_and_strain_alone(payload: float) -> None:
    assert estimated(payload)[-1] == pytest.approx((payload, 1.0), abs=1e-3)


def test_until_it_is_given_it_is_that_at_the_start() -> None:
    rows = seen(0.4, payload_start=0.1)
    first = [given for *_, given, _ in rows].index(1.0)
    assert 0 < first < 0.5 / T
    assert {(payload, half_width) for payload, _, given, half_width in rows if not given} == {(0.1, 0.6)}
    assert rows[first][0] == pytest.approx(0.4, abs=0.02)


@pytest.mark.parametrize("payload", [0.0, 0.13, 0.4])
@pytest.mark.parametrize("wrong", [0.99, 1.0, 1.01])
def test_it_is_known_once_its_interval_is_narrow_and_the_interval_holds(payload: float, wrong: float) -> None:
    """The stiffness is off by up to 1 %."""
    rows = seen(payload, stiffness=wrong * STIFFNESS)
    first = [known for _, known, *_ in rows].index(1.0)
    assert all(half_width > 0.02 for *_, half_width in rows[:first])
    assert rows[first][3] <= 0.02
    assert rows[first][2] == 1.0
    assert all(abs(found - payload) <= half_width for found, *_, half_width in rows[first:])


def test_a_beam_that_does_not_fit_is_not_known() -> None:
    """A strain that swings on its own leaves force that no payload explains."""
    still, swinging = (seen(0.2, swing=swing) for swing in (0.0, 3.0))
    assert still[-1][1] == 1.0
    assert swinging[-1][2] == 1.0
    assert swinging[-1][1] == 0.0
    assert swinging[-1][3] > 0.02


def test_an_arm_that_hardly_moves_tells_nothing() -> None:
    assert estimated(0.4, height=0.02)[-1] == (0.2, 0.0)


def test_it_keeps_to_payloads_that_can_be() -> None:
    assert estimated(2.0)[-1][0] == 0.6
    assert estimated(0.0, turned_mass=0.3)[-1][0] == 0.0


def test_its_outputs_do_not_react_at_once() -> None:
    assert set(symbolic.feed_through(ESTIMATOR).values()) == {()}
