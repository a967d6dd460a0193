"""Controllers side by side, one around each plant, do there what each does alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from identification.linear.model import LinearModel
from identification.tuning.loops import margins
from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.loops import Loops
from identification.tuning.loops.plants import PlantSet
from tests.support.identification.tuned_loops import COMMANDED, WIRING, plant, proportional

MARGINS = (margins.gain_margins, margins.phase_margins, margins.delay_margins, margins.disk_margins)


def lagging(gain: float, pole: float, step: float) -> LinearModel:
    """u = gain (r - y) behind a low-pass of one pole."""
    b, d = gain * np.array([[1 - pole, pole - 1]]), np.zeros((1, 2))
    return LinearModel(np.array([[pole]]), b, np.eye(1), d, step, ("r", "y"), ("u",))


@given(seed=st.integers(0, 1000), gain=st.floats(0.1, 1.5), pole=st.floats(0.0, 0.9))
@settings(deadline=None, max_examples=15)
def test_each_is_around_its_own_plant(seed: int, gain: float, pole: float) -> None:
    """One of them has a state, the other none."""
    models = {"one": plant(seed), "other": plant(seed + 1, pairs=1)}
    own = [lagging(gain, pole, plant(seed).step), proportional(0.5 * gain, plant(seed).step)]
    together = Loops(PlantSet.of(models), ControllerSet.of(own), WIRING)
    alone = [
        Loops(PlantSet.of({name: model}), ControllerSet.of([controller]), WIRING)
        for (name, model), controller in zip(models.items(), own, strict=True)
    ]
    assert together.radius == pytest.approx([loop.radius[0] for loop in alone])
    for path in (None, COMMANDED):
        for margin in MARGINS:
            found = margin(together.opened(path))
            assert found == pytest.approx([margin(loop.opened(path))[0] for loop in alone], rel=1e-6, abs=1e-9)
    for number, loop in enumerate(alone):
        for response in (lambda loop: loop.reference_step(2.0, 60), lambda loop: loop.disturbance_step(0, 1.0, 60)):
            assert response(together).outputs[number] == pytest.approx(response(loop).outputs[0], abs=1e-9)
            assert response(together).inputs[number] == pytest.approx(response(loop).inputs[0], abs=1e-9)
        if loop.stable[0]:
            assert together.noise_gain(0)[number] == pytest.approx(loop.noise_gain(0)[0], rel=1e-6)
