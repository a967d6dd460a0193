"""Which column of a file is which signal. A `Layout` is what the user says, `ColumnNames` what the file says, and
`choose` brings the two together before any sample is read.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from fmus.files import sha256
from orchestrator.formats.recording import Recording
from orchestrator.trace import ordered

SECONDS = {"": 1.0, "s": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9}
MAX_VALUES = 2**28  # samples times columns of one recording: 2 GiB


@dataclass(frozen=True)
class Layout:
    """What the columns of a recording are.

    Attributes:
        variable: name of the matrix in a .mat file; None takes the only one.
        time: column of the time stamps, a number from 0 or a name.
        columns: signal name -> column number or name; None takes every column under its own name.
        units: signal name (or the time column's) -> unit, over what the file says.
        database: what the frames of a CAN log mean; its signals are the columns.
        signals: those to read of the database; None reads all.
        interpolated: signals of the database that run linearly between their frames instead of being held.
        channel: of the log, from 0; None takes the frames of all.
        steady: messages of the database whose frames get the stamps of the even schedule that their sender kept.
    """

    variable: str | None = None
    time: int | str = "time"
    columns: Mapping[str, int | str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    database: Path | None = None
    signals: Sequence[str] | None = None
    interpolated: Collection[str] = ()
    channel: int | None = None
    steady: Collection[str] = ()


@dataclass(frozen=True)
class ColumnNames:
    """The columns a file holds: how many, and their names and units ("" unknown) where it tells them."""

    count: int
    names: tuple[str, ...] | None = None
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class Choice:
    """The columns to read of the file `place`: numbers from 0, units by signal name, and the time unit in seconds."""

    place: Path
    time: int
    signals: Mapping[str, int]
    units: Mapping[str, str]
    seconds: float

    @property
    def wanted(self) -> list[int]:
        """Every column that is needed, ascending."""
        return sorted({self.time, *self.signals.values()})

    def recording(self, column: Callable[[int], ArrayLike], name: str = "") -> Recording:
        """The recording that results when `column` gives the samples (K,) of a column by its number.

        Args:
            name: what the file calls it; without one it is named after the file.

        Raises:
            TraceError: fewer than two distinct stamps, or one that is not finite.
        """
        stamps = np.asarray(column(self.time), dtype=float)
        if self.seconds != 1.0:
            stamps = stamps * self.seconds
        signals = {key: column(index) for key, index in self.signals.items()}
        trace, report = ordered(stamps, signals, self.units, str(self.place))
        return Recording(replace(trace, name=name or self.place.stem), report, self.place, sha256(self.place))


def choose(layout: Layout, columns: ColumnNames, place: Path) -> Choice:
    """The columns of the file at `place` that `layout` asks for.

    Raises:
        TraceError: a column is not there, or its name is missing or ambiguous; an unknown unit of time.
    """
    time = _number(layout.time, columns, place)
    if layout.columns is None:
        signals = _all_by_name(columns, time, place)
    else:
        signals = {name: _number(column, columns, place) for name, column in layout.columns.items()}
    time_name = columns.names[time] if columns.names else "time"
    stray = set(layout.units) - set(signals) - {time_name, "time"}
    if stray:
        raise TraceError(place, f"units are given for '{min(stray)}', which is not read", "correct the layout")
    told = {name: columns.units[number] for name, number in signals.items() if columns.units}
    units = {name: layout.units.get(name, told.get(name, "")) for name in signals}
    return Choice(
        place,
        time,
        signals,
        {name: unit for name, unit in units.items() if unit},
        _seconds(layout, columns, time, time_name, place),
    )


def _number(column: int | str, columns: ColumnNames, place: Path) -> int:
    if isinstance(column, int):
        if not 0 <= column < columns.count:
            raise TraceError(place, f"has no column {column}", f"it has {columns.count}, counted from 0")
        return column
    if columns.names is None:
        raise TraceError(
            place,
            f"names no columns, so '{column}' cannot be found",
            f"give column numbers from 0 to {columns.count - 1} in the layout",
        )
    found = [number for number, name in enumerate(columns.names) if name == column]
    if len(found) == 1:
        return found[0]
    if found:
        raise TraceError(place, f"has {len(found)} columns named '{column}'", "give the column's number")
    raise TraceError(place, f"has no column '{column}'", f"it holds {_listed(columns.names)}")


def _all_by_name(columns: ColumnNames, time: int, place: Path) -> dict[str, int]:
    if columns.names is None:
        raise TraceError(place, "names no columns", "say in the layout which column is which signal")
    repeated = [name for name, times in Counter(columns.names).items() if times > 1]
    if repeated or "" in columns.names:
        problem = "has a column without a name" if "" in columns.names else f"has '{repeated[0]}' twice"
        raise TraceError(place, problem, "say in the layout which columns to read")
    return {name: number for number, name in enumerate(columns.names) if number != time}


def _seconds(layout: Layout, columns: ColumnNames, time: int, time_name: str, place: Path) -> float:
    told = columns.units[time] if columns.units else ""
    unit = layout.units.get("time", layout.units.get(time_name, told))
    if unit not in SECONDS:
        raise TraceError(place, f"its time is in '{unit}'", f"give it in one of {', '.join(filter(None, SECONDS))}")
    return SECONDS[unit]


def _listed(names: tuple[str, ...], most: int = 20) -> str:
    shown = ", ".join(f"'{name[:40]}'" for name in names[:most])
    return shown + (f" and {len(names) - most} more" if len(names) > most else "")
