"""What a section of a report is made of: each piece of content is data that knows its HTML, with every text escaped."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, Protocol

import plotly.graph_objects as go
import plotly.io

from orchestrator.display.table import Cell, table, text

CalloutKind = Literal["ok", "warning", "error"]

# The buttons are listed one by one because plotly's own choice can upload the figure to its maker.
CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "showSendToCloud": False,
    "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
}
MARKS: dict[CalloutKind, str] = {"ok": "✓", "warning": "!", "error": "✕"}


class Content(Protocol):
    """Anything that can stand in a section."""

    def html(self, key: str) -> str:
        """Its markup; `key` is unique in the document and fit for an id."""


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str

    def html(self, key: str) -> str:
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Callout:
    """A sentence that must not be overlooked."""

    kind: CalloutKind
    text: str

    def html(self, key: str) -> str:
        mark = f'<span class="mark" role="img" aria-label="{self.kind}">{MARKS[self.kind]}</span>'
        return f'<div class="callout {self.kind}">{mark}<p>{escape(self.text)}</p></div>'


@dataclass(frozen=True)
class Highlights:
    """A row of key figures: (label, value, remark) each."""

    entries: Sequence[tuple[str, Cell, str]]

    def html(self, key: str) -> str:
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

    def html(self, key: str) -> str:
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

    def html(self, key: str) -> str:
        return f'<div class="table" tabindex="0">{table(self.headers, self.rows, self.numeric, self.caption)}</div>'


@dataclass(frozen=True)
class Figure:
    """A plotly figure across the whole width."""

    figure: go.Figure
    caption: str = ""

    def html(self, key: str) -> str:
        height = self.figure.layout.height or 450
        plot = plotly.io.to_html(
            self.figure,
            config=CONFIG,
            include_plotlyjs=False,
            full_html=False,
            div_id=f"figure-{key}",
            default_height=f"{height}px",
        )
        caption = f"<figcaption>{escape(self.caption)}</figcaption>" if self.caption else ""
        return f"<figure>{plot}{caption}</figure>"
