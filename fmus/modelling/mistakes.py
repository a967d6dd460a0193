"""What a model's file has wrong: file, line and mistake behind an error that Python or SymPy raised there."""

from __future__ import annotations

import ast
import traceback
from collections.abc import Callable, Iterable
from difflib import get_close_matches
from linecache import getline
from typing import Any

from fmus.errors import ModelError
from fmus.modelling import ops

# What cannot be traced, as it stands in a line -> how it is said with `ops`.
_INSTEAD: tuple[tuple[tuple[type[ast.AST], ...], str, str], ...] = (
    ((ast.If, ast.IfExp), "`if`", "write ops.where(condition, a, b)"),
    ((ast.While,), "`while`", "write what it computes as one expression; a loop must not depend on values"),
    ((ast.And, ast.Or), "`and` or `or`", "write ops.both(a, b), or ops.where twice"),
    ((ast.Not,), "`not`", "turn the comparison round"),
    ((ast.Assert,), "`assert`", "give the model a Requirement"),
)
_PLAIN = "use only fmus.ops and arithmetic"
_CALLS = {
    "max": "maximum",
    "min": "minimum",
    "abs": "absolute",
    "round": "floor",
    "float": "",
    "int": "floor",
    "bool": "",
}


def in_file(path: str, error: Exception) -> ModelError:
    """The error as one of the model file at `path`, which was being read."""
    line = _line(path, error)
    return ModelError(path if line is None else f"{path}:{line}", *_said(error, "", "correct the file"))


def in_function(function: Callable[..., Any], arguments: str, error: Exception) -> ModelError:
    """The error as one of a model's function, which was being traced with `arguments`, such as "t, x, u, p"."""
    code = function.__code__
    line = _line(code.co_filename, error)
    if line is None:
        return ModelError(at(function), str(error), f"define it as {code.co_name}({arguments})")
    return ModelError(f"{code.co_filename}:{line}", *_said(error, getline(code.co_filename, line), _PLAIN))


def at(function: Callable[..., Any]) -> str:
    """Where a function of a model is written, as `file:line name`."""
    code = function.__code__
    return f"{code.co_filename}:{code.co_firstlineno}, {code.co_name}"


def likely(name: str, known: Iterable[str]) -> str:
    """A hint to a name that is nearly this one, or to all there are."""
    names = sorted(known)
    near = get_close_matches(name, names, 1)
    return f"did you mean '{near[0]}'?" if near else f"there are {', '.join(names) or 'none'}"


def _line(path: str, error: Exception) -> int | None:
    """The last line of the file on the way to the error."""
    if isinstance(error, SyntaxError):
        return error.lineno
    lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == path]
    return lines[-1] if lines else None


def _said(error: Exception, source: str, fix: str) -> tuple[str, str]:
    """What is wrong, and what to do where nothing better is known than `fix`."""
    if isinstance(error, SyntaxError):
        return f"is no Python: {error.msg}", "correct the line"
    if isinstance(error, AttributeError) and error.name:
        return _unknown(error.name, error.obj)
    if isinstance(error, NameError) and error.name:
        return f"'{error.name}' is not known", "define it; functions are in ops"
    found = _untraceable(source)
    if found:
        return found
    if isinstance(error, ZeroDivisionError):
        return "divides by zero", "correct the expression, or the parameters' defaults"
    return str(error) if isinstance(error, ValueError) else f"{type(error).__name__}: {error}", fix


def _unknown(name: str, holder: Any) -> tuple[str, str]:
    if holder is None:
        return f"uses .{name} of nothing", "see that each function returns its values"
    known = [known for known in vars(holder) if not known.startswith("_")] if hasattr(holder, "__dict__") else []
    what = getattr(holder, "__name__", "").rpartition(".")[2] or "the model"
    return f"{what} has no '{name}'", likely(name, known)


def _untraceable(source: str) -> tuple[str, str] | None:
    """What a line says that expressions cannot, and how it is said with `ops`."""
    nodes = list(ast.walk(_parsed(source.strip())))
    for kinds, word, fix in _INSTEAD:
        if any(isinstance(node, kinds) for node in nodes):
            return f"{word} needs a value, and an expression has none yet", fix
    for node in nodes:
        if isinstance(node, ast.Call):
            found = _call(node.func)
            if found:
                return found
    return None


def _call(function: ast.expr) -> tuple[str, str] | None:
    if isinstance(function, ast.Attribute) and isinstance(function.value, ast.Name) and function.value.id == "math":
        known = function.attr in vars(ops)
        return f"math.{function.attr} takes numbers only", f"write ops.{function.attr}" if known else _PLAIN
    if isinstance(function, ast.Name) and function.id in _CALLS:
        instead = _CALLS[function.id]
        return f"{function.id}() takes numbers only", f"write ops.{instead}" if instead else "leave it out"
    return None


def _parsed(line: str) -> ast.AST:
    """A line by itself, also one that begins a block."""
    for text in (line, f"{line} pass", f"if x:\n pass\n{line} pass", line.removeprefix("return ").rstrip(",")):
        try:
            return ast.parse(text)
        except SyntaxError:
            continue
    return ast.Module([], [])
