"""The functions of a model exchange FMU, version 2.0 or 3.0, behind one face.

Vectors travel in memory that is prepared once, because the solver asks for them thousands of times.
"""

from __future__ import annotations

import ctypes
import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from fmpy import fmi2

from fmus.errors import FmuFileError
from orchestrator.fmi.functions.base import FAILED, FmiFunctions
from orchestrator.fmi.functions.event_mode import Events3, EventTurn
from orchestrator.fmi.functions.library import FMU2Model, FMU3Model
from orchestrator.fmi.functions.version2 import Version2
from orchestrator.trace import FloatArray

_LARGEST = 1 << 24  # vector


class Vector:
    """One of an FMU's vectors of numbers.

    Attributes:
        values: (n,) its memory.
        get, set: have the FMU fill it or take it; the status.
    """

    def __init__(self, fmi: FmiFunctions, noun: str, size: int) -> None:
        self.values: FloatArray = np.zeros(size)
        self._arguments = fmi.handle, self.values.ctypes.data_as(ctypes.POINTER(ctypes.c_double)), size
        self._get: Any = fmi.function(f"Get{noun}") if size else None
        self._set: Any = getattr(fmi.fmu.dll, f"{fmi.prefix}Set{noun}", None)

    def get(self) -> int:
        return int(self._get(*self._arguments)) if self.values.size else 0

    def set(self) -> int:
        return int(self._set(*self._arguments)) if self.values.size else 0


class ModelExchange(FmiFunctions):
    """An FMU that gives derivatives to a solver outside.

    Attributes:
        states, rates, nominals, indicators: its vectors, once `measure` was called.
    """

    derivatives: str
    flag: Any
    states: Vector
    rates: Vector
    nominals: Vector
    indicators: Vector

    @abstractmethod
    def update(self) -> tuple[int, EventTurn]:
        """One turn of an event iteration. The status and what it brought.

        That states or nominal values have changed is not among it: whoever goes on after an event asks for both.
        """

    @abstractmethod
    def sizes(self) -> tuple[int, int]:
        """Numbers of states and of event indicators."""

    def measure(self) -> None:
        """Prepare the vectors; once the initialisation is over.

        Raises:
            FmuFileError: their sizes cannot be true.
        """
        states, indicators = self.sizes()
        if not (0 <= states <= _LARGEST and 0 <= indicators <= _LARGEST):
            raise FmuFileError(
                self.fmu.instanceName,
                f"has {states} states and {indicators} event indicators",
                "ask its supplier for a valid FMU",
            )
        self.states = Vector(self, "ContinuousStates", states)
        self.rates = Vector(self, self.derivatives, states)
        self.nominals = Vector(self, "NominalsOfContinuousStates", states)
        self.indicators = Vector(self, "EventIndicators", indicators)
        self._set_time: Callable[[ctypes.c_void_p, float], int] = self.function("SetTime")

    def set_time(self, time: float) -> int:
        return self._set_time(self.handle, time)

    def put(self, time: float, states: FloatArray) -> int:
        """Set time and states. The status."""
        self.states.values[:] = states
        status = self.set_time(time)
        return status if status >= FAILED else max(status, self.states.set())

    def complete_step(self, final: bool) -> tuple[int, bool, bool]:
        """Say that an internal step is over, `final` where the FMU will not be set back before it. The status, and
        whether the FMU has an event or asks to stop."""
        if not self.description.modelExchange.needsCompletedIntegratorStep:
            return 0, False, False
        event, ending = self.flag(), self.flag()
        status = self.call("CompletedIntegratorStep", final, ctypes.byref(event), ctypes.byref(ending))
        return status, bool(event.value), bool(ending.value)

    @property
    def directional(self) -> bool:
        """Whether it offers directional derivatives."""
        offered = self.description.modelExchange.providesDirectionalDerivative
        return bool(offered) and self.has("GetDirectionalDerivative")

    def along(self, known: int, unknown: Sequence[int]) -> tuple[int, FloatArray]:
        """The status, and how variables (by their references) change with another one."""
        seed, found = (ctypes.c_double * 1)(1.0), (ctypes.c_double * len(unknown))()
        one, many = ctypes.c_size_t(1), ctypes.c_size_t(len(unknown))
        of, by = (ctypes.c_uint * len(unknown))(*unknown), (ctypes.c_uint * 1)(known)
        tail = (seed, one, found, many) if self.prefix == "fmi3" else (seed, found)
        status = self.call("GetDirectionalDerivative", of, many, by, one, *tail)
        return status, np.array(found[:])

    def rate_name(self, number: int) -> str:
        """How a derivative is called."""
        names = [derivative.variable.name for derivative in self.description.derivatives]
        return names[number] if len(names) == self.rates.values.size else f"derivative {number + 1}"


class Exchange2(Version2, ModelExchange):
    kind = FMU2Model
    derivatives = "Derivatives"
    flag = ctypes.c_int

    def sizes(self) -> tuple[int, int]:
        return int(self.description.numberOfContinuousStates), int(self.description.numberOfEventIndicators)

    def update(self) -> tuple[int, EventTurn]:
        info = fmi2.fmi2EventInfo()
        status = self.call("NewDiscreteStates", ctypes.byref(info))
        next_event = info.nextEventTime if info.nextEventTimeDefined else math.inf
        return status, EventTurn(bool(info.newDiscreteStatesNeeded), bool(info.terminateSimulation), next_event)


class Exchange3(Events3, ModelExchange):
    kind = FMU3Model
    derivatives = "ContinuousStateDerivatives"
    flag = ctypes.c_bool

    def sizes(self) -> tuple[int, int]:
        states, indicators = ctypes.c_size_t(), ctypes.c_size_t()
        self.call("GetNumberOfContinuousStates", ctypes.byref(states))
        self.call("GetNumberOfEventIndicators", ctypes.byref(indicators))
        return states.value, indicators.value
