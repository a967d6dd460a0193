"""The functions of an FMU, version 2.0 or 3.0, behind one face: what the versions call differently is here.

FMPy loads, instantiates and frees; values and steps go straight to the FMU's functions with prepared arrays, because
that is where a simulation spends its time.
"""

from __future__ import annotations

import ctypes
import itertools
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from fmpy import fmi2, fmi3
from fmpy.model_description import ModelDescription

from fmus.errors import FmuFileError
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import Port, Value

DISCARD = FAILED = 2  # status discard, and worse
FATAL = 4  # no function of the FMU may be called again


def _cast(ctype: Any, kind: str) -> Callable[[float], Any]:
    """From a number to the C type's; whole numbers that do not fit are an OverflowError, for ctypes would cut them."""
    if ctype in (ctypes.c_double, ctypes.c_float, ctypes.c_char_p):
        return float
    bits = 8 * ctypes.sizeof(ctype)
    low = -(1 << bits - 1) if ctype(-1).value == -1 else 0
    high = low + (1 << bits) - 1

    def whole(value: float) -> int:
        number = round(value)
        if not low <= number <= high:
            raise OverflowError(f"{value} does not fit into {kind} ({low} to {high})")
        return number

    return whole


class Channel:
    """Some variables of one FMU, read or written together: one call for each FMI type among them."""

    def __init__(self, fmi: Adapter, ports: Sequence[Port]) -> None:
        by_type: dict[str, list[int]] = {}
        for position, port in enumerate(ports):
            by_type.setdefault(fmi.storage(port.type), []).append(position)
        self._size = len(ports)
        self._groups = [
            _Group(fmi, kind, [ports[i].reference for i in places], places) for kind, places in by_type.items()
        ]
        only = self._groups[0] if len(self._groups) == 1 else None
        self._single = only if only is not None and only.floats else None

    @property
    def groups(self) -> Sequence[_Group]:
        """Its variables by FMI type, in the order in which they are read and written."""
        return self._groups

    def write(self, values: Sequence[float]) -> int:
        """The worst status; nothing is written where a value does not fit its type."""
        for group in self._groups:
            group.values[:] = [group.cast(values[i]) for i in group.places]
        return max((group.set(*group.arguments) for group in self._groups), default=0)

    def read(self) -> tuple[int, Sequence[float]]:
        if self._single is not None:
            status = self._single.get(*self._single.arguments)
            return status, self._single.values[:]
        result = [0.0] * self._size
        worst = max((group.get(*group.arguments) for group in self._groups), default=0)
        for group in self._groups:
            for place, value in zip(group.places, group.values, strict=True):
                result[place] = float(value)
        return worst, result


class _Group:
    """Variables of one type, or an array of `count` values: prepared arguments for the FMU's get and set functions."""

    def __init__(
        self, fmi: Adapter, kind: str, references: Sequence[int], places: Sequence[int], count: int | None = None
    ) -> None:
        self.kind, self.places = kind, places
        self.ctype = ctype = fmi.ctype(kind)
        self.floats = ctype in (ctypes.c_double, ctypes.c_float)
        self.cast: Callable[[float], Any] = bool if kind == "Boolean" else _cast(ctype, kind)
        count = len(references) if count is None else count
        self.values = (ctype * count)()
        self.references = (ctypes.c_uint * len(references))(*references)
        self.arguments = (fmi.handle, self.references, len(references), self.values, *fmi.count(count))
        self.get = fmi.accessor("Get", kind)
        self.set = fmi.accessor("Set", kind)


def ended(reached: float, asked: bool) -> str:
    """That an FMU ended a step by itself, at this time [s]."""
    return f"ended early at t = {reached:g} s" + (" and asked to stop" if asked else "")


