"""The functions of an FMU, version 2.0 or 3.0, behind one face: what the versions call differently is here.

FMPy loads, instantiates and frees; values and steps go straight to the FMU's functions with prepared arrays, because
that is where a simulation spends its time.
"""

from __future__ import annotations

import ctypes
import itertools
import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

from fmpy import fmi2
from fmpy.model_description import ModelDescription

from fmus.errors import FmuError, FmuFileError
from orchestrator.fmi.component import Texts
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.interface import TANGENT, Port, Value
from orchestrator.fmi.library import FMU2Slave, FMU3Slave, absent

DISCARD = FAILED = 2  # status discard, and worse
ALMOST = 1 - 1e-9  # of a step that is whole but for rounding
_VENDOR = "servotwin"  # what names of functions begin with that FMI does not have, before its version
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


@lru_cache(maxsize=16)
def _limits(truth: Any, start: float, stop: float | None, tolerance: float | None) -> tuple[Any, ...]:
    """What an FMU is told of a run before it, in the types of C."""
    double = ctypes.c_double
    told = (truth(tolerance is not None), double(tolerance or 0.0), double(start))
    return (*told, truth(stop is not None), double(stop or 0.0))


def _decoded(text: bytes | None) -> str:
    return (text or b"").decode(errors="replace")


class VariableGroup:
    """Some variables of one FMU, read or written together: one call for each FMI type among them.

    Args:
        texts: gives the numbers of texts.

    Attributes:
        typed: its variables by FMI type, in the order in which they are read and written.
        floats: the only type, where that is one of floats.
        texts: the place of each text -> its variable.
        partial: whether it has elements of an array without the others.
    """

    def __init__(self, fmi: FmiFunctions, ports: Sequence[Port], texts: Texts) -> None:
        by_type: dict[str, list[int]] = {}
        for place, port in enumerate(ports):
            by_type.setdefault(fmi.storage(port.type), []).append(place)
        self._size, self._texts = len(ports), texts
        self.texts = {place: port.name for place, port in enumerate(ports) if port.type == "String"}
        self.typed = [TypedValues(fmi, kind, ports, places) for kind, places in by_type.items()]
        only = self.typed[0] if len(self.typed) == 1 else None
        self.floats = only if only is not None and only.plain else None
        self.partial = any(typed.partial for typed in self.typed)

    def write(self, values: Sequence[Value]) -> int:
        """The worst status; nothing is written where a value does not fit its type."""
        if self.floats is not None:
            self.floats.values[:] = values
            return self.floats.set(*self.floats.arguments)
        for typed in self.typed:
            typed.pack(values)
        return max((typed.set(*typed.arguments) for typed in self.typed), default=0)

    def read(self) -> tuple[int, Sequence[float]]:
        """The worst status, and the values as numbers, texts as those that stand for them."""
        if self.floats is not None:
            status = self.floats.get(*self.floats.arguments)
            return status, self.floats.values[:]
        status, values = self.taken()
        if not self.texts:
            return status, [float(value) for value in values]
        named, number = self.texts, self._texts.number
        return status, [
            number(named[place], str(value)) if place in named else float(value) for place, value in enumerate(values)
        ]

    def keep(self, given: Sequence[tuple[Port, Value]]) -> None:
        """Let the elements of arrays that it does not carry have these values, or else their start values."""
        for typed in self.typed:
            if typed.partial:
                typed.keep(given)

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
        slots: where each lies in `values`; an array goes with all its elements.
        partial: whether it has elements of an array without the others; those have what `rest` says.
        plain: whether it has one float a variable, in the order of the group.
    """

    def __init__(self, fmi: FmiFunctions, kind: str, ports: Sequence[Port], places: Sequence[int]) -> None:
        self.kind, self.places = kind, places
        self.ctype = ctype = fmi.ctype(kind)
        self._cast = _cast(ctype, kind)
        uncasts: dict[str, Callable[[Any], Value]] = {"Boolean": bool, "String": _decoded}
        self._uncast = uncasts.get(kind)
        self._fmi = fmi
        references: list[int] = []
        self._starts: list[Any] = []  # None where the file does not say
        self._first: dict[int, int] = {}  # reference of an array -> slot of its first element
        self.slots: list[int] = []
        for port in (ports[place] for place in places):
            if port.array is None or port.reference not in self._first:
                references.append(port.reference)
                self._begin(port)
            self.slots.append(self._first[port.reference] + port.element if port.array else len(self._starts) - 1)
        size = len(self._starts)
        self.partial = len(set(self.slots)) < size
        self.in_order = self.slots == list(range(size))
        self.plain = ctype in (ctypes.c_double, ctypes.c_float) and self.in_order
        self.values = (ctype * size)()
        self.references = (ctypes.c_uint * len(references))(*references)
        counts = map(ctypes.c_size_t, (len(references), *fmi.count(size)))
        self.arguments = (fmi.handle, self.references, next(counts), self.values, *counts)
        self._rest: list[Any] = []

    def _begin(self, port: Port) -> None:
        """Make room for a variable, an array with all its elements."""
        if port.array is None:
            self._starts.append(None)
            return
        self._first[port.reference] = len(self._starts)
        if port.array.starts is None:
            self._starts += [None] * math.prod(port.array.shape)
        else:
            self._starts += map(self._cast, port.array.starts)

    @cached_property
    def get(self) -> Callable[..., int]:
        """The FMU's function; it is looked for when it is needed."""
        return self._fmi.accessor("Get", self.kind)

    @cached_property
    def set(self) -> Callable[..., int]:
        """The FMU's function; it is looked for when it is needed."""
        return self._fmi.accessor("Set", self.kind)

    def keep(self, given: Iterable[tuple[Port, Value]]) -> None:
        """Let the elements of arrays that it does not carry have these values, or else their start values, or else
        what they have."""
        rest = list(self._starts)
        for port, value in given:
            if port.array is not None and port.reference in self._first:
                rest[self._first[port.reference] + port.element] = self._cast(value)
        if None in {rest[slot] for slot in set(range(len(rest))).difference(self.slots)}:
            self._require_found(self.get(*self.arguments))
            rest = [found if value is None else value for found, value in zip(self.values[:], rest, strict=True)]
        self._rest = [self._cast(0) if value is None else value for value in rest]
        self.values[:] = self._rest

    def _require_found(self, status: int) -> None:
        if status >= FAILED:
            problem = "has arrays of other sizes than its start values, and does not say what they hold"
            raise FmuFileError(self._fmi.fmu.instanceName, problem, "give or connect all their elements")

    def pack(self, values: Sequence[Value]) -> None:
        """Take its values out of those of the group."""
        packed = [self._cast(values[place]) for place in self.places]
        if self.in_order:
            self.values[:] = packed
            return
        if self.partial:
            if not self._rest:
                self.keep(())
            self.values[:] = self._rest
        for slot, value in zip(self.slots, packed, strict=True):
            self.values[slot] = value

    def unpack(self, values: list[Value]) -> None:
        """Put its values among those of the group."""
        found = self.values[:]
        for slot, place in zip(self.slots, self.places, strict=True):
            values[place] = self._uncast(found[slot]) if self._uncast else found[slot]


