"""A list of what turned out well or not, with a page behind each entry; a reader may look at what failed alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from urllib.parse import quote

from orchestrator.display.table import Cell, text
from orchestrator.report.columns import Columns
from orchestrator.report.content import CalloutKind, Content, mark


@dataclass(frozen=True)
class ListEntry:
    """A line of the list.

    Attributes:
        page: the file behind it, from where the list is, with `/`; None where there is none.
        cells: what stands below the headers.
        more: what is seen when it is opened.
    """

    kind: CalloutKind
    name: str
    page: str | None
    cells: Sequence[Cell]
    more: Sequence[Content] = ()


@dataclass(frozen=True)
class Entries:
    """The list, below its headers: what it is of, then the cells'."""

    headers: Sequence[str]
    entries: Sequence[ListEntry]

    def html(self, key: str, columns: Columns) -> str:
        head = "".join(f"<th>{escape(header)}</th>" for header in ("", *self.headers))
        rows = "".join(_row(entry, f"{key}-{number}", columns) for number, entry in enumerate(self.entries, 1))
        listed = f'<table class="entries"><thead><tr>{head}</tr></thead>{rows}</table>'
        return f'{_CHOICE}<div class="table" tabindex="0">{listed}</div>'


_CHOICE = (
    '<fieldset class="choice"><legend>Show</legend>'
    '<label><input type="radio" name="shown" checked> all</label>'
    '<label><input type="radio" name="shown" class="failed"> what failed</label></fieldset>'
)


def _row(entry: ListEntry, key: str, columns: Columns) -> str:
    name = escape(entry.name).replace("/", "/<wbr>")  # where a narrow window breaks a path
    linked = name if entry.page is None else f'<a href="{escape(quote(entry.page))}">{name}</a>'
    cells = "".join(map(_cell, entry.cells))
    row = f"<tr><td>{mark(entry.kind)}</td><td>{linked}</td>{cells}</tr>"
    if entry.more:
        inside = "".join(piece.html(f"{key}-{place}", columns) for place, piece in enumerate(entry.more, 1))
        opened = " open" if entry.kind != "ok" else ""
        folded = f"<details{opened}><summary>cases</summary>{inside}</details>"
        row += f'<tr class="more"><td></td><td colspan="{len(entry.cells) + 1}">{folded}</td></tr>'
    return f'<tbody class="{entry.kind}">{row}</tbody>'


def _cell(cell: Cell) -> str:
    kind = "" if isinstance(cell, str) else ' class="n"'
    return f"<td{kind}>{escape(text(cell))}</td>"
