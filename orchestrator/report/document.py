"""A report as a document: sections, rendered into one HTML file that needs nothing else to be read; or, where many lie
in one folder, into one that takes script and style from there.

A report is filled section by section while the work goes on and written once at its end.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterable, Mapping, Sequence
from functools import cache
from html import escape
from importlib import resources
from pathlib import Path
from string import Template

from fmus.files import atomic_write
from orchestrator.display.table import Cell
from orchestrator.report.columns import Columns
from orchestrator.report.content import (
    Callout,
    CalloutKind,
    Content,
    DataTable,
    Drawing,
    DrawnFigure,
    Facts,
    Folded,
    Heading,
    Highlights,
    Paragraph,
)

PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta name="generator" content="servotwin">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; script-src 'unsafe-inline'$from;
 style-src 'unsafe-inline'$from; img-src data: blob:; form-action 'none'; base-uri 'none'">
<title>$title</title>
$style
</head>
<body>
<nav aria-label="Contents"><ol>$contents</ol></nav>
<main>
<header><h1>$title</h1>$subtitle$hint</header>
<noscript><p>The figures of this report are drawn by its own script; allow it to see them.</p></noscript>
$sections
</main>
$script
</body>
</html>
""")
SCRIPT, STYLE = "chart.js", "style.css"
SHARED = " 'self' file:"  # what a page may take from its own folders
ALONE = (
    "This page was taken out of its folder, which has its script: there, or by running its scenario alone, "
    "its charts are drawn."
)
HINT = (
    "In charts: drag to zoom, Shift and drag to move, Ctrl and wheel to zoom about a place, double click for all. "
    "Keys: ← → to move, + − to zoom, 0 for all, Shift ← → to read values."
)


class Section:
    """A heading and the content below it, in the order in which they were added."""

    def __init__(self, heading: str) -> None:
        self.heading = heading
        self.content: list[Content] = []

    def paragraph(self, text: str) -> None:
        """Running text."""
        self.content.append(Paragraph(text))

    def subheading(self, text: str) -> None:
        """The heading of a part of the section."""
        self.content.append(Heading(text))

    def callout(self, kind: CalloutKind, text: str) -> None:
        """A sentence in a box: "ok", "warning" or "error"."""
        self.content.append(Callout(kind, text))

    def warnings(self, lines: Iterable[str]) -> None:
        """A warning a line."""
        for line in lines:
            self.callout("warning", line)

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

    def figure(self, drawing: Drawing, caption: str = "") -> None:
        """A figure across the whole width: a `Chart`, or what a function of `figures` gives."""
        self.content.append(DrawnFigure(drawing, caption))

    def folded(self, title: str) -> Section:
        """A part below a title that a reader opens, to be filled."""
        inside = Section(title)
        self.content.append(Folded(title, inside.content))
        return inside


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

    def render(self, shared: str | None = None) -> str:
        """The whole document as HTML; the script of the charts is in it once, and only if there is one.

        Args:
            shared: the folder in which `write_shared` has put script and style, as seen from the page; None has them in
                the page.

        What charts are first drawn from comes before the script, and their samples after it: a page with many of them
        is seen before it is there as a whole.
        """
        columns = Columns()
        sections = "\n".join(_section(section, number, columns) for number, section in enumerate(self.sections, 1))
        drawn = bool(columns.columns)
        return PAGE.substitute(
            {"from": SHARED if shared else ""},
            title=escape(self.title),
            subtitle=f"<p class='subtitle'>{escape(self.subtitle)}</p>" if self.subtitle else "",
            hint=f"<p class='hint'>{HINT}</p>" if drawn else "",
            style=_style(shared),
            script=_script(columns, shared) if drawn else "",
            contents="".join(
                f'<li><a href="#section-{number}">{escape(section.heading)}</a></li>'
                for number, section in enumerate(self.sections, 1)
            ),
            sections=sections,
        )

    def write(self, path: str | Path, shared: str | None = None, *, for_good: bool = True) -> Path:
        """The path, once the whole document is there; `shared` as in `render`, `for_good` as of `atomic_write`.

        Raises:
            InputError: the place cannot be written.
        """
        return atomic_write(path, self.render(shared).encode(), for_good=for_good)


def write_shared(folder: Path) -> None:
    """Put script and style into a folder, for the pages below it that share them.

    Raises:
        InputError: the place cannot be written.
    """
    for name in (SCRIPT, STYLE):
        atomic_write(folder / _shared_name(name), _shipped(name).encode())


def is_ours(page: Path) -> bool:
    """Whether a file is a page that was made here."""
    with page.open("rb") as file:
        return b'<meta name="generator" content="servotwin">' in file.read(1000)


def _section(section: Section, number: int, columns: Columns) -> str:
    content = "\n".join(piece.html(f"{number}-{place}", columns) for place, piece in enumerate(section.content, 1))
    return f'<section id="section-{number}"><h2>{escape(section.heading)}</h2>\n{content}</section>'


def _style(shared: str | None) -> str:
    if shared is None:
        return f"<style>\n{_shipped(STYLE)}</style>"
    return f'<link rel="stylesheet" href="{escape(shared)}/{_shared_name(STYLE)}">'


def _script(columns: Columns, shared: str | None) -> str:
    heads = f'<script type="application/json" id="columns">{columns.heads()}</script>'
    if shared is None:
        return f"{heads}\n<script>\n{_shipped(SCRIPT)}</script>\n{columns.markup()}"
    missed = escape(f"document.querySelector('header').append({ALONE!r})")
    script = f'<script src="{escape(shared)}/{_shared_name(SCRIPT)}" onerror="{missed}"></script>'
    return f"{heads}\n{script}\n{columns.markup()}"


def _shared_name(name: str) -> str:
    """As a file for many pages: another version has another name, for it may not know their numbers."""
    kind, content = Path(name), _shipped(name).encode()
    return f"{kind.stem}-{hashlib.sha256(content).hexdigest()[:8]}{kind.suffix}"


@cache
def _shipped(name: str) -> str:
    """A file beside this one, which comes with the package."""
    return (resources.files(__package__) / name).read_text(encoding="utf-8")
