"""One running FMU, version 2.0 or 3.0: its life cycle, its values, and its errors.

FMPy loads, instantiates and frees; values and steps go straight to the FMU's functions with prepared arrays, because
that is where a simulation spends its time.
"""

from __future__ import annotations

import ctypes
import itertools
import logging
import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

from fmpy import fmi2, fmi3

from fmus.errors import FmuError, FmuFileError
from orchestrator.fmu_file import FmuFile, Interface, Port

Value = float | int | bool | str
LOG = logging.getLogger("servotwin.fmu")
STATUS = ("OK", "warning", "discard", "error", "fatal error", "pending")
_LEVELS = (logging.DEBUG, logging.WARNING, logging.ERROR, logging.ERROR, logging.ERROR, logging.DEBUG)
_TROUBLE = frozenset(f"logStatus{kind}" for kind in ("Warning", "Discard", "Error", "Fatal"))
_FAILED = 2  # discard and worse


class Component(Protocol):
    """What the engine needs of a component; FMUs and scripted stand-ins alike.

    Life cycle: set*, begin, (write, read)*, run, (write, step, read)*, then reset or close.
    """

    name: str
    interface: Interface

    def set(self, values: Mapping[str, Value]) -> None:
        """Give parameters and start values; each is read back when the initialisation is over."""

    def begin(self, start: float, stop: float | None) -> None:
        """Enter initialisation; times in seconds."""

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        """Say which values `write` and `read` carry, in which order."""

    def write(self, values: Sequence[float]) -> None:
        """Set the bound inputs."""

    def read(self) -> Sequence[float]:
        """Values of the bound outputs."""

    def run(self) -> None:
        """Leave initialisation."""

    def step(self, time: float, duration: float) -> None:
        """Advance from `time` by `duration` [s]."""

    def save(self) -> Any:
        """A snapshot of the whole state."""

    def restore(self, state: Any) -> None:
        """Go back to a snapshot."""

    def drop(self, state: Any) -> None:
        """Free a snapshot."""

    def reset(self) -> None:
        """Back to where `begin` is allowed, all values at their defaults."""

    def close(self) -> None:
        """Free everything."""


