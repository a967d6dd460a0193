"""How work that takes a while tells how far it is: one type for every command, run and calibration."""

from __future__ import annotations

from collections.abc import Callable

Progress = Callable[[float, str], None]
"""Told the fraction done (0 to 1) and what is being done now, in a few words."""


def silent(fraction: float, doing: str) -> None:
    """Told to nobody."""
