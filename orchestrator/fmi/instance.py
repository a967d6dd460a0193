"""One running FMU, version 2.0 or 3.0: its life cycle, its values, and its errors."""

from __future__ import annotations

import ctypes
import logging
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, TypeVar

from fmus.errors import FmuError, FmuFileError, ParametersRefused, WiringError
from fmus.modelling.instance import REFUSED
from orchestrator.fmi import unpacked
from orchestrator.fmi.component import Texts
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.base import DISCARD, FAILED, FATAL, FmiFunctions
from orchestrator.fmi.functions.values import VariableGroup
from orchestrator.fmi.interface import Port, Value, start_numbers
from orchestrator.fmi.said import LOG, REPEATS
from orchestrator.fmi.status import returned
from orchestrator.processes import arithmetic, last_words
from orchestrator.processes.interrupts import broken_off

# Errors are raised with what the FMU said, so their messages need no louder place in the log.
_LEVELS = (logging.DEBUG, logging.WARNING, logging.INFO, logging.INFO, logging.INFO, logging.DEBUG)
_MOST_EXACT = 256  # variables that are read back after a reset


A = TypeVar("A", bound=FmiFunctions)


class FmuInstance(Generic[A]):
    """An instance of an FMU; see `Component` for the meaning of the methods. How it steps is for subclasses to say.

    Attributes:
        versions: the FMU's functions, for FMI 2 and 3.

    Raises (any method):
        FmuError: the FMU returned discard, error or fatal; the message carries what it logged.
        ParametersRefused: on `run`, an FMU of ours has parameters that do not fit together.
    """

    versions: tuple[type[A], type[A]]

    def __init__(self, fmu: FmuFile, name: str) -> None:
        self.name = name
        self.interface = fmu.interface
        self.warnings = 0
        self._fmu = fmu
        self._copy: Path | None = None  # folder of a library that was loaded anew
        self._messages: deque[str] = deque(maxlen=20)
        self._complained = False  # has logged an error since its reset
        self._refused = ""  # which parameters do not fit together, and why
        self._given: dict[str, Value] = {}
        self._texts = Texts()
        self._given_group: VariableGroup  # the same, bound
        self._sizes = frozenset(port.name for port in fmu.interface.of("structuralParameter"))
        self._alive = self._under_way = False
        self._sound = True  # the library has given a whole run since it was loaded or an instance of it died
        self._resets, self._was_reset = True, False
        self._doubtful: set[str] = set()  # variables whose start is not what the file declares
        self._touched: set[str] = set()  # what was set in this run or an earlier one
        self._watched: dict[str, float] | None = None  # what is read after a reset, and what it has to be
        self._watched_beside: VariableGroup | None = None  # the given ones, if any
        self._bound: tuple[Sequence[str], Sequence[str]] = (), ()
        self._known_as = last_words.OURS if fmu.is_ours else last_words.FMU, f"{name} ({fmu.path})"
        last_words.own().say(*self._known_as)
        self._load()

    def set(self, values: Mapping[str, Value]) -> None:
        given = {**self._given, **values}
        if self._sizes:
            given = {name: value for name, value in given.items() if name not in self._sizes}
        group = self._group(*given)
        if group is not self._given_group:
            self._given_group = group
            self._touched |= given.keys()
        if not group.floats or set(map(type, given.values())) != {float}:
            given = {name: self._port(name).typed(f"{self.name}.{name}", value) for name, value in given.items()}
        self._given = given
        if self._inputs.partial:
            self._inputs.keep([(self._port(name), value) for name, value in given.items()])
        if not given:
            return
        try:
            status = group.write(list(given.values()))
        except OverflowError:
            self._set_singly()
            raise
        if FAILED <= status < FATAL:
            self._messages.clear()
            self._check(self._fmi.call("Reset"), "reset")
            self._configure()
            self._set_singly()
        if status:
            self._check(status, f"set {', '.join(self._given)}")

    def begins_with(self, name: str) -> Value | None:
        """The value that a variable was given, or else is declared to start from; some FMUs give none when asked."""
        port = self._port(name)
        return self._given.get(name, None if port.start is None else port.parsed(port.start))

    def get(self, name: str) -> Value:
        """Present value of any variable."""
        status, (value,) = self._group(name).taken()
        self._check(status, f"get {name}")
        return value

    def tune(self, name: str, value: Value) -> Value:
        port = self._port(name)
        array = port.array
        if array is None:
            self._check(self._group(name).write([value]), f"set {name} = {value}")
            return self.get(name)
        group = self._group(*(other.name for other in self.interface.ports.values() if other.array is array))
        status, elements = group.taken()
        self._check(status, f"get {array.name}")
        self._check(group.write([*elements[: port.element], value, *elements[port.element + 1 :]]), f"set {name}")
        return self.get(name)

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._enter(start, stop, tolerance)
        if not self._was_reset:
            return
        odd = self._not_reset()
        if odd:
            self._instantiate()
            self._group(*self._given).write(list(self._given.values()))
            self._enter(start, stop, tolerance)
            self._doubtful |= self._not_reset().keys()
            self._watched = None
            odd = {name: value for name, value in odd.items() if name not in self._doubtful}
        if odd:
            name, value = next(iter(odd.items()))
            self._distrust_reset(f"does not bring back its start values ({name} is {value:.6g} then)")

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._bound = inputs, outputs
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
        status = self._fmi.run()
        if self._refused:
            problem, _, fix = self._refused.rpartition("; ")
            raise ParametersRefused(self.name, problem or fix, fix if problem else "change one of them")
        if status == DISCARD:  # it stays in initialisation mode, from which there is no way on but a reset
            problem = f"{returned(status)}: there is no start from these values"
            raise self._failure("initialise", problem, "change its parameters, start values or first inputs")
        if status:
            self._check(status, "initialise")
        self._under_way = True
        self._set_arithmetic_back()
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

    def terminate(self) -> None:
        if not self._under_way:
            return
        self._under_way, self._sound = False, True
        if self._terminates and not broken_off():
            try:
                self._check(self._fmi.call("Terminate"), "terminate")
            except FmuError as error:
                LOG.warning("%s", error)
        self._set_arithmetic_back(
            ", by this FMU or one beside it: what was computed since may be off in its last digits"
        )

    @property
    def texts(self) -> Mapping[str, tuple[str, ...]]:
        return self._texts.known

    def news(self, counts: dict[str, int]) -> list[tuple[str, str]]:
        """Variable and text of those that are new since there were so many of each, which are counted up."""
        return self._texts.since(counts)

    def reset(self) -> bool:
        self.terminate()
        self._given = {}
        self._texts.clear()
        self._messages.clear()
        self.warnings, self._was_reset, self._complained, self._refused = 0, False, False, ""
        if not self._alive and not self._sound:
            self._load(anew=True)
            return True
        self._sound = self._sound and self._alive
        if self._alive and self._resets:
            status = self._fmi.call("Reset")
            if status < FAILED:
                self._was_reset = True
                self._configure()
                return False
            self._alive = status < FATAL
            self._distrust_reset(f"is refused ({returned(status)})")
        self._instantiate()
        return False

    def close(self) -> None:
        self.terminate()
        if self._alive:
            self._alive = False
            if not broken_off():
                self._fmi.free()
            last_words.own().say(*self._known_as, -1)
            last_words.own().say(last_words.GONE, self._known_as[1])
        if self._copy is not None:
            unpacked.give_back(self._copy)
            self._copy = None
        REPEATS.sum_up(self.name)

    def _configure(self) -> None:
        """Give the structural parameters their values, as the FMU's arrays have to have the interface's shapes."""
        sizes = self.interface.sizes
        if not sizes:
            return
        self._check(self._fmi.call("EnterConfigurationMode"), "enter configuration mode")
        status = self._group(*sizes).write(list(sizes.values()))
        self._check(status, f"set {', '.join(f'{name} = {value}' for name, value in sizes.items())}")
        self._check(self._fmi.call("ExitConfigurationMode"), "leave configuration mode")

    def _load(self, anew: bool = False) -> None:
        """Load its library and make an instance; `anew` of a copy, as loaded before nothing is left of what it was."""
        fmu = self._fmu
        try:
            if anew:
                folder, former = unpacked.take(fmu.path, alone=True), self._copy
                fmu, self._copy = copy(fmu), folder
                fmu.folder = folder
                fmu.require_binary()
                if former is not None:
                    unpacked.give_back(former)
            with unpacked.same_folder():
                self._fmi: A = self._functions(self.versions[fmu.interface.fmi_version.startswith("3")], fmu)
        except Exception as error:
            raise self._failure("instantiate", str(error)) from error
        self._alive = True
        self._set_arithmetic_back()
        self._resets, self._terminates = self._resets and self._fmi.has("Reset"), self._fmi.has("Terminate")
        self._fmi.log_trouble()
        self._groups: dict[tuple[str, ...], VariableGroup] = {}
        self._watched = None
        self._given_group = self._group()
        self.bind(*self._bound)
        self._configure()

    def _set_arithmetic_back(self, since: str = " since the FMU was called") -> None:
        """See that the processor computes as it did, and say where it did not."""
        if how := arithmetic.altered():
            undone = "this is undone" if arithmetic.set_back() else "this cannot be undone here"
            LOG.warning("%s: the processor %s%s; %s (`--isolate` keeps it to the FMU)", self.name, how, since, undone)

    def _functions(self, kind: Callable[..., A], fmu: FmuFile) -> A:
        """The functions of the FMU, with an instance made."""
        return kind(fmu, self.name, self._log)

    def _instantiate(self) -> None:
        """Take a fresh instance of the library that is loaded in the place of the present one."""
        if self._alive:
            self._alive = False
            self._fmi.free()
        try:
            self._fmi.instantiate()
        except Exception as error:
            raise self._failure("instantiate anew", str(error)) from error
        self._alive = True
        self._fmi.log_trouble()
        self._configure()

    def _enter(self, start: float, stop: float | None, tolerance: float | None) -> None:
        status = self._fmi.begin(start, stop, tolerance)
        if status:
            self._check(status, "enter initialisation")

    @cached_property
    def _exact(self) -> dict[str, float]:
        """variable -> start value that tells whether a reset works; of many, states and outputs come first."""
        ports = [port for port in self.interface.ports.values() if port.exact]
        ports.sort(key=lambda port: port.causality == "parameter")
        return start_numbers(ports[:_MOST_EXACT])

    def _not_reset(self) -> dict[str, float]:
        """Variables with another value than the one they are declared to start from, and that value."""
        given = self._given_group if self._given else None
        if self._watched is None or given is not self._watched_beside:
            beside = self._doubtful | self._given.keys()
            known = {**self._exact, **start_numbers(map(self._port, self._touched))}
            self._watched = {name: start for name, start in known.items() if name not in beside}
            self._watched_beside = given
            self._watched_group, self._watched_starts = self._group(*self._watched), [*self._watched.values()]
        if not self._watched:
            return {}
        status, values = self._watched_group.read()
        if status >= FAILED:
            self._check(status, f"get {', '.join(self._watched)}")
        if values == self._watched_starts:
            return {}
        differing = self._watched_group.differing(self.name, self._watched.values(), values)
        return {name: float(value) for name, _, value in differing}

    def _distrust_reset(self, why: str) -> None:
        """Go without resets from now on."""
        if self._resets:
            LOG.warning("%s: its reset %s; every run gets a fresh instance", self.name, why)
        self._resets = False

    def _port(self, name: str) -> Port:
        try:
            return self.interface.ports[name]
        except KeyError:
            raise FmuFileError(f"{self.name}.{name}", "no such variable", "see `servotwin info`") from None

    def _group(self, *names: str) -> VariableGroup:
        """These variables, bound once."""
        if names not in self._groups:
            self._groups[names] = VariableGroup(self._fmi, [self._port(name) for name in names], self._texts)
        return self._groups[names]

    def _set_singly(self) -> None:
        """Set the values one at a time, to fail at the one that does."""
        for name, value in self._given.items():
            try:
                status = self._group(name).write([value])
            except OverflowError as error:
                raise WiringError(f"{self.name}.{name}", str(error), "choose a value inside") from None
            self._check(status, f"set {name} = {value}")

    def _require_taken(self, group: VariableGroup, given: Mapping[str, Value]) -> None:
        """See that the FMU has the values it was given."""
        status, values = group.taken()
        if status:
            self._check(status, f"get {', '.join(given)}")
        if values == list(given.values()):
            return
        for name, value, taken in group.differing(self.name, given.values(), values):
            problem = f"was set to {value} but is {taken}"
            raise FmuError(f"{self.name}.{name}", problem, "the FMU does not take it; remove it or ask the supplier")

    def _log(self, status: int, category: str, message: str) -> None:
        line = " ".join(message.split())
        if category == REFUSED and self._fmu.is_ours:
            self._refused = line.partition(": ")[2]  # without the model's name
        self._messages.append(line)
        self._complained = self._complained or DISCARD < status <= FATAL
        LOG.log(_LEVELS[status] if 0 <= status < len(_LEVELS) else logging.ERROR, "%s: %s", self.name, line)

    def _check(self, status: int, action: str) -> None:
        if status == 1:
            self.warnings += 1
        elif status:
            self._alive = self._alive and status != FATAL
            self._under_way = self._under_way and status == DISCARD
            raise self._failure(action, returned(status))

    def _failure(self, action: str, problem: str, fix: str = "") -> FmuError:
        said = f" ({'; '.join(list(self._messages)[-3:])})" if self._messages else ""
        return FmuError(self.name, f"{action}: {problem}{said}", fix)
