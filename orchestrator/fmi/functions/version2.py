"""What all instances of FMI 2.0 share."""

from __future__ import annotations

import ctypes
import itertools
from typing import Any

from fmpy import fmi2

from orchestrator.fmi.functions.base import FAILED, FmiFunctions, Logger, limits


class Version2(FmiFunctions):
    """What all instances of FMI 2.0 share."""

    prefix = "fmi2"
    state_name = "FMUstate"
    _ticket = 0
    types = {
        "Real": ctypes.c_double,
        "Integer": ctypes.c_int,
        "Boolean": ctypes.c_int,
        "String": ctypes.c_char_p,
    }

    def instantiate(self) -> None:
        Fmi2Logging.forget(self._ticket)
        self._ticket = Fmi2Logging.register(self._log)
        try:
            self.fmu.instantiate(callbacks=Fmi2Logging.callbacks(self._ticket))
        except Exception:
            Fmi2Logging.forget(self._ticket)
            raise
        self.handle.value = self.fmu.component

    def storage(self, kind: str) -> str:
        return "Integer" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return ()

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        status = self.call("SetupExperiment", *limits(ctypes.c_int, start, stop, tolerance))
        return status if status >= FAILED else max(status, self.call("EnterInitializationMode"))

    def free(self) -> None:
        super().free()
        Fmi2Logging.forget(self._ticket)


class Fmi2Logging:
    """FMPy formats the variadic messages of FMI 2.0 in C and hands them to one Python function; it sorts them by
    instance."""

    _tickets = itertools.count(1)
    _loggers: dict[int, Logger] = {}

    @classmethod
    def register(cls, log: Logger) -> int:
        ticket = next(cls._tickets)
        cls._loggers[ticket] = log
        return ticket

    @classmethod
    def forget(cls, ticket: int) -> None:
        cls._loggers.pop(ticket, None)

    @classmethod
    def callbacks(cls, ticket: int) -> fmi2.fmi2CallbackFunctions:
        """The callbacks of one instance: the shared functions, and its ticket as environment."""
        from fmpy.logging import addLoggerProxy  # noqa: PLC0415 - loads a library

        own = fmi2.fmi2CallbackFunctions()
        own.logger = cls._receiver
        own.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        own.freeMemory = fmi2.defaultCallbacks.freeMemory
        own.componentEnvironment = ticket
        addLoggerProxy(ctypes.byref(own))  # the library keeps one receiver; whoever was last has it
        return own

    @staticmethod
    def _receive(environment: int, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        log = Fmi2Logging._loggers.get(environment)
        if log is not None:
            log(status, *((text or b"").decode(errors="replace").strip() for text in (category, message)))

    _receiver: Any = fmi2.fmi2CallbackLoggerTYPE(_receive)
