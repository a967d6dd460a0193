"""What commands here need to know of studies: tables that the package above fills when its commands are imported.

Judges and layouts go by a key at the top of a YAML file, which tells what the file is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.batch.verdict import FileJudge
    from orchestrator.formats import Layout


@dataclass(frozen=True)
class Starter:
    """Files to start from.

    Attributes:
        files: name in the package -> name where they are written.
        commands: what to do with them first.
    """

    package: str
    files: Mapping[str, str]
    commands: tuple[str, ...]


JUDGES: dict[str, FileJudge] = {}
"""Who judges such a file as a case of the suite: given the file and a folder for results, whether all came out as
stated, and the cases. Other processes import the function by its name."""

LAYOUTS: dict[str, Callable[[Path], Layout]] = {}
"""Who knows how such a file has recordings read."""

SCHEMAS: dict[str, Callable[[], Any]] = {}
"""kind of a YAML file -> the type that its contents have."""

STARTERS: dict[str, Starter] = {}
"""kind of file -> what `init` writes."""
