"""FMPy's classes of FMUs, for libraries that lack functions too: one that is missing matters when it is needed."""

from __future__ import annotations

import atexit
import ctypes
import sys
from collections.abc import Mapping
from functools import cache
from types import SimpleNamespace
from typing import Any

from fmpy import fmi2, fmi3


class _Absent:
    """Stands for a function that a library does not have."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, *arguments: Any) -> Any:
        raise AttributeError(absent(self._name))


class _Blank:
    """Stands for a library, to be told of its functions."""

    def __getattr__(self, name: str) -> Any:
        return SimpleNamespace()


def absent(name: str) -> str:
    """That a library does not have a function, for messages."""
    return f"its library has no function {name}"


class _Lenient:
    dll: Any
    _functions: dict[str, Any]
    _known: Mapping[str, SimpleNamespace] = {}  # names and types of C, which FMPy takes from each of its methods anew

    def _loadFunctions(self) -> None:  # noqa: N802 - FMPy's name
        if sys.platform == "linux" and hasattr(self.dll, "finalizePythonInterpreter"):
            _release_at_exit(self.dll._name)
        if not self._known:
            library, self.dll = self.dll, _Blank()
            super()._loadFunctions()  # type: ignore[misc]
            type(self)._known, self.dll = dict(self._functions), library
        for name, told in self._known.items():
            function: Any = getattr(self.dll, name, None) or _Absent(name)
            self._functions[name] = function
            function.argnames = told.argnames
            function.argtypes, function.restype = told.argtypes, told.restype


@cache
def _release_at_exit(library: str) -> None:
    """Have pythonfmu 0.7 let go of Python as Python ends: later, as the process does, it writes into freed memory."""
    atexit.register(ctypes.CDLL(library).finalizePythonInterpreter)


def _lenient(kind: Any) -> Any:
    """FMPy's class so changed, under the same name, for FMPy tells versions apart by it."""
    return type(kind.__name__, (_Lenient, kind), {})


FMU2Slave, FMU2Model = _lenient(fmi2.FMU2Slave), _lenient(fmi2.FMU2Model)
FMU3Slave, FMU3Model = _lenient(fmi3.FMU3Slave), _lenient(fmi3.FMU3Model)
