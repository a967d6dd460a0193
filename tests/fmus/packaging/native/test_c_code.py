"""Expressions as C: the same operations in the same order, shared parts once, unknown ones refused by name."""

from __future__ import annotations

import ctypes
import math
import re
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import sympy
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from fmus.errors import ModelError
from fmus.modelling import ops
from fmus.packaging.native import c_code, compiler

a, b = sympy.symbols("a b", real=True)
DIALECT = c_code.Dialect({a: "a", b: "b"}, ("drive",))
RUNTIME = Path(c_code.__file__).parent / "c"


def traced(function: Callable[[Any, Any], Any]) -> sympy.Expr:
    with sympy.evaluate(False):
        return sympy.sympify(function(a, b))


def in_c(function: Callable[[Any, Any], Any]) -> str:
    """The C of a function's result, where no part of it needs a name."""
    lines, [value] = c_code.statements("here", DIALECT, [traced(function)])
    assert lines == []
    return value


@pytest.mark.parametrize(
    ("function", "text"),
    [
        (lambda a, b: a + b - 2, "a + b - 2.0"),
        (lambda a, b: a - (b + 1), "a - (b + 1.0)"),
        (lambda a, b: a * b / 3.5, "a * b / 3.5"),
        (lambda a, b: a / (b * a), "a / (b * a)"),
        (lambda a, b: a * (b * 2), "a * (b * 2.0)"),
        (lambda a, b: -a * b, "(-a) * b"),
        (lambda a, b: a - -b, "a + b"),
        (lambda a, b: a**2 + b**3, "square(a) + pow(b, 3.0)"),
        (lambda a, b: 1 / a**2, "1.0 / square(a)"),
        (lambda a, b: a**-1.5, "pow(a, -1.5)"),
        (lambda a, b: ops.sqrt(a) / ops.sqrt(b), "sqrt(a) / sqrt(b)"),
        (lambda a, b: 1e-300 * a, "1e-300 * a"),
        (lambda a, b: 0.1 + a, "0.1 + a"),
        (lambda a, b: ops.absolute(a), "fabs(a)"),
        (lambda a, b: ops.uniform(a, 2 * b), "uniform(a, 2.0 * b)"),
        (lambda a, b: ops.where(a > b, 1.0, b), "(a > b ? 1.0 : b)"),
        (lambda a, b: ops.where(ops.both(a > 0, a <= 1), a, 0.0), "((a <= 1.0) && (a > 0.0) ? a : 0.0)"),
    ],
)
def test_operations_stand_in_c_in_the_order_they_were_written(function: Any, text: str) -> None:
    assert in_c(function) == text


NUMBERS = st.floats(-50, 50).map(lambda x: round(x, 3)).filter(bool)
TREES = st.recursive(
    st.sampled_from(["a", "b"]) | NUMBERS.map(repr),
    lambda inner: (
        st.builds("({} {} {})".format, inner, st.sampled_from("+-*/"), inner)
        | st.builds("(-{})".format, inner)
        | st.builds("ops.{}({})".format, st.sampled_from(["sin", "tanh", "floor", "absolute", "sign"]), inner)
        | st.builds("ops.where({} {} {}, {}, {})".format, inner, st.sampled_from(["<", ">", ">="]), inner, inner, inner)
        | st.builds("ops.where(ops.where({} > {}, {} < {}, {} >= {}), {}, {})".format, *[inner] * 8)
        | st.builds("({})**2".format, inner)
    ),
    max_leaves=12,
)


@pytest.mark.slow
@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
@settings(max_examples=15, deadline=None)
@given(formulas=st.lists(TREES, min_size=1, max_size=20))
def test_random_formulas_give_in_c_what_they_give_in_python(formulas: list[str]) -> None:
    functions = [eval(f"lambda a, b: {formula}", {"ops": ops}) for formula in formulas]
    assume(all(map(possible, functions)))
    run = compiled(functions)
    for x, y in ((0.7, -1.3), (-2.25, 0.1), (40.0, 3.0)):
        for formula, function, found in zip(formulas, functions, run(x, y), strict=True):
            try:
                expected = float(function(x, y))
            except (ArithmeticError, ValueError):
                continue
            assert found == pytest.approx(expected, rel=1e-12, abs=1e-300, nan_ok=True), formula


def possible(function: Callable[[Any, Any], Any]) -> bool:
    """Whether no constant part of a formula divides by zero."""
    try:
        traced(function)
    except (ArithmeticError, ValueError):
        return False
    return True