class Slave:
    """An instance of an FMU; see `Component` for the meaning of the methods.

    Raises (any method):
        FmuError: the FMU returned discard, error or fatal; the message carries what it logged.
    """

    def __init__(self, fmu: FmuFile, name: str, *, debug_log: bool = False) -> None:
        self.name = name
        self.interface = fmu.interface
        self.warnings = 0
        self._messages: deque[str] = deque(maxlen=20)
        self._given: dict[str, Value] = {}
        self._alive = False
        adapter = _Fmi3 if fmu.interface.fmi_version.startswith("3") else _Fmi2
        try:
            self._fmi: _Adapter = adapter(fmu, name, self._log, debug_log)
        except Exception as error:
            raise self._failure("instantiate", str(error)) from error
        self._alive = True
        self._log_errors(fmu, debug_log)
        self._inputs = self._outputs = _Channel(self._fmi, ())

    def set(self, values: Mapping[str, Value]) -> None:
        for name, value in values.items():
            port = self._port(name)
            typed = _typed(self.name, port, value)
            self._check(self._fmi.set_one(port, typed), f"set {name} = {value}")
            self._given[name] = typed

    def get(self, name: str) -> Value:
        """Present value of any variable."""
        status, value = self._fmi.get_one(self._port(name))
        self._check(status, f"get {name}")
        return value

    def begin(self, start: float, stop: float | None) -> None:
        self._check(self._fmi.begin(start, stop), "enter initialisation")

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._inputs = _Channel(self._fmi, [self._port(name) for name in inputs])
        self._outputs = _Channel(self._fmi, [self._port(name) for name in outputs])

    def write(self, values: Sequence[float]) -> None:
        status = self._inputs.write(values)
        if status:
            self._check(status, "set inputs")

    def read(self) -> Sequence[float]:
        status, values = self._outputs.read()
        if status:
            self._check(status, "get outputs")
        return values

    def run(self) -> None:
        self._check(self._fmi.run(), "initialise")
        for name, value in self._given.items():
            self._require_taken(name, value)

    def step(self, time: float, duration: float) -> None:
        status = self._fmi.step(time, duration)
        if status:
            self._check(status, f"step from t = {time:g} s by {duration:g} s")

    def save(self) -> Any:
        return self._fmi.save()

    def restore(self, state: Any) -> None:
        self._fmi.restore(state)

    def drop(self, state: Any) -> None:
        self._fmi.drop(state)

    def reset(self) -> None:
        self._given.clear()
        self._messages.clear()
        self._check(self._fmi.reset(), "reset")

    def close(self) -> None:
        if self._alive:
            self._alive = False
            self._fmi.free()

    def _log_errors(self, fmu: FmuFile, debug_log: bool) -> None:
        """Ask for messages about trouble, where the FMU keeps them apart from the rest."""
        offered = [category.name for category in fmu.description.logCategories]
        wanted = offered if debug_log else [name for name in offered if name in _TROUBLE]
        if wanted:
            names = (ctypes.c_char_p * len(wanted))(*(name.encode() for name in wanted))
            self._fmi.call("SetDebugLogging", True, ctypes.c_size_t(len(wanted)), names)

    def _port(self, name: str) -> Port:
        try:
            return self.interface.ports[name]
        except KeyError:
            raise FmuFileError(f"{self.name}.{name}", "no such variable", "see `servotwin info`") from None

    def _require_taken(self, name: str, value: Value) -> None:
        taken = self.get(name)
        if isinstance(value, float) and isinstance(taken, float):
            same = math.isclose(value, taken, rel_tol=1e-6 if self._fmi.single(self._port(name)) else 1e-12)
        else:
            same = value == taken
        if not same:
            raise FmuError(f"{self.name}.{name}", f"was set to {value} but is {taken}",
                           "the FMU does not take it; remove it or ask the supplier")  # fmt: skip

    def _log(self, status: int, message: str) -> None:
        self._messages.append(message)
        LOG.log(_LEVELS[status], "%s: %s", self.name, message)

    def _check(self, status: int, action: str) -> None:
        if status == 1:
            self.warnings += 1
        elif status >= _FAILED:
            raise self._failure(action, f"returned {STATUS[status] if status < len(STATUS) else status}")

    def _failure(self, action: str, problem: str) -> FmuError:
        said = f" ({'; '.join(list(self._messages)[-3:])})" if self._messages else ""
        return FmuError(self.name, f"{action}: {problem}{said}")


def _typed(component: str, port: Port, value: Value) -> Value:
    """The value in the port's type; names of enumeration items are looked up."""
    place = f"{component}.{port.name}"
    if port.type == "String":
        return str(value)
    if isinstance(value, str):
        if port.items is None or value not in port.items:
            known = ", ".join(port.items) if port.items else f"a {port.type}"
            raise FmuFileError(place, f"cannot be '{value}'", f"give {known}")
        return port.items[value]
    if port.type == "Boolean":
        return bool(value)
    if port.type in ("Real", "Float64", "Float32"):
        return float(value)
    if int(value) != value:
        raise FmuFileError(place, f"is of type {port.type}, {value} is not whole", "give a whole number")
    return int(value)


class _Channel:
    """Some variables of one FMU, read or written together: one call for each FMI type among them."""

    def __init__(self, fmi: _Adapter, ports: Sequence[Port]) -> None:
        by_type: dict[str, list[int]] = {}
        for position, port in enumerate(ports):
            by_type.setdefault(fmi.storage(port.type), []).append(position)
        self._size = len(ports)
        self._groups = [
            _Group(fmi, kind, [ports[i].reference for i in places], places) for kind, places in by_type.items()
        ]
        self._single = self._groups[0] if len(self._groups) == 1 else None

    def write(self, values: Sequence[float]) -> int:
        worst = 0
        for group in self._groups:
            group.values[:] = [group.cast(values[i]) for i in group.places]
            worst = max(worst, group.set(*group.arguments))
        return worst

    def read(self) -> tuple[int, Sequence[float]]:
        if self._single is not None:
            status = self._single.get(*self._single.arguments)
            return status, self._single.values[:]
        result, worst = [0.0] * self._size, 0
        for group in self._groups:
            worst = max(worst, group.get(*group.arguments))
            for place, value in zip(group.places, group.values, strict=True):
                result[place] = float(value)
        return worst, result


