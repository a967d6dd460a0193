"""FMPy's classes of FMUs, for libraries that lack functions too: one that is missing matters when it is needed."""

from __future__ import annotations

from typing import Any

from fmpy import fmi2, fmi3


class _Absent:
    """Stands for a function that a library does not have."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __call__(self, *arguments: Any) -> Any:
        raise AttributeError(absent(self._name))


class _Forgiving:
    """A library that has every function."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def __getattr__(self, name: str) -> Any:
        return getattr(self._library, name, None) or _Absent(name)


def absent(name: str) -> str:
    """That a library does not have a function, for messages."""
    return f"its library has no function {name}"


class _Lenient:
    dll: Any

    def _loadFunctions(self) -> None:  # noqa: N802 - FMPy's name
        library, self.dll = self.dll, _Forgiving(self.dll)
        super()._loadFunctions()  # type: ignore[misc]
        self.dll = library


def _lenient(kind: Any) -> Any:
    """FMPy's class so changed, under the same name, for FMPy tells versions apart by it."""
    return type(kind.__name__, (_Lenient, kind), {})


FMU2Slave, FMU2Model = _lenient(fmi2.FMU2Slave), _lenient(fmi2.FMU2Model)
FMU3Slave, FMU3Model = _lenient(fmi3.FMU3Slave), _lenient(fmi3.FMU3Model)