@dataclass(frozen=True)
class Stop:
    """That an FMU ended a step by itself.

    Attributes:
        reached: up to where it came [s].
        asked: whether it wants to be stepped no more.
    """

    reached: float
    asked: bool

    def whole(self, time: float, duration: float) -> bool:
        """Whether the step from a time by a duration [s] came to its end."""
        return self.asked and self.reached >= time + duration * ALMOST

    def __str__(self) -> str:
        return f"{'asked to stop' if self.asked else 'ended early'} at t = {self.reached:g} s"


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
    def instantiate(self) -> None:
        """Make an instance; `handle` is that of the latest one.

        Raises:
            Exception: it cannot be made.
        """

    @abstractmethod
    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        """Enter initialisation; times in seconds, the relative tolerance of its solver or of the one outside. The
        status."""

    def accessor(self, verb: str, kind: str) -> Callable[..., int]:
        """The function that gets or sets values, to be called with arguments in C's types: to convert them takes longer
        than the call."""
        if kind == TANGENT:
            return self.vendor(f"{verb}Tangents")
        name = f"{verb}{kind}"
        self.function(name)
        untyped: Callable[..., int] = self.fmu.dll[self.prefix + name]
        return untyped

    def ctype(self, kind: str) -> Any:
        """C type of a value."""
        if kind == TANGENT:
            return ctypes.c_double
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

    def call(self, name: str, *arguments: Any) -> int:
        """A function that takes the instance first, by the end of its name."""
        function = self._called.get(name) or self._called.setdefault(name, self.function(name))
        status: int = function(self.handle, *arguments)
        return status

    @cached_property
    def _called(self) -> dict[str, Callable[..., int]]:
        """Functions that were called, by the end of their names: to find one takes longer than to call it."""
        return {}

    def has(self, name: str) -> bool:
        """Whether there is a function of this name, without the prefix."""
        return hasattr(self.fmu.dll, self.prefix + name)

    def function(self, name: str) -> Any:
        """The function of this name, without the prefix.

        Raises:
            FmuError: the library does not have it.
        """
        found = getattr(self.fmu.dll, self.prefix + name, None)
        if found is None:
            raise FmuError(self.fmu.instanceName, absent(self.prefix + name), "ask its supplier for a whole one")
        return found

    @property
    def carries(self) -> bool:
        """Whether the library has the functions that carry tangents."""
        return hasattr(self.fmu.dll, f"{_VENDOR}{self.prefix[-1]}CarryTangents")

    def vendor(self, name: str) -> Callable[..., int]:
        """The function of this name that only FMUs of the library have."""
        found: Callable[..., int] = self.fmu.dll[f"{_VENDOR}{self.prefix[-1]}{name}"]
        return found

    def state(self, verb: str, argument: Any) -> int:
        """Get, Set or Free a snapshot of the whole state."""
        return self.call(f"{verb}{self.state_name}", argument)

    def free(self) -> None:
        """Free the instance; the library stays loaded, since unloading it breaks some of them."""
        if not self.has("FreeInstance"):
            return
        free = self.function("FreeInstance")
        free.restype = None
        free(self.handle)


