"""Workbooks (.xlsx), for which the extra `formats` installs openpyxl: a sheet is read as a table of text.

Formulas are not computed: the values are taken that the workbook keeps of them. Links to other files are not followed.
"""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Iterator, Sequence
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmus.errors import TraceError
from fmus.words import excerpt, listed
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording
from orchestrator.formats.texts.reading import read_text

if TYPE_CHECKING:
    from openpyxl.workbook import Workbook

MOST = 2**25  # cells of a sheet
LARGEST = 2**30  # bytes of a workbook when it is unpacked
SMALL = 2**26  # bytes that a workbook may be however tightly it is packed
PACKED = 100  # times that a larger one may be smaller in its archive


def read(path: Path, layout: Layout) -> Recording:
    """The wanted columns of the sheet that the layout names, or of the only one.

    Raises:
        TraceError: openpyxl is not there, the file is damaged, has several sheets, or no table in it.
    """
    try:
        import openpyxl  # noqa: PLC0415 (of an extra)
    except ImportError:
        raise TraceError(path, "an .xlsx file needs openpyxl", "pip install servotwin[formats]") from None
    try:
        with zipfile.ZipFile(path) as archive:
            size = sum(entry.file_size for entry in archive.infolist())
        if size > min(LARGEST, max(SMALL, PACKED * path.stat().st_size)):
            raise TraceError(path, f"is {size} bytes when it is unpacked", "export it as .csv")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True, keep_links=False)
        book._date_formats = set()  # days as numbers: as dates they are rounded to milliseconds
        sheet = _sheet(book, layout, path)
        others = [title for title in book.sheetnames if title != sheet] if layout.variable is None else []
        text = io.StringIO(newline="")
        csv.writer(text, lineterminator="\n").writerows(_rows(book, sheet, path))
        book.close()
    except TraceError:
        raise
    except Exception as problem:  # whatever a library makes of damage
        raise TraceError(path, f"is no readable workbook ({excerpt(problem)})", "export it as .csv") from None
    plain = replace(layout, variable=sheet, separator=",", decimal=".", encoding="utf-8")
    recording = read_text(io.BytesIO(text.getvalue().encode()), plain, path)
    assert recording.layout is not None
    notes = [f"its sheet '{sheet}' is read, not {', '.join(map(repr, others[:20]))}"] if others else []
    empty = [name for name, values in recording.trace.signals.items() if np.isnan(values).all()]
    if empty:
        notes.append(f"has no value of {listed(empty)}; those of formulas come when a spreadsheet saves them")
    seen = replace(recording.layout, separator=None, decimal=None, encoding=None)
    return replace(recording, layout=seen, notes=(*notes, *recording.notes))


def _sheet(book: Workbook, layout: Layout, path: Path) -> str:
    filled = [sheet.title for sheet in book.worksheets if sheet.sheet_state == "visible"]
    if layout.variable is not None:
        if layout.variable not in book.sheetnames:
            raise TraceError(path, f"has no sheet '{layout.variable}'", f"it holds {', '.join(book.sheetnames[:20])}")
        return layout.variable
    if len(filled) > 1:
        filled = [title for title in filled if next(book[title].iter_rows(min_row=2, max_row=2), None)]
    if len(filled) != 1:
        raise TraceError(
            path, f"holds {len(filled)} sheets ({', '.join(filled[:20])})", "name one as `variable` in the layout"
        )
    return str(filled[0])


def _rows(book: Workbook, sheet: str, path: Path) -> Iterator[Sequence[str]]:
    count = 0
    for row in book[sheet].iter_rows():
        count += len(row)
        if count > MOST:
            raise TraceError(path, f"holds more than {MOST} cells", "export it as .csv")
        yield [_cell(cell, book.epoch) for cell in row]


def _cell(cell: Any, epoch: datetime) -> str:
    """What a cell holds as text: instants to the microsecond, durations in seconds."""
    from openpyxl.styles.numbers import is_timedelta_format  # noqa: PLC0415 (of an extra)

    value = cell.value
    if value is None:
        return ""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return str(value)
    if not cell.is_date:
        return repr(value)
    if is_timedelta_format(cell.number_format):
        return repr(value * 86400.0)
    moment = epoch + timedelta(days=value)
    return str(moment if value >= 1 else moment.time())
