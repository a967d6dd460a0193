"""How quantities are named on axes and in tables."""

from __future__ import annotations


def with_unit(name: str, unit: str | None) -> str:
    """`name [unit]`; no brackets for a dimensionless or unknown quantity."""
    return f"{name} [{unit}]" if unit not in (None, "", "1") else name
