"""Tables as HTML, and numbers as people read them; every text is escaped."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from html import escape

import numpy as np

Cell = str | float | None


def table(
    headers: Sequence[str], rows: Sequence[Sequence[Cell]], numeric: Collection[int] | None = None, caption: str = ""
) -> str:
    """Rows under headers; `numeric` columns stand to the right, by default those that hold only numbers."""
    right = _numeric(rows) if numeric is None else numeric
    top = f"<caption>{escape(caption)}</caption>" if caption else ""
    head = "".join(_cell("th", header, number in right) for number, header in enumerate(headers))
    body = "".join(
        "<tr>" + "".join(_cell("td", cell, number in right) for number, cell in enumerate(row)) + "</tr>"
        for row in rows
    )
    return f"<table>{top}<thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"


def _numeric(rows: Sequence[Sequence[Cell]]) -> set[int]:
    columns = enumerate(zip(*rows, strict=True))
    return {number for number, cells in columns if not any(isinstance(cell, str) for cell in cells)}


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