class _Group:
    """Variables of one type: prepared arguments for the FMU's get and set functions."""

    def __init__(self, fmi: _Adapter, kind: str, references: Sequence[int], places: Sequence[int]) -> None:
        self.places = places
        ctype = fmi.types[kind]
        self.cast: Callable[[float], Any] = float if ctype in (ctypes.c_double, ctypes.c_float) else round
        if ctype is ctypes.c_bool:
            self.cast = bool
        self.values = (ctype * len(references))()
        vrs = (ctypes.c_uint * len(references))(*references)
        self.arguments = (fmi.handle, vrs, len(references), self.values, *fmi.count(len(references)))
        self.get = fmi.accessor("Get", kind)
        self.set = fmi.accessor("Set", kind)


class _Adapter:
    """What differs between FMI 2.0 and 3.0, behind one face."""

    prefix: str
    types: Mapping[str, Any]
    fmu: Any
    handle: ctypes.c_void_p

    def storage(self, kind: str) -> str:
        """Type whose get and set functions serve this type."""
        raise NotImplementedError

    def count(self, number: int) -> tuple[int, ...]:
        """Extra arguments of get and set: the number of values, where the version wants it."""
        raise NotImplementedError

    def begin(self, start: float, stop: float | None) -> int:
        raise NotImplementedError

    def step(self, time: float, duration: float) -> int:
        raise NotImplementedError

    def accessor(self, verb: str, kind: str) -> Callable[..., int]:
        function = getattr(self.fmu.dll, f"{self.prefix}{verb}{kind}")
        pointer = ctypes.POINTER(self.types[kind])
        extra = [ctypes.c_size_t] * len(self.count(0))
        function.argtypes = [ctypes.c_void_p, ctypes.POINTER(ctypes.c_uint), ctypes.c_size_t, pointer, *extra]
        function.restype = ctypes.c_int
        return function

    def single(self, port: Port) -> bool:
        """Whether the variable is kept in single precision."""
        return self.types[self.storage(port.type)] is ctypes.c_float

    def set_one(self, port: Port, value: Value) -> int:
        group = _Group(self, self.storage(port.type), [port.reference], [0])
        group.values[0] = value.encode() if isinstance(value, str) else value
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

    def save(self) -> ctypes.c_void_p:
        state = ctypes.c_void_p()
        self._state_call("Get", ctypes.byref(state))
        return state

    def restore(self, state: ctypes.c_void_p) -> None:
        self._state_call("Set", state)

    def drop(self, state: ctypes.c_void_p) -> None:
        self._state_call("Free", ctypes.byref(state))

    def _state_call(self, verb: str, argument: Any) -> None:
        status = self.call(f"{verb}{self.state_name}", argument)
        if status >= _FAILED:
            raise FmuError(self.fmu.instanceName, f"{verb.lower()} state returned {STATUS[status]}",
                           "it claims canGetAndSetFMUstate; ask the supplier")  # fmt: skip

    state_name: str

    def free(self) -> None:
        """Free the instance; the library stays loaded, since unloading it breaks some of them."""
        free = getattr(self.fmu.dll, f"{self.prefix}FreeInstance")
        free.restype = None
        free(self.handle)


Logger = Callable[[int, str], None]


class _Fmi2(_Adapter):
    prefix = "fmi2"
    state_name = "FMUstate"
    types = {
        "Real": ctypes.c_double,
        "Integer": ctypes.c_int,
        "Boolean": ctypes.c_int,
        "String": ctypes.c_char_p,
    }

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        self.fmu = fmi2.FMU2Slave(
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.identifier,
            instanceName=name,
        )
        self._ticket = _Fmi2Logging.register(log)
        self.fmu.instantiate(callbacks=_Fmi2Logging.callbacks(self._ticket), loggingOn=debug_log)
        self.handle = ctypes.c_void_p(self.fmu.component)
        self._step = self.fmu.dll.fmi2DoStep
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_int]
        self._step.restype = ctypes.c_int

    def storage(self, kind: str) -> str:
        return "Integer" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return ()

    def begin(self, start: float, stop: float | None) -> int:
        status = int(self.fmu.fmi2SetupExperiment(self.handle, 0, 0.0, start, stop is not None, stop or 0.0))
        return max(status, self.call("EnterInitializationMode"))

    def step(self, time: float, duration: float) -> int:
        return int(self._step(self.handle, time, duration, 1))

    def free(self) -> None:
        super().free()
        _Fmi2Logging.forget(self._ticket)


