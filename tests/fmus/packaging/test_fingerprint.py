"""A fingerprint tells two things apart exactly where they do not do the same."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus import library
from fmus.modelling.model import State
from fmus.packaging.fingerprint import NoFingerprintError, fingerprint

PLAIN = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False) | st.text() | st.binary(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner) | st.tuples(inner, inner),
    max_leaves=8,
)
# What a model file may be, with one place where it can be changed.
FILE = '''"""A tank."""
import math
from functools import cache
from . import Model, State, input_, ops, output, parameter

AREAS = {{"small": 1.0, "large": {constant}}}
def level(x, scale={default}):
    return scale * x.level
@cache
def gravity():
    return {cached}
def made(factor):
    def rate(t, x, u, p):
        inner = [i * {inner} for i in range(2)]
        leaving = p.leak * factor * ops.{function}(level(x) * gravity()) * inner[1]
        return {{"level": (u.inflow - leaving) / AREAS["large"]}}
    return rate

MODEL = Model("tank", "A tank", (input_("inflow", "m3/s", "Inflow"), output("level", "m", "Level"),
    parameter("leak", "m2", {parameter}, "Leak"), parameter("start", "m", 0.5, "{text}")),
    (State("level", "start", "m"),), made({closure}), solver_step=lambda p: {step})
'''
AS_IT_IS = {
    "constant": "2.0",
    "default": "1.0",
    "cached": "9.81",
    "inner": "1",
    "function": "sqrt",
    "parameter": "0.1",
    "text": "Level at the start",
    "closure": "1.0",
    "step": "0.1",
}
CHANGES = {
    "constant": "2.5",
    "default": "1",
    "cached": "9.82",
    "inner": "1.0",
    "function": "exp",
    "parameter": "0.2",
    "text": "Start",
    "closure": "1.5",
    "step": "0.2",
}


def of_file(folder: Path, **changes: str) -> str:
    path = folder / "tank.py"
    path.write_text(FILE.format(**AS_IT_IS | changes))
    return fingerprint(library.find(str(path)))


@pytest.mark.slow
@given(PLAIN, PLAIN)
def test_values_have_one_fingerprint_where_they_are_written_alike(one: Any, other: Any) -> None:
    def listed(value: Any) -> Any:  # lists and tuples are not told apart
        if isinstance(value, dict):
            return {key: listed(part) for key, part in value.items()}
        return [listed(part) for part in value] if isinstance(value, list | tuple) else value

    assert (fingerprint(one) == fingerprint(other)) == (repr(listed(one)) == repr(listed(other)))


@pytest.mark.parametrize("place", CHANGES)
def test_a_model_file_that_is_changed_anywhere_is_another_model(tmp_path: Path, place: str) -> None:
    assert of_file(tmp_path) != of_file(tmp_path, **{place: CHANGES[place]})


def test_the_same_model_elsewhere_is_the_same(tmp_path: Path) -> None:
    (tmp_path / "other").mkdir()
    assert of_file(tmp_path) == of_file(tmp_path / "other")


def test_another_process_finds_the_same(tmp_path: Path) -> None:
    names = library.names()
    code = f"""
from fmus import library
from fmus.packaging.fingerprint import fingerprint
print([fingerprint(library.find(name), {{"b", "a", "c"}}) for name in {names}])
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    here = [fingerprint(library.find(name), {"c", "a", "b"}) for name in names]
    assert done.stdout.strip() == str(here)
    assert len({*here}) == len(names)


def test_functions_of_one_code_differ_by_what_they_hold() -> None:
    def holding(value: object) -> Callable[[], object]:
        return lambda: value

    assert fingerprint(holding(1)) == fingerprint(holding(1)) != fingerprint(holding(1.0))
    assert fingerprint(holding(holding(1))) != fingerprint(holding(holding(2)))
    assert fingerprint(State("a")) != fingerprint(State("a", 1.0))


def test_functions_that_name_each_other_have_one(monkeypatch: pytest.MonkeyPatch) -> None:
    assert fingerprint(even) != fingerprint(odd)
    before = fingerprint(even)
    monkeypatch.setitem(globals(), "LAST", 1)
    assert fingerprint(even) != before


LAST = 0


def even(n: int) -> bool:
    return n == LAST or odd(n - 1)


def odd(n: int) -> bool:
    return n != LAST and even(n - 1)


def test_a_function_that_holds_an_object_has_none() -> None:
    held = object()
    with pytest.raises(NoFingerprintError, match="object object"):
        fingerprint(lambda: held)
