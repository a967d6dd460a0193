"""What files may say of the layout of recordings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, model_validator

from orchestrator.can.database.sources import DatabaseFiles, file_and_bus, moved, paths
from orchestrator.formats.layout import Dates, Decimal, Layout, Separator
from orchestrator.yaml_file import Block, Seconds


class EvenBlock(Block):
    """The time of a recording without stamps.

    Attributes:
        step: from one sample to the next [s].
    """

    step: Annotated[Seconds, Field(gt=0)]


class LayoutBlock(Block):
    """How a recording is laid out, and which of its columns is which signal; see `Layout`.

    Attributes:
        database: of CAN logs, beside the file: one, several, or those of each channel by number or interface. There
            `columns` names signals of the database, and without them those of a study are the database's.
        channel: of CAN logs; None takes the frames of all.
        source: of J1939 messages and CANopen nodes only those of this sender; see `Layout`.
        steady: messages of CAN logs with a counter whose sender keeps an even schedule: their frames get its stamps,
            however late each came.
    """

    explained_by = (Layout,)

    variable: str | None = None
    time: int | str | EvenBlock | None = None
    columns: dict[str, int | str] | None = None
    units: dict[str, str] = {}
    header: int | None = Field(None, ge=0)
    units_line: int | None = Field(None, ge=0)
    separator: Separator | None = None
    decimal: Decimal | None = None
    encoding: str | None = None
    dates: Dates | None = None
    time_zone: str | None = None
    database: Path | list[Path] | dict[int | str, Path | list[Path]] | None = None
    channel: int | None = Field(None, ge=0)
    source: Annotated[int, Field(ge=0, le=255)] | Literal["any"] | None = None
    steady: list[str] = []

    @model_validator(mode="after")
    def _distinct(self) -> LayoutBlock:
        files = [] if self.database is None else paths(self.database)  # type: ignore[arg-type]
        names = [file.name for file in files]
        if twice := next((name for name in names if names.count(name) > 1), None):
            raise ValueError(
                f"`database`: two files are called {twice}, and results keep them side by side; rename one"
            )
        return self

    def layout(self, base: Path) -> Layout:
        """How to read a recording; the database is relative to `base`."""
        given = dict(self) | {"database": self.database_file(base)}
        even = self.time if isinstance(self.time, EvenBlock) else None
        return Layout(**(given | ({"time": None, "step": float(even.step)} if even else {})))

    def database_file(self, base: Path) -> DatabaseFiles | None:
        """The database: where the file says, or beside the file by its own name, as in a result folder."""
        given = self.database
        if given is None:
            return None
        files = {str(channel): own for channel, own in given.items()} if isinstance(given, dict) else given
        return moved(files, lambda file: _found(base, file))


def _found(base: Path, file: Path) -> Path:
    there, beside = (file_and_bus(base / name)[0].is_file() for name in (file, file.name))
    return base / (file.name if beside and not there else file)


class LayoutFileBlock(Block):
    """A file with a layout alone, as `servotwin trace info` prints it."""

    layout: LayoutBlock