class _Fmi2Logging:
    """FMPy formats the variadic messages of FMI 2.0 in C and hands them to one Python function; it sorts them by
    instance."""

    _tickets = itertools.count(1)
    _loggers: dict[int, Logger] = {}
    _template: fmi2.fmi2CallbackFunctions | None = None

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
        if cls._template is None:
            from fmpy.logging import addLoggerProxy  # noqa: PLC0415 - loads a library

            cls._template = fmi2.fmi2CallbackFunctions()
            cls._template.logger = cls._receive
            cls._template.allocateMemory = fmi2.defaultCallbacks.allocateMemory
            cls._template.freeMemory = fmi2.defaultCallbacks.freeMemory
            addLoggerProxy(ctypes.byref(cls._template))
        own = fmi2.fmi2CallbackFunctions.from_buffer_copy(cls._template)
        own.componentEnvironment = ticket
        return own

    @fmi2.fmi2CallbackLoggerTYPE
    @staticmethod
    def _receive(environment: int, instance: bytes, status: int, category: bytes, message: bytes) -> None:
        log = _Fmi2Logging._loggers.get(environment)
        if log is not None:
            log(status, (message or b"").decode(errors="replace").strip())


class _Fmi3(_Adapter):
    prefix = "fmi3"
    state_name = "FMUState"
    types = {
        "Float64": ctypes.c_double, "Float32": ctypes.c_float, "Boolean": ctypes.c_bool, "String": ctypes.c_char_p,
        **{f"{u}Int{bits}": getattr(ctypes, f"c_{u.lower()}int{bits}") for bits in (8, 16, 32, 64) for u in ("", "U")},
    }  # fmt: skip

    def __init__(self, fmu: FmuFile, name: str, log: Logger, debug_log: bool) -> None:
        self.fmu = fmi3.FMU3Slave(
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.identifier,
            instanceName=name,
        )

        def receive(environment: int, status: int, category: bytes, message: bytes) -> None:
            log(status, (message or b"").decode(errors="replace").strip())

        self.fmu.instantiate(loggingOn=debug_log, logMessage=receive)
        self.handle = ctypes.c_void_p(self.fmu.component)
        self._flags = [ctypes.c_bool() for _ in range(3)]
        self._reached = ctypes.c_double()
        self._step = self.fmu.dll.fmi3DoStep
        self._step.restype = ctypes.c_int
        self._step.argtypes = [ctypes.c_void_p, ctypes.c_double, ctypes.c_double, ctypes.c_bool,
                               *[ctypes.POINTER(ctypes.c_bool)] * 3, ctypes.POINTER(ctypes.c_double)]  # fmt: skip
        self._results = [*map(ctypes.byref, self._flags), ctypes.byref(self._reached)]

    def storage(self, kind: str) -> str:
        return "Int64" if kind == "Enumeration" else kind

    def count(self, number: int) -> tuple[int, ...]:
        return (number,)

    def begin(self, start: float, stop: float | None) -> int:
        return int(self.fmu.fmi3EnterInitializationMode(self.handle, False, 0.0, start, stop is not None, stop or 0.0))

    def step(self, time: float, duration: float) -> int:
        status = int(self._step(self.handle, time, duration, True, *self._results))
        terminated = self._flags[1].value
        if status < _FAILED and (terminated or self._flags[2].value):
            raise FmuError(self.fmu.instanceName, f"ended the step from {time:g} s early at {self._reached.value:g} s"
                           + (" and asked to stop" if terminated else ""), "shorten the run or the step")  # fmt: skip
        return status