Logger = Callable[[int, str], None]


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
    def stop(self, status: int, time: float) -> Stop | None:
        """How the FMU itself ended the step from a time [s] that returned this status, None where it did not."""


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
        self._log, self._debug_log, self._ticket = log, debug_log, 0
        self.handle = ctypes.c_void_p()
        self.instantiate()

    def instantiate(self) -> None:
        Fmi2Logging.forget(self._ticket)
        self._ticket = Fmi2Logging.register(self._log)
        try:
            self.fmu.instantiate(callbacks=Fmi2Logging.callbacks(self._ticket), loggingOn=self._debug_log)
        except Exception:
            Fmi2Logging.forget(self._ticket)
            raise
        self.handle.value = self.fmu.component

    def storage(self, kind: str) -> str:
        return "Integer" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return ()

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        status = self.call("SetupExperiment", *_limits(ctypes.c_int, start, stop, tolerance))
        return status if status >= FAILED else max(status, self.call("EnterInitializationMode"))

    def free(self) -> None:
        super().free()
        Fmi2Logging.forget(self._ticket)


class Fmi2(Version2, CoSimulation):
    kind = FMU2Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        super().__init__(fmu, name, log, debug_log)
        self.asked, self.reached = ctypes.c_int(), ctypes.c_double()
        self.do_step = self.function("DoStep")
        self.do_step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        self.do_step.restype = ctypes.c_int

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, 1))

    def stop(self, status: int, time: float) -> Stop | None:
        if status != DISCARD or not (self.has("GetBooleanStatus") and self.has("GetRealStatus")):
            return None
        self.asked.value, self.reached.value = 0, time
        self.call("GetBooleanStatus", fmi2.fmi2Terminated, ctypes.byref(self.asked))
        self.call("GetRealStatus", fmi2.fmi2LastSuccessfulTime, ctypes.byref(self.reached))
        return Stop(self.reached.value, True) if self.asked.value else None


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

        self._receive, self._debug_log = receive, debug_log
        self.handle = ctypes.c_void_p()
        self.instantiate()

    def instantiate(self) -> None:
        self.fmu.instantiate(loggingOn=self._debug_log, logMessage=self._receive)
        self.handle.value = self.fmu.component

    def storage(self, kind: str) -> str:
        return "Int64" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return (number,)

    def begin(self, start: float, stop: float | None, tolerance: float | None) -> int:
        return self.call("EnterInitializationMode", *_limits(ctypes.c_bool, start, stop, tolerance))


class Fmi3(Version3, CoSimulation):
    kind = FMU3Slave

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        super().__init__(fmu, name, log, debug_log)
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

    def step(self, time: float, duration: float) -> int:
        return int(self.do_step(self.handle, time, duration, True, *self._results))

    def stop(self, status: int, time: float) -> Stop | None:
        _, asked, early = (flag.value for flag in self.flags)
        return Stop(self.reached.value, asked) if status < FAILED and (asked or early) else None
