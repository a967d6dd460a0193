"""What was asked and how it turned out, a row each, with a sign that does not tell it by its colour alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

from orchestrator.display.table import Cell, text
from orchestrator.report.columns import Columns
from orchestrator.report.content import CalloutKind, mark

INDENT = 1.4  # of what a question is made of [em]


@dataclass(frozen=True)
class CheckRow:
    """A question and its answer.

    Attributes:
        group: what it is about, such as a case.
        found: the figure that decided, in words; margin: how far it was from the other answer, in words.
        depth: how often it is a part of the rows above it.
    """

    kind: CalloutKind
    group: str
    asked: str
    found: str
    margin: Cell = None
    depth: int = 0


@dataclass(frozen=True)
class Checks:
    """Rows in their order; a group is named once."""

    headers: tuple[str, str, str, str]
    rows: Sequence[CheckRow]

    def html(self, key: str, columns: Columns) -> str:
        head = "".join(f"<th>{escape(header)}</th>" for header in (self.headers[0], "", *self.headers[1:]))
        rows, before = [], None
        for row in self.rows:
            name = "" if row.group == before else escape(row.group)
            before = row.group
            indent = f' style="padding-left:{INDENT * row.depth:g}em"' if row.depth else ""
            rows.append(
                f'<tr class="{row.kind}"><th>{name}</th><td>{mark(row.kind)}</td><td{indent}>{escape(row.asked)}</td>'
                f'<td>{escape(row.found)}</td><td class="n">{escape(text(row.margin))}</td></tr>'
            )
        listed = f'<table class="checks"><thead><tr>{head}</tr></thead><tbody>{"".join(rows)}</tbody></table>'
        return f'<div class="table" tabindex="0">{listed}</div>'
