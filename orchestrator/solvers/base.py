"""What a solver of differential equations has to offer, and by which names they are known.

A solver takes one internal step at a time, so that whoever uses it can look for events in between.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from orchestrator.trace import FloatArray

Rates = Callable[[float, FloatArray], FloatArray]


class SolverMethod(StrEnum):
    """CVODE's backward differentiation formulas (for stiff systems too), or a method of SciPy: RK45 and DOP853
    (explicit), Radau and BDF (implicit), or LSODA, which chooses."""

    CVODE = "cvode"
    RK45 = "RK45"
    DOP853 = "DOP853"
    RADAU = "Radau"
    BDF = "BDF"
    LSODA = "LSODA"


@dataclass(frozen=True)
class SolverSettings:
    """How derivatives are integrated.

    Attributes:
        relative_tolerance: of each state in each internal step; the absolute one is a hundredth of it times the
            state's nominal value, as FMI 2.0 recommends.
        most_steps: internal steps that one communication step may take.
    """

    method: SolverMethod = SolverMethod.CVODE
    relative_tolerance: float = 1e-6
    most_steps: int = 10_000


class Solver(ABC):
    """Integrates x' = f(t, x).

    Args:
        rates: (n,) f(t, x), in memory that the next call may use again; not finite where f is not defined.

    Raises (any method):
        ArithmeticError: no step from here keeps the tolerance; the message says why.
    """

    def __init__(self, rates: Rates, size: int, settings: SolverSettings) -> None:
        self._rates, self._size, self._settings = rates, size, settings

    @abstractmethod
    def restart(self, time: float, states: FloatArray, nominals: FloatArray) -> None:
        """Start from these (n,) states, forgetting what was before; their nominal values are (n,) and positive."""

    @abstractmethod
    def step(self, limit: float) -> float:
        """Take one internal step; the time that it reached, at most `limit` [s]."""

    @abstractmethod
    def at(self, time: float) -> FloatArray:
        """(n,) the states at a time within the latest step."""

    def close(self) -> None:  # noqa: B027 - most have nothing to free
        """Free what is not Python's."""

    def _absolute(self, nominals: FloatArray) -> FloatArray:
        return 0.01 * self._settings.relative_tolerance * nominals


class Stateless(Solver):
    """For FMUs without continuous states: time passes until an event."""

    def restart(self, time: float, states: FloatArray, nominals: FloatArray) -> None:
        pass

    def step(self, limit: float) -> float:
        return limit

    def at(self, time: float) -> FloatArray:
        return np.zeros(0)
