"""A controller around plants: what the loops do, computed when it is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from identification.tuning.loops.controllers import ControllerSet
from identification.tuning.loops.open_loop import OpenLoop
from identification.tuning.loops.plants import PlantSet
from identification.tuning.loops.wiring import LoopWiring, Path
from orchestrator.trace import ComplexArray, FloatArray


@dataclass(frozen=True, eq=False)
class Response:
    """How the loops answer to a step, from rest.

    Attributes:
        time: (K,) [s], from 0 on.
        outputs: (N, K, p) of the plants.
        inputs: (N, K, m) what the controller gives to the plants' inputs.
    """

    time: FloatArray
    outputs: FloatArray
    inputs: FloatArray


class Loops:
    """The closed loops of one controller around N plants, or of one around each.

        x[k+1] = A x[k] + E r[k] + F d[k] + G n[k],   y = C x,   u = H x + J r + K n

    with the reference r, disturbances d at the plants' inputs and noise n on what is measured.
    """

    def __init__(self, plants: PlantSet, controllers: ControllerSet, wiring: LoopWiring) -> None:
        self.plants, self.controllers, self.wiring = plants, controllers, wiring
        self._opened: dict[Path, OpenLoop] = {}

    @cached_property
    def a(self) -> FloatArray:
        """(N, n + c, n + c) of plant and controller together."""
        plants, k, w = self.plants, self.controllers, self.wiring
        n, count = plants.a.shape[1], len(plants)
        a = np.zeros((count, n + k.order, n + k.order))
        a[:, :n, :n] = plants.a + plants.b @ (w.acting @ k.d @ w.sensing) @ plants.c
        a[:, :n, n:] = plants.b @ (w.acting @ k.c)
        a[:, n:, :n] = (k.b @ w.sensing) @ plants.c
        a[:, n:, n:] = k.a
        return a

    @cached_property
    def poles(self) -> ComplexArray:
        """(N, n + c) in the z-plane."""
        if not np.isfinite(self.a).all():
            return np.full(self.a.shape[:2], np.inf, dtype=complex)
        return np.linalg.eigvals(self.a).astype(complex)

    @cached_property
    def radius(self) -> FloatArray:
        """(N,) the largest modulus of a pole; a loop is stable where it is below 1."""
        return np.asarray(np.abs(self.poles).max(axis=1))

    @property
    def stable(self) -> np.ndarray:
        """(N,) whether each loop is."""
        return np.asarray(self.radius < 1.0)

    def opened(self, path: Path | None = None) -> OpenLoop:
        """The loops opened at a connection, all others closed."""
        where = path or self.wiring.opened
        if where not in self._opened:
            self._opened[where] = OpenLoop(self.plants, self.controllers, self.wiring, where)
        return self._opened[where]

    def reference_step(self, height: float, count: int) -> Response:
        """The answer to a step of the reference over `count` samples."""
        k, w = self.controllers, self.wiring
        direct = k.d[:, :, w.reference] @ w.acting.T
        return self._response(height * self._into(k.b[:, :, w.reference], direct), height * direct, count)

    def disturbance_step(self, number: int, height: float, count: int) -> Response:
        """The answer to a step that is added to an input of the plants, the reference at rest."""
        still = np.zeros((len(self.plants), self.controllers.order))
        into = np.concatenate([self.plants.b[:, :, number], still], axis=1)
        return self._response(height * into, np.zeros((1, len(self.plants.inputs))), count)

    def noise_gain(self, number: int) -> FloatArray:
        """(N, m) rms of the plants' inputs over that of white noise on an output, in the steady state."""
        k, w = self.controllers, self.wiring
        sensed = w.sensing[:, number]
        direct = w.acting @ k.d @ sensed
        covariance = self._covariance(self._into(k.b @ sensed, direct))
        seen = self._inputs_of_state()
        return np.asarray(np.sqrt(np.einsum("nmi,nij,nmj->nm", seen, covariance, seen) + direct**2))

    def _into(self, moved: FloatArray, direct: FloatArray) -> FloatArray:
        """(N, n + c) what moves the controllers' states by `moved` (M, c) and the plants' inputs by `direct` (M, m)."""
        plants = (self.plants.b @ direct[:, :, None])[:, :, 0]
        return np.concatenate([plants, np.broadcast_to(moved, (len(plants), self.controllers.order))], axis=1)

    def _covariance(self, into: FloatArray) -> FloatArray:
        """(N, n, n) P = A P A' + g g', by doubling; nan where a loop is unstable."""
        total, power = into[:, :, None] * into[:, None, :], self.a
        with np.errstate(over="ignore", invalid="ignore"):
            for _ in range(60):
                more = power @ total @ power.swapaxes(1, 2)
                total = total + more
                power = power @ power
                if not np.any(np.abs(more) > 1e-14 * np.abs(total).max()):
                    break
        total[~self.stable] = np.nan
        return total

    def _inputs_of_state(self) -> FloatArray:
        """(N, m, n + c) what the plants' inputs are of the states."""
        k, w = self.controllers, self.wiring
        of_plant = (w.acting @ k.d @ w.sensing) @ self.plants.c
        of_controller = np.broadcast_to(w.acting @ k.c, (*of_plant.shape[:2], k.order))
        return np.concatenate([of_plant, of_controller], axis=2)

    def _response(self, force: FloatArray, direct: FloatArray, count: int) -> Response:
        """Under a constant force (N, n + c) on the states, which gives `direct` (M, m) to the inputs at once."""
        states = _held(self.a, force, count)
        n = self.plants.a.shape[1]
        outputs = (self.plants.c @ states[:, :n]).swapaxes(1, 2)
        inputs = (self._inputs_of_state() @ states).swapaxes(1, 2) + direct[:, None]
        return Response(self.plants.step * np.arange(float(count)), outputs, inputs)


def _held(a: FloatArray, force: FloatArray, count: int) -> FloatArray:
    """(N, n, K) x[k+1] = A x[k] + f from rest, by doubling what there is: a dozen products for any K."""
    systems, n = force.shape
    power = np.zeros((systems, n + 1, n + 1))
    power[:, :n, :n], power[:, :n, n], power[:, n, n] = a, force, 1.0
    x = np.zeros((systems, n + 1, 1))
    x[:, n] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        while x.shape[2] < count:
            x = np.concatenate([x, power @ x[:, :, : count - x.shape[2]]], axis=2)
            power = power @ power
    return np.asarray(x[:, :n])