def compiled(functions: list[Callable[[Any, Any], Any]]) -> Callable[[float, float], list[float]]:
    """The functions, traced, written as C, compiled, and loaded."""
    lines, values = c_code.statements("here", DIALECT, [traced(function) for function in functions])
    body = "\n".join([*lines, *(f"y[{i}] = {value};" for i, value in enumerate(values))])
    sources = {name: (RUNTIME / name).read_text() for name in ("ops.h", "ops.c")}
    head = '#include "ops.h"\n__attribute__((visibility("default"))) void run(double a, double b, double *y)'
    sources["run.c"] = f"{head} {{ (void)a; (void)b; {body} }}"
    with tempfile.NamedTemporaryFile(suffix=".so") as file:
        file.write(compiler.compile_library(sources, "run", compiler.host()))
        file.flush()
        library = ctypes.CDLL(file.name)

    def run(x: float, y: float) -> list[float]:
        results = (ctypes.c_double * len(functions))()
        library.run(ctypes.c_double(x), ctypes.c_double(y), results)
        return list(results)

    return run


def test_a_part_that_is_used_twice_gets_a_name_and_is_computed_once() -> None:
    root = traced(lambda a, b: (ops.sin(a) + b) / (1 + ops.sin(a) + b) - ops.tanh(ops.sin(a)))
    lines, [value] = c_code.statements("here", DIALECT, [root])
    assert " ".join([*lines, value]).count("sin(a)") == 1


def test_lines_stay_short_enough_to_be_read() -> None:
    root = traced(lambda a, b: sum(k * ops.sin(k * a + b) * ops.cos(b / k) for k in range(1, 60)))
    lines, [value] = c_code.statements("here", DIALECT, [root])
    assert max(map(len, [*lines, value])) < 140


def test_playback_calls_the_table_of_its_name() -> None:
    lines, [value] = c_code.statements("here", DIALECT, [sympy.Function("playback_drive")(a)])
    assert (lines, value) == ([], "playback(&tables[0], a)")


@pytest.mark.parametrize(
    ("expression", "name"),
    [
        (sympy.Mod(a, 2), "Mod"),
        (sympy.asin(a), "asin"),
        (sympy.Function("playback_other")(a), "playback_other"),
        (sympy.Function("f")(a), "f"),
        (sympy.nan, "nan"),
        (sympy.I * a, "I"),
        (sympy.Symbol("c"), "c"),
    ],
)
def test_an_operation_without_a_counterpart_is_named(expression: sympy.Expr, name: str) -> None:
    with pytest.raises(ModelError, match=f"^here: uses '{re.escape(name)}', which has no counterpart in C"):
        c_code.statements("here", DIALECT, [expression])


@given(st.floats(allow_nan=False))
def test_a_literal_keeps_every_bit(value: float) -> None:
    text = c_code.literal(value).replace("INFINITY", "inf")
    assert float(text) == value
    assert math.copysign(1, float(text)) == math.copysign(1, value)


@pytest.mark.skipif(not compiler.available(), reason="no C compiler here")
def test_a_string_arrives_in_c_as_it_is(tmp_path: Path) -> None:
    text = '"quoted" \\ ??/ 100 % größer\n\t1\x01'
    (tmp_path / "say.c").write_text(f"#include <stdio.h>\nint main(void) {{ fputs({c_code.string(text)}, stdout); }}")
    subprocess.run(["cc", "-std=c99", "-trigraphs", "say.c", "-o", "say"], cwd=tmp_path, check=True)
    assert subprocess.run([tmp_path / "say"], capture_output=True, check=True).stdout.decode() == text


def test_what_depends_on_some_symbols_alone_is_found_whole_and_once() -> None:
    with sympy.evaluate(False):
        root = sympy.sqrt(a * 2) * b + sympy.sin(a) * (b - sympy.sqrt(a * 2)) + a * b
        assert c_code.computed_from([a], [root, sympy.sqrt(a * 2)]) == [sympy.sqrt(a * 2), sympy.sin(a)]
        assert c_code.computed_from([a, b], [root, b]) == [root]
        assert c_code.computed_from([], [a > b]) == []


def test_what_is_computed_already_is_taken_by_its_name() -> None:
    with sympy.evaluate(False):
        root = sympy.sqrt(a) * b
        dialect = c_code.Dialect({b: "b"}, computed={sympy.sqrt(a): "c[0]"})
    assert c_code.statements("here", dialect, [root]) == ([], ["c[0] * b"])
