"""The page of a suite: all verdicts, what failed first, each with the report behind it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from fmus.errors import InputError
from orchestrator.batch.summary import SuiteSummary
from orchestrator.batch.verdict import Verdict
from orchestrator.report import Report
from orchestrator.report.content import Callout, Content, DataTable
from orchestrator.report.document import is_ours, write_shared
from orchestrator.report.entries import Entries, ListEntry
from orchestrator.results import versions

NAME = "index.html"


def prepare(out: Path) -> None:
    """See, before a suite runs, that its page may be written, and put there what it shares with the reports behind it.

    Raises:
        InputError: there is a page of somebody else, or the place cannot be written.
    """
    page = out / NAME
    if page.exists() and not is_ours(page):
        raise InputError(page, "is there, and no command of ours wrote it", "move it away, or give another --out")
    write_shared(out)


def write_index(summary: SuiteSummary, out: Path) -> Path:
    """Write the page of a suite whose results are in this folder; its path."""
    return index_of(summary, out).write(out / NAME, shared=".")


def index_of(summary: SuiteSummary, out: Path) -> Report:
    """The page, as it is in the folder of the results."""
    page = Report("Regression suite", f"{summary.sentence}.")
    section = page.section("Verdicts")
    held = all(verdict.passed for verdict in summary.verdicts)
    section.callout("ok" if held else "error", "All passed." if held else "Not all passed.")
    ranked = sorted(summary.verdicts, key=lambda verdict: verdict.passed)
    entries = [_entry(verdict, out) for verdict in ranked]
    section.content.append(Entries(("scenario", "title", "cases passed", "time [s]", "why not"), entries))
    page.section("Versions").provenance(dict(versions()))
    return page


def _entry(verdict: Verdict, out: Path) -> ListEntry:
    passed = sum(case["passed"] for case in verdict.cases)
    title = verdict.document["title"] if verdict.document else ""
    cells = (title, f"{passed} of {len(verdict.cases)}", round(verdict.seconds, 2), verdict.why)
    return ListEntry(
        "ok" if verdict.passed else "error", str(verdict.file), _page(verdict, out), cells, tuple(_cases(verdict))
    )


def _page(verdict: Verdict, out: Path) -> str | None:
    """The report of a file, from the page of the suite; None where it has none."""
    if verdict.document is None:
        return None
    report = Path(verdict.document["out"]) / "report.html"
    return Path(os.path.relpath(report, out)).as_posix() if report.is_file() else None


def _cases(verdict: Verdict) -> Iterator[Content]:
    """Errors of cases, and all their checks."""
    for case in verdict.cases:
        if case["error"] and not case["passed"]:
            yield Callout("error", f"{case['name']}: {case['error']}")
    rows = [
        (case["name"], check["text"], "yes" if check["held"] else "NO", check["found"])
        for case in verdict.cases
        for check in case["checks"]
    ]
    if rows:
        yield DataTable(("case", "expectation", "held", "found"), rows)