class Adapter(ABC):
    """What differs between FMI 2.0 and 3.0, behind one face.

    Attributes:
        kind: FMPy's class of instances.
    """

    prefix: str
    state_name: str
    types: Mapping[str, Any]
    kind: Any
    fmu: Any
    description: ModelDescription
    handle: ctypes.c_void_p

    @abstractmethod
    def storage(self, kind: str) -> str:
        """Type whose get and set functions serve this type."""

    @abstractmethod
    def count(self, number: int) -> tuple[int, ...]:
        """Extra arguments of get and set: the number of values, where the version wants it."""

    @abstractmethod
    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        """Enter initialisation; times in seconds, the relative tolerance of the solver outside. The status."""

    def accessor(self, verb: str, kind: str) -> Callable[..., int]:
        function = getattr(self.fmu.dll, f"{self.prefix}{verb}{kind}")
        pointer = ctypes.POINTER(self.ctype(kind))
        extra = [ctypes.c_size_t] * len(self.count(0))
        function.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, pointer, *extra]
        function.restype = ctypes.c_int
        return function

    def ctype(self, kind: str) -> Any:
        """C type of a value."""
        try:
            return self.types[kind]
        except KeyError:
            raise FmuFileError(
                self.fmu.instanceName,
                f"has a variable of type {kind}, which is not supported",
                "leave it at its start value",
            ) from None

    def single(self, port: Port) -> bool:
        """Whether the variable is kept in single precision."""
        return self.ctype(self.storage(port.type)) is ctypes.c_float

    def set_one(self, port: Port, value: Value) -> int:
        group = _Group(self, self.storage(port.type), [port.reference], [0])
        group.values[0] = value.encode() if isinstance(value, str) else group.cast(value)
        return group.set(*group.arguments)

    def get_one(self, port: Port) -> tuple[int, Value]:
        group = _Group(self, self.storage(port.type), [port.reference], [0])
        status = group.get(*group.arguments)
        value = group.values[0]
        if isinstance(value, bytes):
            return status, value.decode(errors="replace")
        return status, bool(value) if port.type == "Boolean" else value

    def run(self) -> int:
        return self.call("ExitInitializationMode")

    def reset(self) -> int:
        return self.call("Reset")

    def call(self, name: str, *arguments: Any) -> int:
        """A function that takes the instance first, by the end of its name."""
        function = getattr(self.fmu.dll, self.prefix + name)
        function.restype = ctypes.c_int
        return int(function(self.handle, *arguments))

    def state(self, verb: str, argument: Any) -> int:
        """Get, Set or Free a snapshot of the whole state."""
        return self.call(f"{verb}{self.state_name}", argument)

    def free(self) -> None:
        """Free the instance; the library stays loaded, since unloading it breaks some of them."""
        free = getattr(self.fmu.dll, f"{self.prefix}FreeInstance")
        free.restype = None
        free(self.handle)


Logger = Callable[[int, str], None]


class CoSimulation(Adapter):
    """An FMU that brings its own solver.

    Attributes:
        ending: how the FMU itself ended a step that came back discarded, nothing where it did not say.
    """

    do_step: Any
    ending = ""

    @abstractmethod
    def step(self, time: float, duration: float) -> int:
        """Advance from `time` by `duration` [s]. The status."""

    @abstractmethod
    def judged(self, status: int) -> int:
        """The status of a step that returned this one; discard where the FMU ended it early."""


class Version2(Adapter):
    """What all instances of FMI 2.0 share."""

    prefix = "fmi2"
    state_name = "FMUstate"
    types = {
        "Real": ctypes.c_double,
        "Integer": ctypes.c_int,
        "Boolean": ctypes.c_int,
        "String": ctypes.c_char_p,
    }

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        self.description = fmu.description
        self.fmu = self.kind(
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.identifier,
            instanceName=name,
        )
        self._ticket = Fmi2Logging.register(log)
        try:
            self.fmu.instantiate(callbacks=Fmi2Logging.callbacks(self._ticket), loggingOn=debug_log)
        except Exception:
            Fmi2Logging.forget(self._ticket)
            raise
        self.handle = ctypes.c_void_p(self.fmu.component)

    def storage(self, kind: str) -> str:
        return "Integer" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return ()

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        limits = (tolerance is not None, tolerance or 0.0, start, stop is not None, stop or 0.0)
        status = self.call("SetupExperiment", *limits)
        return status if status >= FAILED else max(status, self.call("EnterInitializationMode"))

    def free(self) -> None:
        super().free()
        Fmi2Logging.forget(self._ticket)


