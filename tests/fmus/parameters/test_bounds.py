"""Bounds are written as intervals."""

from __future__ import annotations

import pytest

from fmus.parameters.bounds import span


@pytest.mark.parametrize(
    ("low", "high", "text"),
    [
        (0.0, 2.5, "[0, 2.5]"),
        (0.0, None, "[0, inf)"),
        (None, "9", "(-inf, 9]"),
        (None, None, "(-inf, inf)"),
        ("0", "0", "[0, 0]"),
    ],
)
def test_an_open_end_is_infinite(low: float | str | None, high: float | str | None, text: str) -> None:
    assert span(low, high) == text
