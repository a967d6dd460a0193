"""What FMUs said during a calibration or validation: kept beside its result, counted in its summary and its report."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from typing_extensions import TypedDict

from orchestrator.display.table import Cell
from orchestrator.fmi.said import LOG_FILE, Said, counted
from orchestrator.report import Report

_LOUD = ("WARNING", "ERROR", "CRITICAL")
_SHOWN = 10  # kinds of messages that are warned of
_LISTED = 100  # kinds in a report


class MessagesSummary(TypedDict):
    """Where all that FMUs said is kept, and how many messages that is."""

    file: str
    count: int


@dataclass(frozen=True)
class Messages:
    """What FMUs said.

    Attributes:
        file: with all of it, while it is there.
    """

    file: Path
    kinds: Sequence[Said]

    @classmethod
    def of(cls, file: Path) -> Messages:
        """What is in a file that was `kept`; it need not be there."""
        return cls(file, counted(file))

    @property
    def summary(self) -> MessagesSummary | None:
        """As `summary.json` holds it; nothing where they said nothing."""
        return {"file": LOG_FILE, "count": sum(kind.count for kind in self.kinds)} if self.kinds else None

    @property
    def warnings(self) -> list[str]:
        """What they warned of."""
        loud = [f"{kind}; all in {LOG_FILE}" for kind in self.kinds if kind.level in _LOUD]
        more = len(loud) - _SHOWN
        return loud[:_SHOWN] + ([f"FMUs warned of {more} things more; all in {LOG_FILE}"] if more > 0 else [])

    def write(self, page: Report, folder: Path) -> None:
        """Add them to a result: a section of its report, and the file."""
        if self.kinds:
            caption = f"the first of each kind; all in {LOG_FILE}"
            rows: list[list[Cell]] = [[kind.level.lower(), kind.text, kind.count] for kind in self.kinds[:_LISTED]]
            page.section("What the FMUs said").table(["level", "message", "times"], rows, caption=caption)
            shutil.copyfile(self.file, folder / LOG_FILE)
