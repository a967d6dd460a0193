"""Linear controllers side by side: one around all plants, or one around each of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from identification.linear.model import LinearModel, transfer
from identification.tuning.loops.plants import padded
from orchestrator.trace import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class ControllerSet:
    """M controllers, 1 or as many as there are plants; the smaller ones have states that nothing moves.

    Attributes:
        a, b, c, d: (M, c, c), (M, c, v), (M, w, c), (M, w, v).
        step: sampling time [s].
    """

    a: FloatArray
    b: FloatArray
    c: FloatArray
    d: FloatArray
    step: float

    @classmethod
    def of(cls, models: Sequence[LinearModel]) -> ControllerSet:
        """These models, which have the same inputs and outputs."""
        most = max(model.order for model in models)
        a, b, c = (np.stack([padded(getattr(model, m), m, most) for model in models]) for m in "abc")
        return cls(a, b, c, np.stack([model.d for model in models]), models[0].step)

    @property
    def order(self) -> int:
        """Number of states."""
        return int(self.a.shape[1])

    def of_loops(self, number: np.ndarray) -> ControllerSet:
        """Those around the plants of these numbers (Q,)."""
        if len(self.a) == 1:
            return self
        return replace(self, **{name: getattr(self, name)[number] for name in "abcd"})

    def response(self, omega: FloatArray) -> ComplexArray:
        """(..., w, v) at angular frequencies (M, ...) [rad/s], or (...) of one controller."""
        between = (slice(None), *(None,) * (omega.ndim - 1))
        a, b, c, d = (getattr(self, name)[between] for name in "abcd")
        if not self.order:
            return np.asarray(d, dtype=complex)
        return np.asarray(transfer(a, b, c, np.exp(1j * omega * self.step)) + d)
