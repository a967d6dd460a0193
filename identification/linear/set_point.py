"""How an identified model behaves under the controller of the real system: set-point following (SFV)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fmus.errors import IdentificationError
from identification.linear.model import LinearModel
from orchestrator.trace import FloatArray


@dataclass(frozen=True)
class Feedback:
    """u = proportional (r - y[position]) - derivative y[speed], of the first input.

    Attributes:
        proportional, derivative: in units of the model's input per unit of the outputs.
        position, speed: names of the outputs.
    """

    proportional: float
    derivative: float
    position: str
    speed: str


def closed(model: LinearModel, feedback: Feedback) -> LinearModel:
    """The model under the feedback, from the set-point r to its outputs (Figure 2-3).

    Raises:
        IdentificationError: the model has feed-through or more than one input, for which this loop is not meant.
    """
    if len(model.inputs) != 1 or np.any(model.d):
        raise IdentificationError(
            "set-point following", "needs one input and no feed-through", "identify with D fixed to 0"
        )
    position, speed = (model.c[model.outputs.index(name)] for name in (feedback.position, feedback.speed))
    gain = feedback.proportional * position + feedback.derivative * speed
    return replace(model, a=model.a - model.b @ gain[None, :], b=model.b * feedback.proportional, inputs=("set_point",))


def followed(model: LinearModel, feedback: Feedback, set_point: FloatArray) -> FloatArray | None:
    """(K, p) outputs of the closed loop from rest for a set-point (K,), None where the loop is unstable."""
    loop = closed(model, feedback)
    if not loop.stable:
        return None
    return loop.simulate(np.asarray(set_point, dtype=float)[:, None])
