"""How a table of text is laid out: separator, decimal mark, which lines are headings and units, what columns hold."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats import headings
from orchestrator.formats.layout import Decimal, Layout, Separator
from orchestrator.formats.texts.cells import Kind, decimal_mark, is_value, kind

SEPARATORS: dict[Separator, str] = {",": ",", ";": ";", "tab": "\t", "|": "|", "blank": " "}
ROWS = 300  # that are looked at
_UNIT_WORDS = re.compile(r"\b(units?|einheit(en)?)\b", re.IGNORECASE)
_SAID = re.compile(r"\s*\"?sep=(?P<mark>[,;|\t])\"?\s*", re.IGNORECASE)  # the first line of what is meant for Excel
NAME_WORDS = frozenset({"name", "names", "signal", "channel", "variable"})


@dataclass(frozen=True)
class GridRow:
    """The cells of a row and the number of its last line, from 1."""

    line: int
    cells: list[str]


@dataclass(frozen=True)
class TextGrid:
    """How a table of text is laid out.

    Attributes:
        separator: a key of `SEPARATORS`.
        header: number of the line that names the columns, from 1; 0 where none does.
        units_line: likewise of that with units.
        skipped: lines before the first sample.
        names: one a column, None where no line names them.
        kinds: what the cells of each column hold.
        head: the first samples.
        notes: what was seen and not said, a line each.
    """

    separator: Separator
    decimal: Decimal
    header: int
    units_line: int
    skipped: int
    names: tuple[str, ...] | None
    units: tuple[str, ...]
    kinds: tuple[Kind, ...]
    head: list[list[str]]
    notes: tuple[str, ...]


def grid(lines: Sequence[str], layout: Layout, place: Path) -> TextGrid:
    """How a table that begins with these lines is laid out: as the layout says, else as it looks.

    Raises:
        TraceError: no separator makes a table of it, or it looks two ways.
    """
    if said := _SAID.fullmatch(lines[0]):
        mark = next(name for name, mark in SEPARATORS.items() if mark == said["mark"])
        lines, layout = ["", *lines[1:]], replace(layout, separator=layout.separator or mark)
    separator, rows = _rows(lines, layout, place)
    width = _width(rows)
    body = [row.cells for row in _body(rows) if len(row.cells) == width]
    decimal = layout.decimal or decimal_mark((cell for cells in body for cell in cells), separator, place)
    typical = [_typical([kind(cells[column], decimal) for cells in body]) for column in range(width)]
    start = _start(rows, typical, decimal, layout, place)
    closed = not any(cells[-1] for cells in body)
    labels = [_fitted(row, width, closed) for row in _labels(rows[:start], width)]
    names, units, notes = _heading(labels, layout, place)
    head = [row.cells for row in rows[start:] if len(row.cells) == width]
    if layout.header is None:
        taken = {row.line for row in (names, units) if row}
        notes += _skipped([row for row in rows[:start] if row.line not in taken], lines)
    if separator != "," and layout.separator is None and place.suffix.lower() == ".csv":
        notes.append(f"its cells are separated by {separator}")
    if decimal != "." and layout.decimal is None:
        notes.append("its numbers have decimal commas")
    told, split_units = _split(names, width)
    return TextGrid(
        separator,
        decimal,
        names.line if names else 0,
        units.line if units else 0,
        rows[start - 1].line if start else 0,
        told,
        _units(units, split_units),
        tuple(_final([kind(cells[column], decimal) for cells in head]) for column in range(width)),
        head,
        tuple(notes),
    )


def _skipped(rows: Sequence[GridRow], lines: Sequence[str]) -> list[str]:
    """A note about rows that are neither headings nor comments nor samples."""
    numbers = [row.line for row in rows if not lines[row.line - 1].startswith(("#", "%"))]
    some = ", ".join(map(str, numbers[:9])) + (", ..." if numbers[9:] else "")
    return [f"lines above the samples that are skipped: {some}"] if numbers else []


def _rows(lines: Sequence[str], layout: Layout, place: Path) -> tuple[Separator, list[GridRow]]:
    """The separator, and the first rows."""
    found: list[tuple[Separator, list[GridRow]]] = []
    problem = None
    for name in SEPARATORS if layout.separator is None else [layout.separator]:
        try:
            found.append((name, _split_rows(lines, SEPARATORS[name])))
        except csv.Error as error:
            problem = problem or error
    best = max(found, key=lambda pair: _worth(pair[1]), default=None)
    if best is None or (problem and not _worth(best[1])[0]):
        raise TraceError(place, f"header line: {excerpt(problem)}", "check that it is a table of text") from None
    if not any(is_value(cell) and cell for row in best[1] for cell in row.cells):
        raise TraceError(place, "holds no numbers", "check that it is a table of text")
    return best


def _split_rows(lines: Sequence[str], mark: str) -> list[GridRow]:
    if mark == " ":
        return [GridRow(number, _blank_cells(line)) for number, line in enumerate(lines[:ROWS], 1) if line.strip()]
    reader = csv.reader((line + "\n" for line in lines[:ROWS]), delimiter=mark, strict=True)
    return [
        GridRow(reader.line_num, [cell.strip() for cell in cells]) for cells in reader if any(map(str.strip, cells))
    ]


def _blank_cells(line: str) -> list[str]:
    """Cells of a line between blanks; units in brackets belong to what is before them, comments are no cells."""
    text = line.strip()
    text = text.lstrip("#% \t") if text.startswith(("#", "%")) else text.partition("#")[0].rstrip()
    return text.split("\t") if "\t" in text else re.split(r"\s+(?![\[(])", text)


def _worth(rows: Sequence[GridRow]) -> tuple[bool, bool, float, int]:
    """How much of a table the rows are: whether it has columns, in the first row too, the share of samples, width."""
    body = _body(rows)
    width = _width(rows)
    values = sum(is_value(cell) for row in body for cell in row.cells if len(row.cells) == width)
    share = values / max(1, sum(len(row.cells) for row in body))
    return width > 1 and share > 0, bool(rows) and len(rows[0].cells) == width, round(share, 3), width


def _width(rows: Sequence[GridRow]) -> int:
    body = _body(rows)
    return Counter(len(row.cells) for row in body).most_common(1)[0][0] if body else 0


def _body(rows: Sequence[GridRow]) -> Sequence[GridRow]:
    """The rows behind the first quarter that may be samples."""
    return [row for row in rows[len(rows) // 4 :] if any(cell and is_value(cell) for cell in row.cells)]


def _typical(kinds: Sequence[Kind]) -> Kind:
    """What a column holds, headings among its cells or not."""
    values: list[Kind] = ["number" if one == "grouped" else one for one in kinds if one not in ("missing", "text")]
    if 3 * len(values) < kinds.count("text"):
        return "text"
    return Counter(values).most_common(1)[0][0] if values else "missing"


def _final(kinds: Sequence[Kind]) -> Kind:
    found = set(kinds) - {"missing"}
    if "grouped" in found and found <= {"grouped", "number"}:
        return "grouped"
    return _typical(kinds)


def _start(rows: Sequence[GridRow], typical: Sequence[Kind], decimal: Decimal, layout: Layout, place: Path) -> int:
    """The first row of samples."""
    first = max(layout.header or 0, layout.units_line or 0)
    for number, row in enumerate(rows):
        if row.line > first and len(row.cells) == len(typical) and not _is_label(row.cells, typical, decimal):
            return number
    raise TraceError(place, "holds no samples", "record or export it again")


def _is_label(cells: Sequence[str], typical: Sequence[Kind], decimal: Decimal) -> bool:
    """Whether a row is none of samples: text where numbers are, in a column of times or in most."""
    pairs = [(kind(cell, decimal), usual, cell) for cell, usual in zip(cells, typical, strict=True) if cell]
    sampled = [(found, cell) for found, usual, cell in pairs if usual not in ("text", "missing")]
    words = [cell for found, cell in sampled if found == "text"]
    return not sampled or sampled[0][0] == "text" or 2 * len(words) > len(sampled)


def _labels(rows: Sequence[GridRow], width: int) -> list[GridRow]:
    """The rows that may name columns or units: those directly above the samples that are about as wide."""
    found: list[GridRow] = []
    for row in reversed(rows):
        filled = sum(map(bool, row.cells))
        if len(row.cells) < width - 1 or (2 * filled < width and not _are_units(row.cells)):
            break
        found.insert(0, row)
    return found


def _fitted(row: GridRow, width: int, closed: bool) -> GridRow:
    """A cell for each column: names of rows have no heading, nor what is behind a mark that closes each row.

    Columns of remarks that LabVIEW names at the end have no samples.
    """
    short = len(row.cells) < width
    cells = [*row.cells, ""] if short and closed else ["", *row.cells] if short else row.cells[:width]
    return replace(row, cells=cells)


def _heading(labels: list[GridRow], layout: Layout, place: Path) -> tuple[GridRow | None, GridRow | None, list[str]]:
    """The rows with names and units of the columns, and notes."""
    by_line = {row.line: row for row in labels}
    notes: list[str] = []
    if layout.units_line is not None:
        units = by_line.get(layout.units_line)
    else:
        first = labels[:1] if any(headings.names_time(cell) for row in labels[1:] for cell in row.cells) else []
        units = next((row for row in (*reversed(labels[1:]), *first) if _are_units(row.cells)), None)
    if layout.header is not None:
        names = by_line.get(layout.header)
        if names is None and layout.header:
            raise TraceError(place, f"line {layout.header} names no columns of it", "correct `header` in the layout")
        return names, units, notes
    others = [row for row in labels if row is not units]
    timely = [row for row in others if any(map(headings.names_time, row.cells))] or [
        row for row in others if row.cells[0].lower() in NAME_WORDS
    ]
    names = timely[0] if timely else others[-1] if others else None
    if names and units:
        notes.append(f"line {names.line} names its columns, line {units.line} their units")
    elif names and len(labels) > 1:
        notes.append(f"line {names.line} names its columns")
    return names, units, notes


def _are_units(cells: Sequence[str]) -> bool:
    if _UNIT_WORDS.search(cells[0]):
        return True
    if any(kind(cell, ".") == "number" and cell != "1" for cell in cells):
        return False
    filled = [headings.bare(cell) for cell in cells if cell not in ("", "1")]
    return 2 * sum(map(headings.is_unit, filled)) >= len(filled) > 0


def _split(names: GridRow | None, width: int) -> tuple[tuple[str, ...] | None, tuple[str, ...]]:
    if names is None:
        return None, ("",) * width
    pairs = [headings.split(cell) for cell in (names.cells[0].lstrip("#").strip(), *names.cells[1:])]
    return tuple(name for name, _ in pairs), tuple(unit for _, unit in pairs)


def _units(row: GridRow | None, told: Sequence[str]) -> tuple[str, ...]:
    if row is None:
        return tuple(told)
    first = "" if _UNIT_WORDS.search(row.cells[0]) else row.cells[0]
    return tuple(one or headings.bare(cell) for one, cell in zip(told, (first, *row.cells[1:]), strict=True))
