"""Parameter lists: CSV files with a parameter in each row, its value and unit, and between which values it lies."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from fmus.errors import ScenarioError
from fmus.files import absence
from orchestrator.crossing import quantity
from orchestrator.documents.parsing import one_line

SUFFIX = ".csv"
COLUMNS = ("name", "value", "unit", "min", "max")
_DELIMITERS = (",", ";", "\t")
_MOST = 10_000_000  # bytes of a file


@dataclass(frozen=True)
class ListedParameter:
    """One row.

    Attributes:
        value, low, high: [unit]; None where nothing is said.
        unit: "" for that of the variable.
        place: file and line.
    """

    name: str
    value: float
    low: float | None
    high: float | None
    unit: str
    place: str

    def written(self, number: float) -> float | str:
        """A number of the row with its unit, as study files have them: `40 kg.cm2`."""
        return f"{number!r} {self.unit}" if self.unit else number


def read(file: Path) -> list[ListedParameter]:
    """The rows of a list: columns name, value, unit, min and max in any order, the last three not needed.

    Rows without anything, and those that begin with #, are passed over.

    Raises:
        ScenarioError: it is no such list, or a row gives a name again, no number, or a value outside of its bounds.
    """
    if not file.is_file():
        raise ScenarioError(file, absence(file), "check the path")
    if file.suffix.lower() != SUFFIX:
        raise ScenarioError(
            file, "is no list of parameters", "give a CSV file with columns name, value, unit, min, max"
        )
    if file.stat().st_size > _MOST:
        raise ScenarioError(file, f"has more than {_MOST // 1_000_000} MB", "give a list of parameters")
    try:
        rows = [(n, row) for n, row in enumerate(_rows(file), 1) if any(row) and not row[0].startswith("#")]
    except (UnicodeDecodeError, csv.Error) as error:
        raise ScenarioError(file, f"is no CSV file in UTF-8 ({error})", "save it as such") from None
    for line, row in rows:
        if not all(cell.isprintable() for cell in row):
            raise ScenarioError(f"{file}:{line}", "holds what cannot be printed", "save it as text in UTF-8")
    if not rows:
        raise ScenarioError(file, "is empty", f"begin it with the columns {', '.join(COLUMNS)}")
    (line, header), *others = rows
    columns = _columns(f"{file}:{line}", header)
    found: dict[str, ListedParameter] = {}
    for number, row in others:
        one = _parameter(f"{file}:{number}", columns, row)
        if one.name in found:
            raise ScenarioError(one.place, f"{one.name} stands at {found[one.name].place}, too", "leave one")
        found[one.name] = one
    return list(found.values())


def _rows(file: Path) -> Iterator[list[str]]:
    with file.open(encoding="utf-8-sig", newline="") as text:
        first = text.readline()
        delimiter = max(_DELIMITERS, key=first.count)
        text.seek(0)
        for row in csv.reader(text, delimiter=delimiter, strict=True):
            yield [cell.strip() for cell in row]


def _columns(place: str, header: Sequence[str]) -> dict[str, int]:
    """Name of a column -> where it stands."""
    names = [name.lower() for name in header]
    for name in names:
        if name not in COLUMNS:
            raise ScenarioError(place, f"column '{one_line(name)}' is unknown", f"there are {', '.join(COLUMNS)}")
        if names.count(name) > 1:
            raise ScenarioError(place, f"column '{name}' stands twice", "leave one")
    for name in COLUMNS[:2]:
        if name not in names:
            raise ScenarioError(place, f"has no column '{name}'", f"begin with the columns {', '.join(COLUMNS)}")
    return {name: number for number, name in enumerate(names)}


def _parameter(place: str, columns: dict[str, int], row: Sequence[str]) -> ListedParameter:
    if len(row) != len(columns):
        raise ScenarioError(place, f"has {len(row)} cells for {len(columns)} columns", "quote cells that hold commas")
    cells = {name: row[number] for name, number in columns.items()}
    if not cells["name"]:
        raise ScenarioError(place, "has no name", "name it component.variable")
    numbers = {key: _number(place, key, cells.get(key, "")) for key in ("value", "min", "max")}
    value, low, high = numbers["value"], numbers["min"], numbers["max"]
    if value is None:
        raise ScenarioError(f"{place}: value", "is empty", "give a number")
    if (low is not None and value < low) or (high is not None and value > high):
        span = f"{'-' if low is None else f'{low:g}'} to {'-' if high is None else f'{high:g}'}"
        raise ScenarioError(place, f"{cells['name']} of {value:g} is outside of its bounds, {span}", "move one of them")
    unit = "" if cells.get("unit", "") == "1" else cells.get("unit", "")
    if unit and quantity(f"{value!r} {unit}") is None:
        raise ScenarioError(f"{place}: unit", f"'{one_line(unit)}' is no unit", "write it like kg.m2")
    return ListedParameter(cells["name"], value, low, high, unit, place)


def _number(place: str, column: str, text: str) -> float | None:
    """What a cell says, None where it says nothing."""
    if not text:
        return None
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ScenarioError(f"{place}: {column}", f"'{one_line(text)}' is no number", "write it like 0.004 or 4e-3")
    return number
