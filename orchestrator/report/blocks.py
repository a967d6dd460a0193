"""What a section of a report is made of: each block is data that knows its HTML, with every text escaped."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from html import escape
from typing import Literal, Protocol

import numpy as np
import plotly.graph_objects as go
import plotly.io

Cell = str | float | None
Kind = Literal["ok", "warning", "error"]

# The buttons are listed one by one because plotly's own choice can upload the figure to its maker.
CONFIG = {
    "displaylogo": False,
    "responsive": True,
    "showSendToCloud": False,
    "modeBarButtons": [["zoom2d", "pan2d", "resetScale2d", "toImage"]],
}
MARKS: dict[Kind, str] = {"ok": "✓", "warning": "!", "error": "✕"}


class Block(Protocol):
    """Anything that can stand in a section."""

    def html(self, key: str) -> str:
        """Markup of the block; `key` is unique in the document and fit for an id."""


@dataclass(frozen=True)
class Paragraph:
    """Running text."""

    text: str

    def html(self, key: str) -> str:
        return f"<p>{escape(self.text)}</p>"


@dataclass(frozen=True)
class Callout:
    """A sentence that must not be overlooked."""

    kind: Kind
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
class Table:
    """Rows under headers; `numeric` columns stand to the right, by default those that hold only numbers."""

    headers: Sequence[str]
    rows: Sequence[Sequence[Cell]]
    numeric: Collection[int] | None = None
    caption: str = ""

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.headers):
                raise ValueError(f"a row of {len(row)} cells under {len(self.headers)} headers: {row}")

    def html(self, key: str) -> str:
        right = self._right()
        caption = f"<caption>{escape(self.caption)}</caption>" if self.caption else ""
        head = "".join(_cell("th", header, number in right) for number, header in enumerate(self.headers))
        body = "".join(
            "<tr>" + "".join(_cell("td", cell, number in right) for number, cell in enumerate(row)) + "</tr>"
            for row in self.rows
        )
        table = f"<table>{caption}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
        return f'<div class="table" tabindex="0">{table}</div>'

    def _right(self) -> Collection[int]:
        if self.numeric is not None:
            return self.numeric
        columns = enumerate(zip(*self.rows, strict=True))
        return {number for number, cells in columns if not any(isinstance(cell, str) for cell in cells)}


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


def text(cell: Cell) -> str:
    """A cell as text: five significant digits, a true minus sign, a dash for nothing."""
    if cell is None:
        return "–"
    if isinstance(cell, str):
        return cell
    if isinstance(cell, (bool, np.bool_)):
        return "yes" if cell else "no"
    if math.isfinite(cell) and isinstance(cell, (int, np.integer)):
        return str(cell).replace("-", "−")
    return _power(f"{cell:.5g}").replace("-", "−")


def _power(number: str) -> str:
    mantissa, e, exponent = number.partition("e")
    return f"{mantissa}e{int(exponent)}" if e else number


def _cell(tag: str, cell: Cell, right: bool) -> str:
    kind = ' class="n"' if right else ""
    return f"<{tag}{kind}>{escape(text(cell))}</{tag}>"
