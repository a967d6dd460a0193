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


def _cast(ctype: Any, kind: str) -> Callable[[Any], Any]:
    """From a value to the C type's; whole numbers that do not fit are an OverflowError, for ctypes would cut them."""
    if kind == "Boolean":
        return bool
    if ctype is ctypes.c_char_p:
        return lambda text: str(text).encode()
    if ctype in (ctypes.c_double, ctypes.c_float):
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


def _decoded(text: bytes | None) -> str:
    return (text or b"").decode(errors="replace")


class VariableGroup:
    """Some variables of one FMU, read or written together: one call for each FMI type among them.

    Attributes:
        typed: its variables by FMI type, in the order in which they are read and written.
        floats: the only type, where that is one of floats.
    """

    def __init__(self, fmi: FmiFunctions, ports: Sequence[Port]) -> None:
        by_type: dict[str, list[int]] = {}
        for place, port in enumerate(ports):
            by_type.setdefault(fmi.storage(port.type), []).append(place)
        self._size = len(ports)
        self.typed = [TypedValues(fmi, kind, ports, places) for kind, places in by_type.items()]
        only = self.typed[0] if len(self.typed) == 1 else None
        self.floats = only if only is not None and only.plain else None

    def write(self, values: Sequence[Value]) -> int:
        """The worst status; nothing is written where a value does not fit its type."""
        if self.floats is not None:
            self.floats.values[:] = values
            return self.floats.set(*self.floats.arguments)
        for typed in self.typed:
            typed.pack(values)
        return max((typed.set(*typed.arguments) for typed in self.typed), default=0)

    def read(self) -> tuple[int, Sequence[float]]:
        """The worst status, and the values as numbers."""
        if self.floats is not None:
            status = self.floats.get(*self.floats.arguments)
            return status, self.floats.values[:]
        status, values = self.taken()
        return status, [float(value) for value in values]

    def taken(self) -> tuple[int, Sequence[Value]]:
        """The worst status, and the values in their own types."""
        if self.floats is not None:
            return self.read()
        values: list[Value] = [0.0] * self._size
        worst = max((typed.get(*typed.arguments) for typed in self.typed), default=0)
        for typed in self.typed:
            typed.unpack(values)
        return worst, values


class TypedValues:
    """Variables of one FMI type: prepared arguments for the FMU's get and set functions.

    Attributes:
        places: where its variables lie in the group.
        slots: where each lies in `values`; an array goes with all its elements, the others at their start values.
        plain: whether it has one float a variable, in the order of the group.
    """

    def __init__(self, fmi: FmiFunctions, kind: str, ports: Sequence[Port], places: Sequence[int]) -> None:
        self.kind, self.places = kind, places
        self.ctype = ctype = fmi.ctype(kind)
        self._cast = _cast(ctype, kind)
        uncasts: dict[str, Callable[[Any], Value]] = {"Boolean": bool, "String": _decoded}
        self._uncast = uncasts.get(kind)
        references: list[int] = []
        starts: list[float] = []
        arrays: dict[int, int] = {}  # reference -> slot of the first element
        self.slots: list[int] = []
        for port in (ports[place] for place in places):
            first = arrays.get(port.reference, len(starts)) if port.array else len(starts)
            if first == len(starts):
                references.append(port.reference)
                starts += port.array or (0.0,)
            if port.array:
                arrays[port.reference] = first
            self.slots.append(first + port.element)
        self._starts = starts if arrays else []
        self.plain = ctype in (ctypes.c_double, ctypes.c_float) and not arrays
        self.values = (ctype * len(starts))()
        self.references = (ctypes.c_uint * len(references))(*references)
        self.arguments = (fmi.handle, self.references, len(references), self.values, *fmi.count(len(starts)))
        self.get = fmi.accessor("Get", kind)
        self.set = fmi.accessor("Set", kind)

    def pack(self, values: Sequence[Value]) -> None:
        """Take its values out of those of the group."""
        packed = [self._cast(values[place]) for place in self.places]
        if self._starts:
            whole = list(self._starts)
            for slot, value in zip(self.slots, packed, strict=True):
                whole[slot] = value
            packed = whole
        self.values[:] = packed

    def unpack(self, values: list[Value]) -> None:
        """Put its values among those of the group."""
        found = self.values[:]
        for slot, place in zip(self.slots, self.places, strict=True):
            values[place] = self._uncast(found[slot]) if self._uncast else found[slot]


def ended(reached: float, asked: bool) -> str:
    """That an FMU ended a step by itself, at this time [s]."""
    return f"ended early at t = {reached:g} s" + (" and asked to stop" if asked else "")


class FmiFunctions(ABC):
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
        function: Any = getattr(self.fmu.dll, f"{self.prefix}{verb}{kind}")
        pointer = ctypes.POINTER(self.ctype(kind))
        extra = [ctypes.c_size_t] * len(self.count(0))
        function.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, pointer, *extra]
        function.restype = ctypes.c_int
        accessor: Callable[..., int] = function
        return accessor

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

    def run(self) -> int:
        return self.call("ExitInitializationMode")

    def reset(self) -> int:
        return self.call("Reset")

    def call(self, name: str, *arguments: Any) -> int:
        """A function that takes the instance first, by the end of its name."""
        status: int = getattr(self.fmu.dll, self.prefix + name)(self.handle, *arguments)
        return status

    def state(self, verb: str, argument: Any) -> int:
        """Get, Set or Free a snapshot of the whole state."""
        return self.call(f"{verb}{self.state_name}", argument)

    def free(self) -> None:
        """Free the instance; the library stays loaded, since unloading it breaks some of them."""
        free = getattr(self.fmu.dll, f"{self.prefix}FreeInstance")
        free.restype = None
        free(self.handle)


Logger = Callable[[int, str], None]


class CoSimulation(FmiFunctions):
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


class Version2(FmiFunctions):
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
            log(status, (message or b"").decode(errors="replace").strip())

    _receiver: Any = fmi2.fmi2CallbackLoggerTYPE(_receive)


class Version3(FmiFunctions):
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
