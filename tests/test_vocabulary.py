"""What the packages show to a notebook: loaded when it is used, in any order of imports, and nothing heavy before."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import identification
import orchestrator

HEAVY = (
    "numpy",
    "scipy",
    "sympy",
    "pydantic",
    "plotly",
    "pyarrow",
    "can",
    "cantools",
    "fmpy",
    "rich",
    "typer",
    "control",
)
ROOT = Path(__file__).parents[1]


def python(code: str) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    ).stdout.strip()


@pytest.mark.parametrize("package", ["orchestrator", "identification"])
def test_a_package_loads_nothing_heavy_until_a_name_is_used(package: str) -> None:
    code = f"import sys, {package}; dir({package}); print(sorted(set(sys.modules) & set({HEAVY!r})))"
    assert python(code) == "[]"


@pytest.mark.parametrize("package", [orchestrator, identification], ids=lambda package: package.__name__)
def test_every_name_is_there_and_documented(package: object) -> None:
    names = package.__all__  # type: ignore[attr-defined]
    assert set(names) <= set(dir(package))
    assert [name for name in names if not (getattr(package, name).__doc__ or "").strip()] == []


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="module 'identification' has no attribute 'tuna'"):
        identification.tuna  # type: ignore[attr-defined]  # noqa: B018


@pytest.mark.slow
@pytest.mark.parametrize("first", ["identification.subspace.subspace", "identification.calibrate", "identification"])
def test_a_name_is_the_function_also_where_a_module_of_that_name_was_loaded_first(first: str) -> None:
    code = f"import {first}; from identification import calibrate as c, subspace as s; print(callable(c), callable(s))"
    assert python(code) == "True True"
