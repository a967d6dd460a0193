"""What the reports of all methods show of a summary: verdict, parameters with their intervals, provenance."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping

from identification.results import ParameterSummary, Summary, VerdictSummary
from orchestrator.display.table import Cell
from orchestrator.marks import WORDS
from orchestrator.report import Report, Section, figures
from orchestrator.report.content import CalloutKind
from orchestrator.report.intervals import IntervalRow
from orchestrator.results import versions

SHOWN = 100  # of all recordings, that a report shows
_ALIKE = 0.1  # of an interval: by how much its sides may differ and still be told as one half
LARGE = 16  # elements of an array up to which each has a row


def verdict_callout(section: Section, verdict: VerdictSummary) -> None:
    """The verdict at the top of a report, where there is one."""
    settled: CalloutKind = "ok" if verdict["converged"] else "warning"
    if verdict["said"]:
        section.callout(settled if verdict["held"] else "error", verdict["said"])


def parameter_rows(parameters: Mapping[str, ParameterSummary]) -> tuple[list[str], list[list[Cell]]]:
    """Headers and rows of the parameter table: truth (where known), start, estimate, half of its 95 % interval.

    Of an array of more than `LARGE` elements there is one row, without figures.
    """
    known = any("truth" in entry for entry in parameters.values())
    sizes, told = Counter(_array(name) for name in parameters), set[str]()
    rows: list[list[Cell]] = []
    for name, entry in parameters.items():
        array, truth = _array(name), [entry.get("truth")] if known else []
        if sizes[array] <= LARGE:
            rows.append([name, *truth, entry["start"], entry["value"], _about(entry), entry["unit"]])
        elif array not in told:
            told.add(array)
            rows.append([f"{array}, {sizes[array]} elements", *truth, None, None, None, entry["unit"]])
    return ["parameter", *(["true"] if known else []), "start", "estimate", "± 95 %", "unit"], rows


def _array(name: str) -> str:
    """The array that an element belongs to, or the name itself."""
    return name.partition("[")[0]


def draw_parameters(section: Section, parameters: Mapping[str, ParameterSummary], caption: str) -> None:
    """The parameter table, and the intervals of those that have one."""
    section.table(*parameter_rows(parameters), caption=caption)
    rows = [
        IntervalRow(name, entry["value"], ends, entry["unit"], entry.get("truth"))
        for name, entry in parameters.items()
        if (ends := _ends(entry)) is not None
    ]
    if rows:
        section.figure(figures.intervals(rows), "95 % intervals, each in percent of its estimate")


def _ends(entry: ParameterSummary) -> tuple[float, float] | None:
    low, high = entry["ci95"] or (None, None)
    return None if low is None or high is None else (low, high)


def _about(entry: ParameterSummary) -> Cell:
    """Half of the interval; both distances where they are not alike, and the end that there is where one is open."""
    low, high = entry["ci95"] or (None, None)
    if low is not None and high is not None:
        below, above = entry["value"] - low, high - entry["value"]
        alike = abs(above - below) <= _ALIKE * (high - low)
        return (high - low) / 2 if alike else f"−{below:.2g} +{above:.2g}"
    if low is None and high is None:
        return None
    return f"from {low:.5g}, open" if high is None else f"open, to {high:.5g}"


def provenance(page: Report, summary: Summary) -> None:
    """A section: the versions that made a result, and tables of its recordings and of what was converted of them."""
    section, data = page.section("Provenance"), summary["data"]
    section.provenance(versions())
    rows: list[list[Cell]] = [
        [trace["trace"], trace["role"], "; ".join([trace["stamps"], *trace.get("notes", [])]), trace["sha256"]]
        for trace in data
    ]
    if rows:
        section.table(["trace", "role", "time stamps and notes", "SHA-256"], rows)
    left_out: list[list[Cell]] = [
        [trace["trace"], WORDS[mark.kind], mark.start, mark.stop, ", ".join(mark.signals) or "all"]
        for trace in data
        for mark in trace.get("marks", [])
    ]
    if left_out:
        caption = f"{len(left_out)} stretches" if len(left_out) > SHOWN else ""
        headers = ["trace", "left out", "from [s]", "to [s]", "signals"]
        section.table(headers, left_out[:SHOWN], caption=caption)
    if units := summary.get("units"):
        section.table(["units"], [[crossed["text"]] for crossed in units])
