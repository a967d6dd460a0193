"""The functions of an FMU behind one face: what FMI 2.0 and 3.0 call differently is told in their own files.

FMPy loads, instantiates and frees; values and steps go straight to the FMU's functions with prepared arguments, because
that is where a simulation spends its time.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import cached_property, lru_cache
from typing import Any

from fmpy.model_description import ModelDescription

from fmus.errors import FmuError, FmuFileError
from fmus.modelling.instance import REFUSED
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.library import absent
from orchestrator.fmi.interface import TANGENT, Port

DISCARD = FAILED = 2  # status discard, and worse
_VENDOR = "servotwin"  # what names of functions begin with that FMI does not have, before its version
FATAL = 4  # no function of the FMU may be called again
TROUBLE = frozenset({*(f"logStatus{kind}" for kind in ("Warning", "Discard", "Error", "Fatal")), REFUSED})  # categories
Logger = Callable[[int, str, str], None]  # status, category, message


@lru_cache(maxsize=16)
def limits(truth: Any, start: float, stop: float | None, tolerance: float | None) -> tuple[Any, ...]:
    """What an FMU is told of a run before it, in the types of C."""
    double = ctypes.c_double
    told = (truth(tolerance is not None), double(tolerance or 0.0), double(start))
    return (*told, truth(stop is not None), double(stop or 0.0))


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

    def __init__(self, fmu: FmuFile, name: str, log: Logger) -> None:
        self.description = fmu.description
        self.fmu = self.kind(
            guid=fmu.description.guid,
            unzipDirectory=str(fmu.folder),
            modelIdentifier=fmu.identifier,
            instanceName=name,
        )
        self._log = log
        self.handle = ctypes.c_void_p()
        self.instantiate()

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

    def log_trouble(self) -> None:
        """Ask for messages about trouble, where the FMU keeps them apart from the rest."""
        wanted = [category.name for category in self.description.logCategories if category.name in TROUBLE]
        if wanted and self.has("SetDebugLogging"):
            names = (ctypes.c_char_p * len(wanted))(*(name.encode() for name in wanted))
            self.call("SetDebugLogging", True, ctypes.c_size_t(len(wanted)), names)

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
