"""SciPy's solvers of initial value problems."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
from scipy.integrate import BDF, DOP853, LSODA, RK45, Radau

from orchestrator.solvers.base import Solver, SolverMethod
from orchestrator.trace import FloatArray


class ScipySolver(Solver):
    """One of SciPy's solvers; see `Solver`."""

    method: Any
    extends = True  # whether its limit can be moved on while it runs

    def restart(self, time: float, states: FloatArray, nominals: FloatArray) -> None:
        self._from = time, states.copy()
        self._tolerances = self._absolute(nominals)
        self._running: Any = None

    def step(self, limit: float) -> float:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a failure says the same
            self._head_for(limit)
            message = self._stepped()
        if self._running.status == "failed":
            raise ArithmeticError(message.rstrip("."))
        self._from = self._running.t, self._running.y
        self._between: Any = None
        return float(self._running.t)

    def at(self, time: float) -> FloatArray:
        if time == self._running.t:
            return np.asarray(self._running.y)
        self._between = self._between or self._running.dense_output()
        return np.asarray(self._between(time))

    def _head_for(self, limit: float) -> None:
        if self._running is not None and self.extends:
            self._running.t_bound, self._running.status = limit, "running"
        elif self._running is None or self._running.t_bound != limit:
            self._running = self.method(
                self._kept_rates, *self._from, limit, atol=self._tolerances, rtol=self._settings.relative_tolerance
            )

    def _stepped(self) -> str:
        try:
            return self._running.step() or ""
        except ValueError as error:  # a matrix of numbers that are not finite
            raise ArithmeticError(str(error)) from error

    def _kept_rates(self, time: float, states: FloatArray) -> FloatArray:
        """The derivatives; not finite at states that are not, which methods try that do not look at their results."""
        return self._rates(time, states).copy() if np.isfinite(states).all() else np.full(self._size, np.nan)


def _type(method: Any) -> type[Solver]:
    return type(method.__name__, (ScipySolver,), {"method": method, "extends": method is not LSODA})


TYPES = {SolverMethod(method.__name__): _type(method) for method in (RK45, DOP853, Radau, BDF, LSODA)}
