"""Bounds of a value as messages have them."""

from __future__ import annotations


def span(low: float | str | None, high: float | str | None) -> str:
    """The interval from one bound to the other; None is open: `[0, 2]`, `[0, inf)`."""
    begin = "(-inf" if low is None else f"[{_short(low)}"
    return f"{begin}, inf)" if high is None else f"{begin}, {_short(high)}]"


def _short(bound: float | str) -> str:
    return bound if isinstance(bound, str) else format(bound, "g")
