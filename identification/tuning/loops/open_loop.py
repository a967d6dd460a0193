"""Loops opened at one connection: the response L of what comes back there, 1 + L = 0 where they are critical."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.plants import PlantSet
from identification.tuning.loops.wiring import LoopWiring, Path
from orchestrator.trace import ComplexArray, FloatArray


class OpenLoop:
    """L of N loops, negative feedback: from behind the opening around to before it, with the sign turned (Eq. 4-2)."""

    def __init__(self, plants: PlantSet, controllers: ControllerSet, wiring: LoopWiring, where: Path) -> None:
        self.plants, self.controllers, self.wiring, self.where = plants, controllers, wiring, where
        self._at_plant = where not in wiring.measured

    @property
    def frequencies(self) -> FloatArray:
        """(N, F) angular frequencies [rad/s]."""
        return self.plants.frequencies

    @cached_property
    def values(self) -> ComplexArray:
        """(N, F) at `frequencies`."""
        return self._of(self.plants.responses, self.controllers.response(self.frequencies))

    def at(self, number: np.ndarray, omega: FloatArray) -> ComplexArray:
        """(Q,) of the loops of these numbers (Q,), each at one angular frequency (Q,)."""
        return self._of(self.plants.response(number, omega), self.controllers.of_loops(number).response(omega))

    def _of(self, plant: ComplexArray, controller: ComplexArray) -> ComplexArray:
        w, where = self.wiring, self.where
        whole = w.acting @ controller @ w.sensing  # (..., m, p)
        if self._at_plant:
            row = where.factor * (controller[..., where.source, :] @ w.sensing)  # (..., p) what passes the opening
            rest = whole.copy()
            rest = rest + np.zeros((*plant.shape[:-2], 1, 1))
            rest[..., where.target, :] -= row
            driven = plant[..., where.target]  # (..., p)
            around = _closed(plant, rest, driven[..., None])
            return -(np.broadcast_to(row, around.shape[:-1])[..., None, :] @ around)[..., 0, 0]
        column = (w.acting @ controller[..., where.target, None])[..., 0]  # (..., m)
        rest = whole + np.zeros((*plant.shape[:-2], 1, 1))
        rest[..., where.source] -= where.factor * column
        around = _closed(plant, rest, plant @ column[..., None])
        return -where.factor * around[..., where.source, 0]


def _closed(plant: ComplexArray, feedback: ComplexArray, driven: ComplexArray) -> ComplexArray:
    """(..., p, 1) y = P W y + driven."""
    if plant.shape[-1] == 1:  # W P is a number
        turn = feedback @ plant
        return driven + plant @ (feedback @ driven) / (1.0 - turn)
    return np.asarray(np.linalg.solve(np.eye(plant.shape[-2]) - plant @ feedback, driven))
