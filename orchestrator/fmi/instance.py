"""One running FMU, version 2.0 or 3.0: its life cycle, its values, and its errors."""

from __future__ import annotations

import ctypes
import logging
import math
import os
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Generic, TypeVar

from fmus.errors import FmuError, FmuFileError
from orchestrator import last_words
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions import DISCARD, FAILED, FATAL, FmiFunctions, VariableGroup
from orchestrator.fmi.interface import Port, Value

LOG = logging.getLogger("servotwin.fmu")
STATUS = ("OK", "warning", "discard", "error", "fatal error", "pending")
# Errors are raised with what the FMU said, so their messages need no louder place in the log.
_LEVELS = (logging.DEBUG, logging.WARNING, logging.INFO, logging.INFO, logging.INFO, logging.DEBUG)
_TROUBLE = frozenset(f"logStatus{kind}" for kind in ("Warning", "Discard", "Error", "Fatal"))


A = TypeVar("A", bound=FmiFunctions)


class FmuInstance(Generic[A]):
    """An instance of an FMU; see `Component` for the meaning of the methods. How it steps is for subclasses to say.

    Attributes:
        versions: the FMU's functions, for FMI 2 and 3.
        tolerance: relative tolerance of the solver that integrates its states, where that is not its own.

    Raises (any method):
        FmuError: the FMU returned discard, error or fatal; the message carries what it logged.
    """

    versions: tuple[type[A], type[A]]
    tolerance: float | None = None

    def __init__(self, fmu: FmuFile, name: str, *, debug_log: bool = False) -> None:
        self.name = name
        self.interface = fmu.interface
        self.warnings = 0
        self._messages: deque[str] = deque(maxlen=20)
        self._given: dict[str, Value] = {}
        self._sizes = frozenset(port.name for port in fmu.interface.of("structuralParameter"))
        self._alive = False
        self._known_as = last_words.OURS if fmu.is_ours else last_words.FMU, f"{name} ({fmu.path})"
        last_words.own().say(*self._known_as)
        functions: Any = self.versions[fmu.interface.fmi_version.startswith("3")]
        try:
            with _same_folder():
                self._fmi: A = functions(fmu, name, self._log, debug_log)
        except Exception as error:
            raise self._failure("instantiate", str(error)) from error
        self._alive = True
        self._log_errors(fmu, debug_log)
        self._groups: dict[tuple[str, ...], VariableGroup] = {}
        self._inputs = self._outputs = self._given_group = self._group()
        self._configure()

    def set(self, values: Mapping[str, Value]) -> None:
        given = {**self._given, **values}
        for name in given.keys() & self._sizes:
            del given[name]
        self._given_group = group = self._group(*given)
        if not group.floats or {type(value) for value in given.values()} != {float}:
            given = {name: self._port(name).typed(f"{self.name}.{name}", value) for name, value in given.items()}
        self._given = given
        self._inputs.keep([(self._port(name), value) for name, value in given.items()] if self._inputs.partial else ())
        if not given:
            return
        try:
            status = group.write(list(given.values()))
        except OverflowError:
            self._set_singly()
            raise
        if FAILED <= status < FATAL:
            self._messages.clear()
            self._check(self._fmi.reset(), "reset")
            self._configure()
            self._set_singly()
        if status:
            self._check(status, f"set {', '.join(self._given)}")

    def get(self, name: str) -> Value:
        """Present value of any variable."""
        status, (value,) = self._group(name).taken()
        self._check(status, f"get {name}")
        return value

    def begin(self, start: float, stop: float | None) -> None:
        self._check(self._fmi.begin(start, stop, self.tolerance), "enter initialisation")

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._inputs, self._outputs = self._group(*inputs), self._group(*outputs)

    def write(self, values: Sequence[float]) -> None:
        try:
            status = self._inputs.write(values)
        except (ValueError, OverflowError) as error:
            raise self._failure("set inputs", str(error)) from None
        if status:
            self.written(status)

    def written(self, status: int) -> None:
        """Take note of how setting the inputs went."""
        self._check(status, "set inputs")

    def read(self) -> Sequence[float]:
        status, values = self._outputs.read()
        if status:
            self.got(status)
        return values

    def got(self, status: int) -> None:
        """Take note of how getting the outputs went."""
        self._check(status, "get outputs")

    def run(self) -> None:
        self._check(self._fmi.run(), "initialise")
        if self._given:
            self._require_taken(self._given_group, self._given)
        if self.interface.sizes:
            self._require_taken(self._group(*self.interface.sizes), self.interface.sizes)

    def save(self) -> Any:
        state = ctypes.c_void_p()
        self._check(self._fmi.state("Get", ctypes.byref(state)), "save its state")
        return state

    def restore(self, state: Any) -> None:
        self._check(self._fmi.state("Set", state), "restore its state")

    def drop(self, state: Any) -> None:
        if self._alive:
            self._check(self._fmi.state("Free", ctypes.byref(state)), "free a saved state")

    def reset(self) -> None:
        if not self._alive:
            raise FmuError(self.name, "cannot run again after a fatal error", "load the FMU again")
        self._given.clear()
        self._messages.clear()
        self.warnings = 0
        self._check(self._fmi.reset(), "reset")
        self._configure()

    def close(self) -> None:
        if self._alive:
            self._alive = False
            self._fmi.free()
            last_words.own().say(*self._known_as, -1)
            last_words.own().say(last_words.GONE, self._known_as[1])

    def _configure(self) -> None:
        """Give the structural parameters their values, as the FMU's arrays have to have the interface's shapes."""
        sizes = self.interface.sizes
        if not sizes:
            return
        self._check(self._fmi.call("EnterConfigurationMode"), "enter configuration mode")
        status = self._group(*sizes).write(list(sizes.values()))
        self._check(status, f"set {', '.join(f'{name} = {value}' for name, value in sizes.items())}")
        self._check(self._fmi.call("ExitConfigurationMode"), "leave configuration mode")

    def _log_errors(self, fmu: FmuFile, debug_log: bool) -> None:
        """Ask for messages about trouble, where the FMU keeps them apart from the rest."""
        offered = [category.name for category in fmu.description.logCategories]
        wanted = offered if debug_log else [name for name in offered if name in _TROUBLE]
        if wanted and self._fmi.has("SetDebugLogging"):
            names = (ctypes.c_char_p * len(wanted))(*(name.encode() for name in wanted))
            self._fmi.call("SetDebugLogging", True, ctypes.c_size_t(len(wanted)), names)

    def _port(self, name: str) -> Port:
        try:
            return self.interface.ports[name]
        except KeyError:
            raise FmuFileError(f"{self.name}.{name}", "no such variable", "see `servotwin info`") from None

    def _group(self, *names: str) -> VariableGroup:
        """These variables, bound once."""
        if names not in self._groups:
            self._groups[names] = VariableGroup(self._fmi, [self._port(name) for name in names])
        return self._groups[names]

    def _set_singly(self) -> None:
        """Set the values one at a time, to fail at the one that does."""
        for name, value in self._given.items():
            try:
                status = self._group(name).write([value])
            except OverflowError as error:
                raise FmuFileError(f"{self.name}.{name}", str(error), "choose a value inside") from None
            self._check(status, f"set {name} = {value}")

    def _require_taken(self, group: VariableGroup, given: Mapping[str, Value]) -> None:
        """See that the FMU has the values it was given."""
        status, values = group.taken()
        if status:
            self._check(status, f"get {', '.join(given)}")
        if values == list(given.values()):
            return
        for (name, value), taken in zip(given.items(), values, strict=True):
            if value != taken and not self._close(name, value, taken):
                raise FmuError(
                    f"{self.name}.{name}",
                    f"was set to {value} but is {taken}",
                    "the FMU does not take it; remove it or ask the supplier",
                )

    def _close(self, name: str, value: Value, taken: Value) -> bool:
        """Whether two values differ by rounding only."""
        if not (isinstance(value, float) and isinstance(taken, float)):
            return False
        return math.isclose(value, taken, rel_tol=1e-6 if self._fmi.single(self._port(name)) else 1e-12)

    def _log(self, status: int, message: str) -> None:
        line = " ".join(message.split())
        self._messages.append(line)
        LOG.log(_LEVELS[status] if 0 <= status < len(_LEVELS) else logging.ERROR, "%s: %s", self.name, line)

    def _check(self, status: int, action: str, ending: str = "") -> None:
        if status == 1:
            self.warnings += 1
        elif status:
            self._alive = self._alive and status != FATAL
            returned = f"returned {STATUS[status] if 0 < status < len(STATUS) else status}"
            raise self._failure(action, ending if ending and status == DISCARD else returned)

    def _failure(self, action: str, problem: str, fix: str = "") -> FmuError:
        said = f" ({'; '.join(list(self._messages)[-3:])})" if self._messages else ""
        return FmuError(self.name, f"{action}: {problem}{said}", fix)


def stepping(time: float, duration: float) -> str:
    """What an FMU is doing that steps from a time by a duration [s], for messages."""
    return f"step from t = {time:g} s by {duration:g} s"


@contextmanager
def _same_folder() -> Iterator[None]:
    """Undo the change of the working directory that FMPy leaves behind when a library does not load."""
    here = os.getcwd()  # noqa: PTH109 - the path as it is, not resolved
    try:
        yield
    finally:
        os.chdir(here)
