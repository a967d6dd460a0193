"""The functions of a co-simulation FMU, version 2.0 or 3.0, behind one face."""

from __future__ import annotations

import ctypes
from abc import abstractmethod
from dataclasses import dataclass
from typing import Any

from fmpy import fmi2

from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.base import DISCARD, FAILED, FmiFunctions, Logger
from orchestrator.fmi.functions.event_mode import Events3
from orchestrator.fmi.functions.library import FMU2Slave, FMU3Slave
from orchestrator.fmi.functions.updates import IntermediateUpdates, UpdateArguments
from orchestrator.fmi.functions.version2 import Version2
from orchestrator.fmi.functions.version3 import Version3, receiver

_ALMOST = 1 - 1e-9  # of a step that is whole but for rounding


@dataclass(frozen=True)
class EarlyStop:
    """That an FMU ended a step by itself.

    Attributes:
        reached: up to where it came [s].
        asked: whether it wants to be stepped no more.
    """

    reached: float
    asked: bool

    def whole(self, time: float, duration: float) -> bool:
        """Whether the step from a time by a duration [s] came to its end."""
        return self.reached >= time + duration * _ALMOST

    def __str__(self) -> str:
        return f"{'asked to stop' if self.asked else 'ended early'} at t = {self.reached:g} s"


class CoSimulation(FmiFunctions):
    """An FMU that brings its own solver.

    Attributes:
        reached: what it says on request, or after each step, of how far it came [s].
    """

    do_step: Any
    reached: ctypes.c_double

    @abstractmethod
    def step(self, time: float, duration: float) -> int:
        """Advance from `time` by `duration` [s]. The status."""

    @abstractmethod
    def stop(self, status: int, time: float) -> EarlyStop | None:
        """How the FMU itself ended the step from a time [s] that returned this status, None where it did not."""


class Fmi2(Version2, CoSimulation):
    kind = FMU2Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger) -> None:
        super().__init__(fmu, name, log)
        self.asked, self.reached = ctypes.c_int(), ctypes.c_double()
        self.do_step = self.function("DoStep")
        self.do_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        self.do_step.restype = ctypes.c_int

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, 1))

    def stop(self, status: int, time: float) -> EarlyStop | None:
        if status != DISCARD or not (self.has("GetBooleanStatus") and self.has("GetRealStatus")):
            return None
        self.asked.value, self.reached.value = 0, time
        self.call("GetBooleanStatus", fmi2.fmi2Terminated, ctypes.byref(self.asked))
        self.call("GetRealStatus", fmi2.fmi2LastSuccessfulTime, ctypes.byref(self.reached))
        return EarlyStop(self.reached.value, True) if self.asked.value else None


class Fmi3(Version3, CoSimulation):
    kind = FMU3Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger, updates: IntermediateUpdates | None = None) -> None:
        self._made_with: UpdateArguments = {} if updates is None else updates.arguments()
        super().__init__(fmu, name, log)
        self.flags = [ctypes.c_bool() for _ in range(3)]
        self.reached = ctypes.c_double()
        self.do_step = self.function("DoStep")
        self.do_step.restype = ctypes.c_int
        self.do_step.argtypes = [
            ctypes.c_void_p,
            ctypes.c_double,
            ctypes.c_double,
            ctypes.c_bool,
            *[ctypes.POINTER(ctypes.c_bool)] * 3,
            ctypes.POINTER(ctypes.c_double),
        ]
        self._results = [*map(ctypes.byref, self.flags), ctypes.byref(self.reached)]

    def instantiate(self) -> None:
        self.fmu.instantiate(logMessage=receiver(self._log), **self._made_with)
        self.handle.value = self.fmu.component

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, True, *self._results))

    def stop(self, status: int, time: float) -> EarlyStop | None:
        _, asked, early = (flag.value for flag in self.flags)
        return EarlyStop(self.reached.value, asked) if status < FAILED and (asked or early) else None


class EventFmi3(Events3, Fmi3):
    """One that is told its events in event mode, and may return from a step at one."""

    def instantiate(self) -> None:
        self.fmu.instantiate(
            logMessage=receiver(self._log), eventModeUsed=True, earlyReturnAllowed=True, **self._made_with
        )
        self.handle.value = self.fmu.component
