"""What a section of a report is made of: each piece of content is data that knows its HTML, with every text escaped."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, Protocol

from orchestrator.display.table import Cell, table, text
from orchestrator.report.columns import Columns

CalloutKind = Literal["ok", "warning", "error"]

MARKS: dict[CalloutKind, str] = {"ok": "✓", "warning": "!", "error": "✕"}


class Content(Protocol):
    """Anything that can stand in a section."""

    def html(self, key: str, columns: Columns) -> str:
        """Its markup; `key` is unique in the document and fit for an id; its numbers are added to the columns."""


class Drawing(Protocol):
    """Anything that is a figure: a chart, bars, a diagram."""

    def markup(self, key: str, columns: Columns, caption: str = "") -> str:
        """Its element; `key` is unique in the document and fit for an id; its numbers are added to the columns."""


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str

    def html(self, key: str, columns: Columns) -> str:
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Heading:
    """The heading of a part of a section."""

    text: str

    def html(self, key: str, columns: Columns) -> str:
        return f"<h3>{escape(self.text)}</h3>"


@dataclass(frozen=True)
class Callout:
    """A sentence that must not be overlooked."""

    kind: CalloutKind
    text: str

    def html(self, key: str, columns: Columns) -> str:
        return f'<div class="callout {self.kind}">{mark(self.kind)}<p>{escape(self.text)}</p></div>'


@dataclass(frozen=True)
class Highlights:
    """A row of key figures: (label, value, remark) each."""

    entries: Sequence[tuple[str, Cell, str]]

    def html(self, key: str, columns: Columns) -> str:
        tiles = "".join(
            f'<div class="tile"><dt>{escape(label)}</dt><dd>{escape(text(value))}</dd>'
            f"<dd class='remark'>{escape(remark)}</dd></div>"
            for label, value, remark in self.entries
        )
        return f'<dl class="highlights">{tiles}</dl>'


@dataclass(frozen=True)
class Facts:
    """Names and values in two columns, such as where the data came from."""

    entries: Sequence[tuple[str, Cell]]

    def html(self, key: str, columns: Columns) -> str:
        rows = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text(value))}</dd>" for name, value in self.entries)
        return f'<dl class="facts">{rows}</dl>'


@dataclass(frozen=True)
class DataTable:
    """Rows under headers; see `orchestrator.display.table`."""

    headers: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    numeric: Collection[int] | None = None
    caption: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headers):
                raise ValueError(f"a row of {len(row)} cells under {len(self.headers)} headers: {row}")

    def html(self, key: str, columns: Columns) -> str:
        return f'<div class="table" tabindex="0">{table(self.headers, self.rows, self.numeric, self.caption)}</div>'


@dataclass(frozen=True)
class DrawnFigure:
    """A drawing across the whole width."""

    drawing: Drawing
    caption: str = ""

    def html(self, key: str, columns: Columns) -> str:
        caption = f"<figcaption>{escape(self.caption)}</figcaption>" if self.caption else ""
        return f"<figure>{self.drawing.markup(key, columns, self.caption)}{caption}</figure>"


@dataclass(frozen=True)
class Folded:
    """Content that is there when a reader opens it; paper shows it."""

    title: str
    content: Sequence[Content]

    def html(self, key: str, columns: Columns) -> str:
        inside = "\n".join(piece.html(f"{key}-{place}", columns) for place, piece in enumerate(self.content, 1))
        return f"<details><summary>{escape(self.title)}</summary>\n{inside}</details>"


def mark(kind: CalloutKind) -> str:
    """A sign for how something turned out, which does not tell it by its colour alone."""
    return f'<span class="mark {kind}" role="img" aria-label="{kind}">{MARKS[kind]}</span>'
