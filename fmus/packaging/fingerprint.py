"""A hash that stands for values, functions and models, so that two are told apart wherever they do not do the same.

A function is what it is in memory: its code, what it holds, and the functions and constants of its file that it names.
So a model may come from a file, a notebook or another function, and nothing is traced or read again.
"""

from __future__ import annotations

import hashlib
import sys
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from types import BuiltinFunctionType, CodeType, FunctionType, ModuleType
from typing import Any

from fmus.modelling.model import Delay, State, Variable

_PLAIN = (type(None), bool, int, float, complex, str, bytes, type(...), Variable, State, Delay)


class NoFingerprintError(Exception):
    """Something that a hash cannot stand for; the message says what."""


def fingerprint(*parts: Any) -> str:
    """Hexadecimal SHA-256 of plain values, of lists, tuples, mappings and sets of them, and of functions and models.

    Raises:
        NoFingerprintError: there is something else among them, as an object that a function holds.
    """
    hashing = _Hashing()
    hashing.feed(parts)
    return hashing.digest.hexdigest()


class _Hashing:
    """Each part is fed with its type and size, so that no two sequences of parts look alike."""

    def __init__(self) -> None:
        self.digest = hashlib.sha256()
        self._seen: dict[int, int] = {}

    def feed(self, part: Any) -> None:
        if isinstance(part, bytes):
            self._text("bytes", part)
        elif isinstance(part, _PLAIN):
            self._text(type(part).__name__, repr(part).encode())
        elif isinstance(part, list | tuple):
            self._all("sequence", part)
        elif isinstance(part, Mapping):
            self._all("mapping", [*part.keys(), *part.values()])
        elif isinstance(part, frozenset | set):
            self._all("set", sorted(map(repr, part)))
        elif id(part) in self._seen:  # it may name itself
            self._text("seen", str(self._seen[id(part)]).encode())
        else:
            self._seen[id(part)] = len(self._seen)
            self._all(type(part).__name__, list(_contents(part)))

    def _all(self, kind: str, parts: list[Any] | tuple[Any, ...]) -> None:
        self._text(kind, str(len(parts)).encode())
        for part in parts:
            self.feed(part)

    def _text(self, kind: str, text: bytes) -> None:
        self.digest.update(f"{kind} {len(text)}:".encode() + text)


def _contents(part: Any) -> Iterator[Any]:
    """What makes a function, its code, a module or a model what it is."""
    if is_dataclass(part) and not isinstance(part, type) and type(part).__module__.startswith("fmus."):
        yield from (getattr(part, field.name) for field in fields(part) if field.compare)
    elif isinstance(part, CodeType):
        yield from (part.co_code, part.co_exceptiontable, part.co_flags, part.co_argcount, part.co_kwonlyargcount)
        yield from (part.co_names, part.co_varnames, part.co_cellvars, part.co_freevars, part.co_consts)
    elif isinstance(part, ModuleType | BuiltinFunctionType | FunctionType | type) and _belongs_to_a_version(part):
        yield from (getattr(part, "__module__", ""), part.__name__)
    elif isinstance(part, FunctionType):
        yield from _function(part)
    elif isinstance(getattr(part, "__wrapped__", None), FunctionType):  # of functools.cache
        yield part.__wrapped__
    else:
        raise NoFingerprintError(repr(part))


def _function(function: FunctionType) -> Iterator[Any]:
    yield from (function.__code__, function.__defaults__, function.__kwdefaults__, function.__doc__)
    yield [cell.cell_contents for cell in function.__closure__ or ()]
    known = function.__globals__
    yield {name: known[name] for name in sorted(_names(function.__code__) & known.keys())}


def _names(code: CodeType) -> set[str]:
    """Globals, and attributes, that a function names; those that the functions inside it name too."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


def _belongs_to_a_version(part: Any) -> bool:
    """Whether it is part of Python or of the language of models: a version, or the hash of files, stands for it."""
    module = part.__name__ if isinstance(part, ModuleType) else part.__module__ or "builtins"
    root = module.partition(".")[0]
    return root in sys.stdlib_module_names or (root == "fmus" and not module.startswith("fmus.models."))
