"""A report as a document: sections, rendered into one HTML file that needs nothing else to be read.

A report is filled section by section while the work goes on and written once at its end.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

import plotly.graph_objects as go
from plotly.offline import get_plotlyjs

from fmus.files import atomic_write
from orchestrator.display.table import Cell
from orchestrator.report.content import (
    Callout,
    CalloutKind,
    Content,
    DataTable,
    Facts,
    Figure,
    Highlights,
    Paragraph,
)

PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline';
 style-src 'unsafe-inline'; img-src data: blob:; form-action 'none'; base-uri 'none'">
<title>$title</title>
<style>
$style</style>
$script
</head>
<body>
<nav aria-label="Contents"><ol>$contents</ol></nav>
<main>
<header><h1>$title</h1>$subtitle</header>
<noscript><p>The figures of this report are drawn by its own script; allow it to see them.</p></noscript>
$sections
</main>
</body>
</html>
""")


class Section:
    """A heading and the content below it, in the order in which they were added."""

    def __init__(self, heading: str) -> None:
        self.heading = heading
        self.content: list[Content] = []

    def paragraph(self, text: str) -> None:
        """Running text."""
        self.content.append(Paragraph(text))

    def callout(self, kind: CalloutKind, text: str) -> None:
        """A sentence in a box: "ok", "warning" or "error"."""
        self.content.append(Callout(kind, text))

    def highlights(self, entries: Sequence[tuple[str, Cell, str]]) -> None:
        """A row of key figures: (label, value, remark) each."""
        self.content.append(Highlights(entries))

    def provenance(self, entries: Mapping[str, Cell]) -> None:
        """Names and values in two columns: files, hashes, versions, seeds."""
        self.content.append(Facts(list(entries.items())))

    def table(
        self,
        headers: Sequence[str],
        rows: Sequence[Sequence[Cell]],
        numeric: Collection[int] | None = None,
        caption: str = "",
    ) -> None:
        """Rows under headers.

        Args:
            rows: cells as text, or as numbers, which get five significant digits; None shows as a dash.
            numeric: columns from 0 that stand to the right; None takes those that hold only numbers.
        """
        self.content.append(DataTable(headers, rows, numeric, caption))

    def figure(self, figure: go.Figure, caption: str = "") -> None:
        """A plotly figure across the whole width."""
        self.content.append(Figure(figure, caption))


class Report:
    """A document with a title, to be filled with sections and written."""

    def __init__(self, title: str, subtitle: str = "") -> None:
        self.title = title
        self.subtitle = subtitle
        self.sections: list[Section] = []

    def section(self, heading: str) -> Section:
        """A new section at the end, to be filled."""
        self.sections.append(Section(heading))
        return self.sections[-1]

    def render(self) -> str:
        """The whole document as HTML; plotly's script is in it once, and only if there is a figure."""
        drawn = any(isinstance(piece, Figure) for section in self.sections for piece in section.content)
        return PAGE.substitute(
            title=escape(self.title),
            subtitle=f"<p class='subtitle'>{escape(self.subtitle)}</p>" if self.subtitle else "",
            style=(resources.files(__package__) / "style.css").read_text(encoding="utf-8"),
            script=f"<script>{get_plotlyjs()}</script>" if drawn else "",
            contents="".join(
                f'<li><a href="#section-{number}">{escape(section.heading)}</a></li>'
                for number, section in enumerate(self.sections, 1)
            ),
            sections="\n".join(_section(section, number) for number, section in enumerate(self.sections, 1)),
        )

    def write(self, path: str | Path) -> Path:
        """The path, once the whole document is there.

        Raises:
            InputError: the place cannot be written.
        """
        return atomic_write(path, self.render().encode())


def _section(section: Section, number: int) -> str:
    content = "\n".join(piece.html(f"{number}-{place}") for place, piece in enumerate(section.content, 1))
    return f'<section id="section-{number}"><h2>{escape(section.heading)}</h2>\n{content}</section>'
