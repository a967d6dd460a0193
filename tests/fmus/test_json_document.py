"""What a dataclass is in JSON."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from enum import StrEnum
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.json_document import as_json, document_of, json_text


class Colour(StrEnum):
    RED = "red"


@dataclass(frozen=True)
class Inner:
    value: float
    note: str = ""


@dataclass(frozen=True)
class Outer:
    KEYS = ("name", "twice", "inner", "note?", "texts?")

    name: str
    hidden: float
    inner: tuple[Inner, ...] = ()
    note: str = ""
    texts: tuple[str, ...] | None = None

    @property
    def twice(self) -> float:
        return 2 * self.hidden


@pytest.mark.parametrize(
    ("value", "told"),
    [
        (np.array([[1.0, math.nan], [math.inf, -0.5]]), [[1.0, None], [None, -0.5]]),
        (np.float64(0.1), 0.1),
        (np.int64(3), 3),
        (np.bool_(True), True),
        (Fraction(1, 4), 0.25),
        (Path("a/b"), "a/b"),
        (Colour.RED, "red"),
        ({1: (True, None)}, {"1": [True, None]}),
        (Inner(math.nan), {"value": None, "note": ""}),
    ],
)
def test_a_value_is_what_json_has_of_it(value: object, told: object) -> None:
    made = as_json(value)
    assert made == told and json.loads(json.dumps(made, allow_nan=False)) == told


def test_keys_name_what_is_told_and_leave_out_what_is_empty() -> None:
    assert list(document_of(Outer("a", 1.0)).items()) == [("name", "a"), ("twice", 2.0), ("inner", [])]
    full = document_of(Outer("a", 1.0, (Inner(1.0),), "n", ("x",)))
    assert full == {"name": "a", "twice": 2.0, "inner": [{"value": 1.0, "note": ""}], "note": "n", "texts": ["x"]}


def test_a_document_with_a_dataclass_in_it_is_written_whole() -> None:
    document: dict[str, Any] = {"a": 0.1 + 0.2, "b": [Inner(math.inf)], "c": "é"}
    assert json.loads(json_text(document)) == {"a": 0.1 + 0.2, "b": [{"value": None, "note": ""}], "c": "é"}


def test_what_is_no_number_is_refused_outside_of_dataclasses() -> None:
    with pytest.raises(ValueError, match="not JSON compliant"):
        json_text({"a": math.nan})


def test_what_json_does_not_have_is_refused() -> None:
    with pytest.raises(TypeError, match="object is nothing that JSON has"):
        as_json(object())