class Fmi2(Version2, CoSimulation):
    kind = fmi2.FMU2Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        super().__init__(fmu, name, log, debug_log)
        self.do_step = self.fmu.dll.fmi2DoStep
        self.do_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        self.do_step.restype = ctypes.c_int

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, 1))

    def judged(self, status: int) -> int:
        if status == DISCARD:
            asked, reached = ctypes.c_int(), ctypes.c_double()
            self.call("GetBooleanStatus", fmi2.fmi2Terminated, ctypes.byref(asked))
            self.call("GetRealStatus", fmi2.fmi2LastSuccessfulTime, ctypes.byref(reached))
            self.ending = ended(reached.value, True) if asked.value else ""
        return status


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
        own.logger = cls._receive
        own.allocateMemory = fmi2.defaultCallbacks.allocateMemory
        own.freeMemory = fmi2.defaultCallbacks.freeMemory
        own.componentEnvironment = ticket
        addLoggerProxy(ctypes.byref(own))  # the library keeps one receiver; whoever was last has it
        return own

    @fmi2.fmi2CallbackLoggerTYPE
    @staticmethod
    def _receive(environment: int, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        log = Fmi2Logging._loggers.get(environment)
        if log is not None:
            log(status, (message or b"").decode(errors="replace").strip())


class Version3(Adapter):
    """What all instances of FMI 3.0 share."""

    prefix = "fmi3"
    state_name = "FMUState"
    types = {
        "Float64": ctypes.c_double,
        "Float32": ctypes.c_float,
        "Boolean": ctypes.c_bool,
        "String": ctypes.c_char_p,
        **{f"{u}Int{bits}": getattr(ctypes, f"c_{u.lower()}int{bits}") for bits in (8, 16, 32, 64) for u in ("", "U")},
    }

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        self.description = fmu.description
        self.fmu = self.kind(
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.identifier,
            instanceName=name,
        )

        def receive(environment: int, status: int, category: bytes, message: bytes) -> None:
            log(status, (message or b"").decode(errors="replace").strip())

        self.fmu.instantiate(loggingOn=debug_log, logMessage=receive)
        self.handle = ctypes.c_void_p(self.fmu.component)
        self._arrays: dict[int, list[float]] = {}

    def set_one(self, port: Port, value: Value) -> int:
        if not port.array:
            return super().set_one(port, value)
        whole = self._arrays.setdefault(port.reference, list(port.array))
        whole[port.element] = float(value)
        group = _Group(self, port.type, [port.reference], [0], len(whole))
        group.values[:] = whole
        return group.set(*group.arguments)

    def get_one(self, port: Port) -> tuple[int, Value]:
        if not port.array:
            return super().get_one(port)
        group = _Group(self, port.type, [port.reference], [0], len(port.array))
        return group.get(*group.arguments), group.values[port.element]

    def reset(self) -> int:
        self._arrays.clear()
        return super().reset()

    def storage(self, kind: str) -> str:
        return "Int64" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return (number,)

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        limits = (tolerance is not None, tolerance or 0.0, start, stop is not None, stop or 0.0)
        return self.call("EnterInitializationMode", *limits)


class Fmi3(Version3, CoSimulation):
    kind = fmi3.FMU3Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        super().__init__(fmu, name, log, debug_log)
        self.flags = [ctypes.c_bool() for _ in range(3)]
        self.reached = ctypes.c_double()
        self.do_step = self.fmu.dll.fmi3DoStep
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

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, True, *self._results))

    def judged(self, status: int) -> int:
        _, asked, early = (flag.value for flag in self.flags)
        ending = status < FAILED and (asked or early)
        self.ending = ended(self.reached.value, asked) if ending else ""
        return DISCARD if ending else status
