"""How work that takes a while tells how far it is: one type for every command, run and calibration."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path

READY = "SERVOTWIN_READY"  # environment variable: a file that is made when a command is ready, whatever it says
Progress = Callable[[float, str], None]
"""Told the fraction done (0 to 1) and what is being done now, in a few words."""


def tell_ready() -> None:
    """Tell whoever has started this command that it is ready."""
    if path := os.environ.pop(READY, None):
        with suppress(OSError):
            Path(path).touch()


def share_of(progress: Progress, first: float, last: float) -> Progress:
    """For a part of the work: its beginning and end are these fractions of the whole."""
    return lambda fraction, doing: progress(first + (last - first) * fraction, doing)


def silent(fraction: float, doing: str) -> None:
    """Told to nobody."""


class Figures(str):
    """A line that has its figures by name, too.

    Attributes:
        values: name -> figure.
    """

    __slots__ = ("values",)
    values: Mapping[str, float]

    @classmethod
    def of(cls, line: str, values: Mapping[str, float]) -> Figures:
        """The line, with these figures."""
        figures = cls(line)
        figures.values = dict(values)
        return figures

    def __reduce__(self) -> tuple[Callable[..., Figures], tuple[str, Mapping[str, float]]]:
        return Figures.of, (str(self), self.values)
