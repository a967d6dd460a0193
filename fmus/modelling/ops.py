"""The few maths functions that models may call: float, array or symbol in, the same out.

The file stands alone (it travels inside every Python FMU): NumPy and SymPy are only used when a caller brings their
values, never imported for plain floats. A model that sticks to these functions and to + - * / ** and comparisons can
be run, vectorised and traced into C.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Sequence
from typing import Any

Quantity = Any  # float, NumPy array or SymPy expression


def _foreign(*values: Quantity) -> Any:
    """The library these values belong to (numpy or sympy), None for plain numbers."""
    for value in values:
        if type(value) in (float, int, bool):
            continue
        if hasattr(type(value), "free_symbols"):  # of an expression itself they would be gathered
            return sys.modules["sympy"]
        if hasattr(value, "__array__"):
            return sys.modules["numpy"]
    return None


def _unary(name: str, on_float: Callable[[float], float], in_sympy: str = "") -> Callable[[Quantity], Quantity]:
    def apply(x: Quantity) -> Quantity:
        if type(x) is float:
            return on_float(x)
        library = _foreign(x)
        if library is None:
            return on_float(x)
        if library.__name__ == "sympy":
            return getattr(library, in_sympy or name)(x, evaluate=False)
        return getattr(library, name)(x)

    apply.__name__ = apply.__qualname__ = name
    apply.__doc__ = f"{name}(x), elementwise for arrays."
    return apply


sin = _unary("sin", math.sin)
cos = _unary("cos", math.cos)
tan = _unary("tan", math.tan)
tanh = _unary("tanh", math.tanh)
exp = _unary("exp", math.exp)
log = _unary("log", math.log)
sqrt = _unary("sqrt", math.sqrt)
floor = _unary("floor", lambda x: float(math.floor(x)))
absolute = _unary("abs", abs, "Abs")


def sign(x: Quantity) -> Quantity:
    """-1, 0 or 1."""
    library = _foreign(x)
    if library is None:
        return float((x > 0) - (x < 0))
    return library.sign(x) if library.__name__ == "numpy" else library.sign(x, evaluate=False)


def where(condition: Quantity, if_true: Quantity, if_false: Quantity) -> Quantity:
    """`if_true` where the condition holds, else `if_false`, numbers or conditions; both are evaluated."""
    if condition is True or condition is False:
        return if_true if condition else if_false
    library = _foreign(condition, if_true, if_false)
    if library is None:
        return if_true if condition else if_false
    if library.__name__ == "numpy":
        return library.where(condition, if_true, if_false)
    if _is_condition(library, if_true) and _is_condition(library, if_false):
        return library.Or(library.And(condition, if_true), library.And(library.Not(condition), if_false))
    return _choice(library, (if_true, condition), (if_false, True))


def _is_condition(sympy: Any, value: Quantity) -> bool:
    """Whether it is no number; a symbol may be either, and is one."""
    if isinstance(value, sympy.logic.boolalg.Boolean):
        return not isinstance(value, sympy.Expr)
    return isinstance(value, bool)


def _choice(sympy: Any, *cases: tuple[Quantity, Quantity]) -> Quantity:
    """A Piecewise as it is: its own constructor rewrites conditions that hold a choice themselves."""
    pair = sympy.functions.elementary.piecewise.ExprCondPair
    pairs = (sympy.Tuple.__new__(pair, sympy.sympify(value), sympy.sympify(condition)) for value, condition in cases)
    return sympy.Basic.__new__(sympy.Piecewise, *pairs)


def minimum(a: Quantity, b: Quantity) -> Quantity:
    """The smaller of two."""
    library = _foreign(a, b)
    if library is None:
        return a if a < b else b
    return library.where(a < b, a, b) if library.__name__ == "numpy" else library.Min(a, b, evaluate=False)


def maximum(a: Quantity, b: Quantity) -> Quantity:
    """The larger of two."""
    library = _foreign(a, b)
    if library is None:
        return a if a > b else b
    return library.where(a > b, a, b) if library.__name__ == "numpy" else library.Max(a, b, evaluate=False)


def clip(x: Quantity, low: Quantity, high: Quantity) -> Quantity:
    """x held between low and high."""
    return minimum(maximum(x, low), high)


def both(a: Quantity, b: Quantity) -> Quantity:
    """Logical and of two conditions."""
    library = _foreign(a, b)
    if library is None:
        return bool(a and b)
    return library.logical_and(a, b) if library.__name__ == "numpy" else library.And(a, b)


def dot(a: Sequence[Quantity], b: Sequence[Quantity]) -> Quantity:
    """Sum of the products of two vectors, added from the first on; a row of a matrix stays one in generated C."""
    library = _foreign(*a, *b)
    if library is not None and library.__name__ == "sympy":
        return library.Function("dot")(*a, *b)
    first, *others = [x * y for x, y in zip(a, b, strict=True)]
    return sum(others, first)


def uniform(seed: Quantity, index: Quantity) -> Quantity:
    """A number in (0, 1) that depends only on seed and index: two rounds of SplitMix64's finaliser.

    Counter-based, so a run can be repeated, reset or entered anywhere without a stored generator state.
    """
    library = _foreign(seed, index)
    if library is None:
        return (_mix(_mix(int(seed)) ^ int(index)) >> 12) * 2.0**-52 + 2.0**-53
    if library.__name__ == "numpy":
        return library.vectorize(uniform, otypes=[float])(
            library.asarray(seed, dtype=object), library.asarray(index, dtype=object)
        )
    return library.Function("uniform")(seed, index)


def normal(seed: Quantity, index: Quantity) -> Quantity:
    """A standard normal number that depends only on seed and index (Box-Muller on two uniforms)."""
    radius = sqrt(-2.0 * log(uniform(seed, 2 * index)))
    return radius * cos(2.0 * math.pi * uniform(seed, 2 * index + 1))


def _mix(z: int) -> int:
    mask = 0xFFFFFFFFFFFFFFFF
    z = (z + 0x9E3779B97F4A7C15) & mask
    z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
    z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
    return z ^ (z >> 31)


def playback(table: Quantity, time: Quantity) -> Quantity:
    """Value of a `model.Table` at a time, by linear interpolation; its end values outside.

    A symbolic time gives an undefined function named after the table, for the code generator to fill in.
    """
    library = _foreign(time)
    if library is None:
        return table(time)
    if library.__name__ == "numpy":
        return library.vectorize(table, otypes=[float])(time)
    return library.Function(f"playback_{table.name}")(time)
