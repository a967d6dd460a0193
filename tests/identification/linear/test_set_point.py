"""Set-point following: the loop is that of python-control, and an unstable one is told."""

from __future__ import annotations

import control
import numpy as np
import pytest

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from identification.linear.set_point import Feedback, closed, followed
from tests.support.identification.linear_fits import model_of

FEEDBACK = Feedback(0.5, 1.4, "angle", "speed")


def double_integrator(step: float = 0.01, sign: float = 1.0) -> LinearModel:
    a = np.array([[1.0, step], [0.0, 1.0]])
    b = sign * np.array([[step**2 / 2], [step]])
    return LinearModel(a, b, np.eye(2), np.zeros((2, 1)), step, ("u",), ("angle", "speed"))


def test_the_loop_is_the_one_python_control_closes() -> None:
    model = double_integrator()
    plant = model.control()
    gains = control.ss([], [], [], [[FEEDBACK.proportional, FEEDBACK.derivative]], model.step)
    reference = control.feedback(plant, gains) * FEEDBACK.proportional
    time = np.arange(500) * model.step
    expected = control.forced_response(reference, time, np.ones(500)).outputs
    assert followed(model, FEEDBACK, np.ones(500)) == pytest.approx(np.asarray(expected).T, abs=1e-10)


def test_an_unstable_loop_has_no_response() -> None:
    assert followed(double_integrator(sign=-1.0), FEEDBACK, np.ones(10)) is None


def test_a_model_with_feed_through_or_two_inputs_is_refused() -> None:
    with pytest.raises(IdentificationError, match="one input"):
        closed(model_of([0.5], inputs=2), FEEDBACK)
