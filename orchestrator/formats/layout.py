"""Which column of a file is which signal. A `Layout` is what the user says, `FileColumns` what the file says, and
`choose` brings the two together before any sample is read. What nobody said is seen in the file, and told.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from fmus.errors import TraceError
from fmus.files import sha256
from fmus.words import listed
from orchestrator.can.database.sources import DatabaseFiles
from orchestrator.formats.headings import SECONDS, names_time, split, time_unit
from orchestrator.formats.recording import Recording
from orchestrator.formats.stamps import Stamps
from orchestrator.stamps import ordered, unwrapped
from orchestrator.trace import FloatArray

Separator = Literal[",", ";", "|", "tab", "blank"]
Decimal = Literal[".", ","]
Dates = Literal["dmy", "mdy", "ymd"]
SURE = 8  # samples in a row that rise make a column look like the time
MAX_VALUES = 2**28  # samples times columns of one recording: 2 GiB


@dataclass(frozen=True)
class Layout:
    """What the columns of a recording are; None is seen in the file.

    Attributes:
        variable: the part of the file that is the table: a matrix of .mat, .npz or HDF5, a sheet of .xlsx, a group of
            channels of .tdms or MDF. None takes the only one.
        time: column of the time stamps, a number from 0 or a name.
        columns: signal name -> column number or name; None takes every column under its own name.
        units: signal name (or the time column's) -> unit, over what the file says.
        database: what the frames of a CAN log mean, of all channels or of each; its signals are the columns.
        signals: those to read of the database; None reads all.
        interpolated: signals of the database that run linearly between their frames instead of being held.
        channel: of the log, from 0; None takes the frames of all.
        source: of J1939 messages and CANopen nodes only those of the sender with this address; with one, or "any", all
            extended identifiers of the database are J1939's, also where it does not say so.
        steady: messages of the database whose frames get the stamps of the even schedule that their sender kept.
        header: number of the line that names the columns, from 1; 0 where none does.
        units_line: number of the line with their units; 0 where there is none.
        separator: of the cells of a line: "," ";" "|" "tab" "blank".
        decimal: mark of the decimals, a point or a comma.
        encoding: of a text file, or of the database of a CAN log, such as cp1252.
        dates: order of day, month and year.
        time_zone: where the clock was that gave times without a zone, such as Europe/Berlin.
        step: from one sample to the next, where the file has no stamps; the first is at 0 [s].
        texts: whether columns of text are read, too: those that are named in `columns`, and those that we wrote.
    """

    variable: str | None = None
    time: int | str | None = None
    columns: Mapping[str, int | str] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    database: DatabaseFiles | None = None
    signals: Sequence[str] | None = None
    interpolated: Collection[str] = ()
    channel: int | None = None
    source: int | Literal["any"] | None = None
    steady: Collection[str] = ()
    header: int | None = None
    units_line: int | None = None
    separator: Separator | None = None
    decimal: Decimal | None = None
    encoding: str | None = None
    dates: Dates | None = None
    time_zone: str | None = None
    step: float | None = None
    texts: bool = False


PLAIN = Layout(header=1, units_line=0, separator=",", decimal=".", encoding="utf-8")


def spelled(layout: Layout, asked: Layout) -> dict[str, object]:
    """The `layout` block that reads such a file: what was asked for, and what is not as in a plain file."""
    keys = ("variable", "time", "columns", "units", "header", "units_line", "separator", "decimal", "encoding")
    seen = {key: getattr(layout, key) for key in (*keys, "dates", "time_zone")}
    even: dict[str, object] = {} if layout.step is None else {"time": {"step": layout.step}}
    return even | {
        key: dict(value) if isinstance(value, Mapping) else value
        for key, value in seen.items()
        if value not in (None, {}) and (value != getattr(PLAIN, key) or getattr(asked, key) is not None)
    }


@dataclass(frozen=True)
class FileColumns:
    """The columns a file holds: how many, and what it tells of them.

    Attributes:
        names: "" where it has none; None where it names no column.
        units: "" where they are not known.
        useless: number of a column -> what it holds instead of numbers, "" where it holds nothing.
        stamped: numbers of columns that hold dates or times of day.
        head: the first samples of a column by its number, where they are at hand.
        texts: numbers of columns that can be read as text, and whether they are known to be meant so.
    """

    count: int
    names: tuple[str, ...] | None = None
    units: tuple[str, ...] = ()
    useless: Mapping[int, str] = field(default_factory=dict)
    stamped: Collection[int] = ()
    head: Callable[[int], ArrayLike] | None = None
    texts: Mapping[int, bool] = field(default_factory=dict)

    def unit(self, number: int) -> str:
        """Unit of a column, "" where it is not known."""
        return self.units[number] if self.units else ""

    def label(self, number: int) -> int | str:
        """What a layout calls a column: its name, or its number where that tells more."""
        name = self.names[number] if self.names else ""
        return name if name and self.names and self.names.count(name) == 1 else number


@dataclass(frozen=True)
class ColumnChoice:
    """The columns to read of the file `place`.

    Attributes:
        time: number of the column with the stamps; of any column where sampling is `even`.
        signals: name -> number of a column, from 0.
        units: name -> unit.
        seconds: unit of the stamps, or the step of an even sampling [s].
        layout: what was asked for, and what was seen.
        notes: what was seen and not said, a line each.
        texts: those that hold text.
    """

    place: Path
    time: int
    signals: Mapping[str, int]
    units: Mapping[str, str]
    seconds: float
    layout: Layout
    notes: tuple[str, ...] = ()
    even: bool = False
    texts: frozenset[str] = frozenset()

    @property
    def wanted(self) -> list[int]:
        """Every column that is needed, ascending."""
        return sorted({self.time, *self.signals.values()})

    def recording(
        self,
        column: Callable[[int], ArrayLike],
        name: str = "",
        stamps: Stamps | None = None,
        notes: Sequence[str] = (),
        words: Callable[[int], tuple[FloatArray, tuple[str, ...]]] | None = None,
    ) -> Recording:
        """The recording that results when `column` gives the samples (K,) of a column by its number.

        Args:
            words: gives numbers (K,) for a column of text, and the texts that they stand for.
            name: what the file calls it; without one it is named after the file.
            stamps: the times, where they are no numbers.
            notes: what else was seen in the file.

        Raises:
            TraceError: fewer than two distinct stamps, or one that is not finite; numbers of an unknown unit that look
                like days or like milliseconds since 1970.
        """
        if self.even:
            time, told = self.seconds * np.arange(len(np.asarray(column(self.time))), dtype=np.float64), ""
        else:
            time, told = unwrapped(self._numbers(column(self.time))) if stamps is None else (stamps.time, "")
        coded = {key: words(self.signals[key]) for key in self.texts} if words is not None else {}
        signals = {key: coded[key][0] if key in coded else column(index) for key, index in self.signals.items()}
        trace, report = ordered(time, signals, self.units, str(self.place))
        trace = replace(trace, texts={key: texts for key, (_, texts) in coded.items()})
        found = stamps or Stamps(time, notes=_coarse(time / self.seconds, self.seconds))
        return Recording(
            replace(trace, name=name or self.place.stem),
            report,
            self.place,
            sha256(self.place),
            (*notes, *self.notes, *found.notes, *filter(None, [told])),
            found.start,
            layout=self.layout,
        )

    def _numbers(self, column: ArrayLike) -> FloatArray:
        stamps = np.asarray(column, dtype=float)
        if self.seconds == 1.0 and not self.layout.units.get("time") and stamps.ndim == 1 and len(stamps) > 1:
            _check_scale(stamps, self.place)
        return stamps if self.seconds == 1.0 else stamps * self.seconds


def _coarse(stamps: FloatArray, unit: float) -> tuple[str, ...]:
    """A line about whole numbers (K,) of a unit [s] that doubles do not tell apart."""
    largest = float(np.abs(stamps).max(initial=0.0))
    return (f"its times are kept to {np.spacing(largest) * unit:.1g} s",) if 2.0**53 <= largest < np.inf else ()


_SCALES = (
    (20_000, 80_000, 1e-5, "d", "days since 1900, as spreadsheets count them"),
    (690_000, 800_000, 1e-5, "d", "days since year 0, as MATLAB counts them"),
    (3e11, 1e13, np.inf, "ms", "milliseconds since 1970"),
    (3e14, 1e17, np.inf, "us", "microseconds since 1970"),
    (3e17, 1e20, np.inf, "ns", "nanoseconds since 1970"),
)
"""Times between two bounds, with a smaller mean step than the third: which unit, and what they look like.

Days are told by steps of whole seconds, too.
"""


def _check_scale(stamps: FloatArray, place: Path) -> None:
    known = stamps[np.isfinite(stamps)]
    low, high = (float(known.min()), float(known.max())) if len(known) else (0.0, 0.0)
    step = (high - low) / (len(stamps) - 1)
    if 1.9e13 < low < high < 2.2e13:
        seen = f"its times from {low:.0f} to {high:.0f} look like dates and times of day"
        raise TraceError(place, seen, "write them as 20260102T030405.123")
    for least, most, widest, unit, what in _SCALES:
        if least < low < high < most and (step < widest or (unit == "d" and _is_whole_seconds(step * 86400))):
            seen = f"its times from {low:.12g} to {high:.12g} look like {what}"
            raise TraceError(place, seen, f"say `units: {{time: {unit}}}`, or s")


def _is_whole_seconds(step: float) -> bool:
    """Whether a mean step [s] is one of slow loggers: 1, 2, ... 10 s."""
    return round(step) in range(1, 11) and bool(np.isclose(step, round(step), rtol=1e-3))


def choose(layout: Layout, columns: FileColumns, place: Path) -> ColumnChoice:
    """The columns of the file at `place` that `layout` asks for.

    Raises:
        TraceError: a column is not there, or its name is missing or ambiguous; an unknown unit of time.
    """
    time, notes = (None, []) if layout.step is not None else _time(layout, columns, place)
    if time is not None and columns.useless.get(time):
        what = f"holds {columns.useless[time]}, no times"
        fix = "write them as 2026-01-02T03:04:05.678, or choose another `time` in the layout"
        raise TraceError(f"{place}: column {_quoted(columns.label(time))}", what, fix)
    columns = replace(columns, useless={**dict.fromkeys(set(columns.stamped) - {time}, "times"), **columns.useless})
    wanted = {n for n, ours in columns.texts.items() if layout.texts and (ours or layout.columns is not None)}
    columns = replace(columns, useless={n: held for n, held in columns.useless.items() if n not in wanted})
    signals = _signals(layout, columns, time, place, notes)
    time_name = columns.names[time] if columns.names and time is not None else "time"
    stray = set(layout.units) - set(signals) - {time_name, "time"}
    if stray:
        raise TraceError(place, f"units are given for '{min(stray)}', which is not read", "correct the layout")
    texts = frozenset(name for name, number in signals.items() if number in wanted)
    told = {name: columns.unit(number) for name, number in signals.items()}
    units = {name: unit for name in signals if (unit := layout.units.get(name, told[name]))}
    seen = replace(layout, columns={name: columns.label(number) for name, number in signals.items()}, units=units)
    if time is None:
        if not signals:
            raise TraceError(place, "holds no columns of numbers", "check that it is a recording")
        assert layout.step is not None
        return ColumnChoice(
            place, min(signals.values()), signals, units, layout.step, seen, tuple(notes), even=True, texts=texts
        )
    unit = _unit_of_time(layout, columns, time, time_name, place, notes)
    seen = replace(seen, time=columns.label(time), units=({"time": unit} if unit else {}) | units)
    return ColumnChoice(place, time, signals, units, SECONDS[unit], seen, tuple(notes), texts=texts)


def _time(layout: Layout, columns: FileColumns, place: Path) -> tuple[int, list[str]]:
    """The column with the stamps, and what was seen of it."""
    if layout.time is not None:
        return _number(layout.time, columns, place), []
    names = columns.names or ()
    named = [number for number, name in enumerate(names) if name == "time"] or [
        number for number, name in enumerate(names) if names_time(name) and not columns.useless.get(number)
    ]
    stamped = list(columns.stamped) if len(columns.stamped) == 1 else []
    meant = next((number for number, name in enumerate(names) if names_time(name)), None)
    if meant is not None and not (named or stamped):
        return meant, []
    found = named or stamped or [number for number in range(columns.count) if _rises(columns, number)]
    if len(found) != 1:
        raise _unknown_time(columns, found, place)
    called = columns.label(found[0])
    if called == "time":
        return found[0], []
    return found[0], [
        f"its time is taken from column {_quoted(called)}" + ("" if named or stamped else ", which alone rises")
    ]


def _unknown_time(columns: FileColumns, found: list[int], place: Path) -> TraceError:
    fix = "say which one is `time` in the layout (--time), or `time: {step: 0.001}` where it has none"
    if len(found) > 1:
        which = ", ".join(_quoted(columns.label(number)) for number in found[:6])
        return TraceError(place, f"has {len(found)} columns that may be the time: {which}", fix)
    if columns.names is None:
        return TraceError(place, "names no columns, and none is surely the time", f"{fix}, by its number from 0")
    return TraceError(place, f"has no column 'time'; it holds {_listed(columns.names)}", fix)


def _rises(columns: FileColumns, number: int) -> bool:
    if number in columns.useless or columns.head is None:
        return number in columns.stamped
    head = np.asarray(columns.head(number), dtype=float)
    return number in columns.stamped or (len(head) >= SURE and bool(np.all(np.diff(head) > 0)))


def _number(column: int | str, columns: FileColumns, place: Path) -> int:
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
    found = [number for number, name in enumerate(columns.names) if name in (column, split(column)[0])]
    if len(found) == 1:
        return found[0]
    if found:
        raise TraceError(place, f"has {len(found)} columns named '{column}'", "give the column's number")
    raise TraceError(place, f"has no column '{column}'", f"it holds {_listed(columns.names)}")


def _signals(layout: Layout, columns: FileColumns, time: int | None, place: Path, notes: list[str]) -> dict[str, int]:
    if layout.columns is None:
        return _all(columns, time, notes)
    signals = {name: _number(column, columns, place) for name, column in layout.columns.items()}
    for number in signals.values():
        if number in columns.useless:
            held = columns.useless[number] or "nothing"
            what = f"holds {held}" + ("" if " samples " in held else ", not numbers")
            raise TraceError(f"{place}: column {_quoted(columns.label(number))}", what, "choose another column")
    return signals


def _all(columns: FileColumns, time: int | None, notes: list[str]) -> dict[str, int]:
    """Every column that holds numbers, each under a name of its own."""
    names = columns.names or ("",) * columns.count
    signals: dict[str, int] = {}
    for number, name in enumerate(names):
        if number == time:
            continue
        if number in columns.useless:
            if columns.useless[number]:
                notes.append(f"column {_quoted(name or number)} holds {columns.useless[number]} and is left out")
            continue
        own = _own_name(
            name or f"column_{number}", {*signals, *names[number + 1 :]} if names.count(name) == 1 else signals
        )
        if own != name and columns.names:
            notes.append(f"column {number}, {_quoted(name) if name else 'without a name'}, is called '{own}'")
        signals[own] = number
    return signals


def _own_name(name: str, taken: Collection[str]) -> str:
    tries = (name, *(f"{name}_{number}" for number in range(2, len(taken) + 3)))
    return next(one for one in tries if one not in taken)


def _unit_of_time(
    layout: Layout, columns: FileColumns, time: int, time_name: str, place: Path, notes: list[str]
) -> str:
    said = layout.units.get("time", layout.units.get(time_name))
    unit = columns.unit(time) if said is None else said
    if not unit and said is None and (unit := time_unit(time_name)):
        notes.append(f"its time is in {unit}, by its name")
    if unit not in SECONDS:
        raise TraceError(
            place, f"its time is in '{unit}'", "say `units: {time: ...}` in the layout: s, ms, us, ns, min, h, d"
        )
    if not (unit or said or time in columns.stamped):
        if layout.time is None and columns.label(time) != "time":
            notes.append("its time is taken to be in seconds")
        elif columns.head is not None and _counts(np.asarray(columns.head(time), dtype=float)):
            notes.append("its time has whole numbers and no unit, and is taken to be in seconds (`units: {time: ms}`)")
    return unit


def _counts(head: FloatArray) -> bool:
    """Whether stamps may count something finer than seconds: whole numbers in steps of more than one."""
    steps = np.diff(head)
    return len(steps) > 0 and bool((head == np.rint(head)).all() and np.median(steps) > 1)


def _quoted(column: int | str) -> str:
    return f"'{column[:40]}'" if isinstance(column, str) else str(column)


def _listed(names: tuple[str, ...], most: int = 20) -> str:
    return listed([f"'{name[:40]}'" for name in names], most)
