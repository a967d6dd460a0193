"""A table of text as a recording."""

from __future__ import annotations

import io
import re
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
from pyarrow import compute, csv

from fmus.encodings import SAMPLE, decoded, encoding_of
from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats.arrow import numbers, texts
from orchestrator.formats.layout import ColumnChoice, Decimal, FileColumns, Layout, choose
from orchestrator.formats.recording import Recording
from orchestrator.formats.texts.cells import GROUPS, MINUS, MISSING, is_time_of_day, kind
from orchestrator.formats.texts.grid import SEPARATORS, TextGrid, grid
from orchestrator.formats.texts.stamps import seconds
from orchestrator.trace import FloatArray

TYPES = {"number": pa.float64(), "missing": pa.float64(), "flag": pa.bool_()}
DATES = ("date", "datum")
_CLOCK = re.compile(r"[0-2]\d[0-5]\d[0-5]\d([.,]\d+)?")
DIGITS = 17  # of a double
_NO_DIGITS = re.compile(r"^[-+]?[0.,]*|[eE].*$|[.,]")  # of those that tell a number
NULLS = [
    spelling for word in MISSING for spelling in {word, word.upper(), word.capitalize(), word.replace("nan", "NaN")}
]


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns; the others may hold anything.

    Raises:
        TraceError: no table, one that looks two ways, a column that is not there, text in a number, a row of another
            length.
    """
    with path.open("rb") as file:
        return read_text(file, layout, path)


def read_text(file: BinaryIO, layout: Layout, path: Path) -> Recording:
    """The same of a text that is at hand; `path` is where it is from."""
    lines, encoding = _first_lines(file, layout.encoding, path)
    seen = grid(lines, layout, path)
    told = replace(
        layout,
        encoding=encoding,
        separator=seen.separator,
        decimal=seen.decimal,
        header=seen.header,
        units_line=seen.units_line,
    )
    choice = choose(told, _columns(seen), path)
    stamped = seen.kinds[choice.time] == "stamp"
    dates = _dates_beside(seen, choice.time) if stamped else None
    if not stamped and not (layout.units.keys() & {"time", choice.layout.time}):
        _check_clock(seen, choice.time, path)
    table = _table(file, seen, encoding, choice, dates)
    guessed = [f"its text is {encoding}"] if layout.encoding is None and not encoding.startswith("utf-8") else []

    def column(number: int) -> FloatArray:
        if seen.kinds[number] == "grouped":
            return _ungrouped(table[str(number)], seen.decimal, path)
        return numbers(table[str(number)])

    def words(number: int) -> tuple[FloatArray, tuple[str, ...]]:
        return texts(table[str(number)])

    times = table[str(choice.time)]
    notes = [*guessed, *seen.notes]
    if not stamped and any(len(_NO_DIGITS.sub("", row[choice.time])) > DIGITS for row in seen.head):
        notes.append(f"its times have more than {DIGITS} digits, of which the last are not kept")
    if dates is not None:
        times = compute.binary_join_element_wise(compute.utf8_trim_whitespace(table[str(dates)]), times, " ")
        notes.append(f"its dates are those of column {seen.names[dates] if seen.names else dates}")
    stamps = seconds(times, layout.dates, layout.time_zone, path) if stamped else None
    return choice.recording(column, "", stamps, notes, words)


def _first_lines(file: BinaryIO, encoding: str | None, path: Path) -> tuple[list[str], str]:
    """The first lines of a file, whole ones only, and its encoding: the one that is said, else what it looks like."""
    raw = file.read(SAMPLE + 1)
    file.seek(0)
    whole = len(raw) <= SAMPLE
    if raw.endswith(b"\0" * 4):
        raise TraceError(path, _zeros(len(raw.rstrip(b"\0"))), "cut them off")
    seen = encoding_of(raw, whole=whole)
    known = encoding or seen.name
    if encoding is None and not seen.sure:
        problem = f"is not UTF-8 text, nor surely cp1252 or gbk; say its `encoding` (most like {known})"
        raise TraceError(path, problem)
    try:
        text = decoded(raw[:SAMPLE], known, whole=whole)
    except LookupError:
        raise TraceError(path, f"'{known}' is no encoding of text", "say `encoding: utf-8`, cp1252, gbk, ...") from None
    except UnicodeError:
        raise TraceError(path, f"is not {known.upper()} text", "say its `encoding`: cp1252, utf-16, gbk, ...") from None
    if "\0" in text:
        raise TraceError(path, "is no text", "check that it is a table of text, or say its `encoding`")
    lines = re.split(r"\r\n|\n|\r", text)
    if not whole and len(lines) == 1:
        raise TraceError(path, f"a header line is longer than {SAMPLE} bytes", "check that it is a table of text")
    return lines[:-1] if not whole or not lines[-1] else lines, known


def _dates_beside(seen: TextGrid, time: int) -> int | None:
    """The column with the dates of times of day; None where they have theirs, or it is not sure which it is."""
    dates = [number for number, held in enumerate(seen.kinds) if held == "date"]
    times = [row[time] for row in seen.head if kind(row[time], seen.decimal) == "stamp"]
    return dates[0] if len(dates) == 1 and all(map(is_time_of_day, times)) else None


def _check_clock(seen: TextGrid, time: int, path: Path) -> None:
    """Numbers beside dates that may be hours, minutes and seconds are not taken for seconds."""
    names = seen.names or ("",) * len(seen.kinds)
    dated = any(held == "date" or name.lower() in DATES for held, name in zip(seen.kinds, names, strict=True))
    if dated and all(_CLOCK.fullmatch(row[time]) for row in seen.head):
        what = f"such as {seen.head[0][time]} beside a date may be hours, minutes and seconds"
        fix = "write them as 09:30:00.5, or say `units: {time: s}` in the layout"
        raise TraceError(f"{path}: column '{names[time] or time}'", what, fix)


def _columns(seen: TextGrid) -> FileColumns:
    def head(number: int) -> list[float]:
        cells = [row[number] for row in seen.head]
        return [
            float(cell.replace(seen.decimal, ".")) if kind(cell, seen.decimal) == "number" else np.nan for cell in cells
        ]

    useless = {number: "text" for number, held in enumerate(seen.kinds) if held == "text"}
    stamped = [number for number, held in enumerate(seen.kinds) if held == "stamp"]
    taken = [_dates_beside(seen, number) for number in stamped]
    useless |= {n: "" if n in taken else "dates" for n, held in enumerate(seen.kinds) if held == "date"}
    if seen.names:
        useless |= {n: "" for n, held in enumerate(seen.kinds) if held == "missing" and not seen.names[n]}
    worded = dict.fromkeys((number for number, held in enumerate(seen.kinds) if held == "text"), False)
    return FileColumns(len(seen.kinds), seen.names, seen.units, useless, stamped, head, worded)


def _table(file: BinaryIO, seen: TextGrid, encoding: str, choice: ColumnChoice, dates: int | None) -> Any:
    names = [str(number) for number in range(len(seen.kinds))]
    wanted = [names[number] for number in sorted({*choice.wanted, *([] if dates is None else [dates])})]
    reading = csv.ReadOptions(
        column_names=names, skip_rows=seen.skipped, use_threads=False, encoding=encoding.replace("utf-8-sig", "utf8")
    )
    mark = "\t" if seen.separator == "blank" else SEPARATORS[seen.separator]
    converting = csv.ConvertOptions(
        include_columns=wanted,
        decimal_point=seen.decimal,
        null_values=NULLS,
        strings_can_be_null=True,
        column_types={name: TYPES.get(seen.kinds[int(name)], pa.string()) for name in wanted},
    )
    try:
        if seen.separator == "blank":
            file, reading.encoding = _unblanked(file.read(), encoding), "utf8"
        return csv.read_csv(file, reading, csv.ParseOptions(delimiter=mark), converting)
    except (pa.ArrowInvalid, pa.ArrowKeyError, UnicodeError) as problem:
        file.seek(0)
        text = file.read().decode(reading.encoding, "replace")
        raise _bad_row(str(problem), text, seen, choice.place) from None


def _bad_row(problem: str, text: str, seen: TextGrid, place: Path) -> TraceError:
    """What Arrow cannot read, with the line of the file: Arrow counts no empty ones."""
    fix = "correct or cut that row"
    if "\0" in text:
        return TraceError(place, _zeros(len(text.partition("\0")[0].encode())), "cut them off")
    row = re.search(r"Row #(\d+): (.*)", problem)
    if row is None:
        return TraceError(place, excerpt(problem), fix)
    filled = [number for number, line in enumerate(re.split(r"\r\n|\n|\r", text), 1) if line]
    samples = [number for number in filled if number > seen.skipped]
    nth = int(row[1]) - seen.skipped - 1
    line = f"line {samples[nth]}" if 0 <= nth < len(samples) else f"row {row[1]}"  # cells may go over lines
    cell = re.search(r"column #(\d+): .*invalid value (.*)", problem)
    if cell is None:
        return TraceError(place, f"{line}: {excerpt(row[2])}", fix)
    column = seen.names[int(cell[1])] if seen.names else cell[1]
    return TraceError(place, f"{line}, column '{column}': {excerpt(cell[2])} is no number", fix)


def _zeros(begin: int) -> str:
    return f"holds zero bytes from byte {begin} on, as a loss of power leaves them"


def _unblanked(content: bytes, encoding: str) -> BinaryIO:
    """The text with a tab between cells, without what stands behind `#`; as many lines as before."""
    text = content.decode(encoding).replace("\r\n", "\n").replace("\r", "\n")
    text = re.sub(r"[ \t]*(#.*)?$", "", text, flags=re.MULTILINE)
    return io.BytesIO(re.sub(r"(?<=\S)[ \t]+", "\t", re.sub(r"^[ \t]+", "", text, flags=re.MULTILINE)).encode())


def _ungrouped(texts: Any, decimal: Decimal, path: Path) -> FloatArray:
    """Numbers with marks of thousands, 1,234.5 or 1.234,5, or a minus as it is typeset."""
    groups = GROUPS[decimal]
    number = rf"(\d{{1,3}}([{groups}]\d{{3}})+|\d+)([{decimal}]\d*)?|[{decimal}]\d+"
    texts = compute.utf8_trim_whitespace(texts)
    odd = compute.invert(compute.match_substring_regex(texts, rf"^[+{MINUS}-]?({number})([eE][+-]?\d+)?$"))
    if compute.any(odd).as_py():
        text = texts.filter(odd)[0].as_py()
        raise TraceError(path, f"has '{text[:40]}' among numbers with marks of thousands", "correct or cut that row")
    plain = compute.replace_substring_regex(texts, f"[{groups}]", "")
    return numbers(compute.replace_substring(compute.replace_substring(plain, decimal, "."), MINUS, "-"))
