"""A comparison told: as rows, in a sentence, drawn, as plain values and as a page."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.comparison.comparison import Comparison
from orchestrator.crossing import documents_of
from orchestrator.display import characters
from orchestrator.display.titles import with_unit
from orchestrator.measures import Parting
from orchestrator.report import Chart, ChartLine, Curve, Panel, Report
from orchestrator.results import result_folder, versions, write_json

HEADERS = ("case", "signal", "parts at [s]", "by", "largest difference", "at [s]", "tolerance", "in tolerances")
DRAWN = 12  # signals of a case on a page, those that differ most


@dataclass(frozen=True)
class FirstParting:
    """Where two sides part first."""

    case: str
    signal: str
    time: float
    by: float
    unit: str
    tolerance: float


def document_of(comparison: Comparison) -> dict[str, object]:
    """A comparison as plain values."""
    return {
        "a": comparison.one.name,
        "b": comparison.other.name,
        "agree": comparison.agree,
        "first": _first(comparison),
        "cases": [{"name": pair.name, "signals": pair.partings} for pair in comparison.pairs],
        "notes": comparison.notes,
        "interface": comparison.interface,
        "units": documents_of(comparison.crossings),
    }


def _first(comparison: Comparison) -> FirstParting | None:
    if comparison.first is None:
        return None
    case, parting = comparison.first
    assert parting.first is not None
    return FirstParting(case, parting.signal, parting.first, parting.by, parting.unit, parting.tolerance)


def sentence(comparison: Comparison) -> str:
    """Where the two part first and by what, or how near they are."""
    if comparison.first is None:
        case, most = comparison.largest
        where = f"in {most.signal} of case {case} at {most.at:.6g} s"
        return (
            f"they agree; the largest difference is {_shown(most, most.largest)} {where}, {most.times:.3g} tolerances"
        )
    case, first = comparison.first
    if first.texts is not None:
        said = " beside ".join(_quoted(text) for text in first.texts)
        return f"they part first at {first.first:.6g} s: {first.signal} of case {case} says {said}"
    times = f", {first.by / first.tolerance:.3g} tolerances" if first.tolerance else ""
    return f"they part first at {first.first:.6g} s: {first.signal} of case {case} by {_shown(first, first.by)}{times}"


def rows(comparison: Comparison) -> Iterator[tuple[str, ...]]:
    """A row under `HEADERS` of every signal of every case, those that part first at the top."""
    found = [(pair.name, parting) for pair in comparison.pairs for parting in pair.partings]
    for case, one in sorted(found, key=lambda pair: (not pair[1].beyond, pair[1].first or 0.0, -pair[1].times)):
        by = _shown(one, one.by) if one.texts is None else " / ".join(map(_quoted, one.texts))
        parts = ("-", "-") if one.first is None else (f"{one.first:.6g}", by)
        largest = (_shown(one, one.largest), f"{one.at:.6g}", _shown(one, one.tolerance), f"{one.times:.3g}")
        yield (case, one.signal, *parts, *largest)


def drawn(comparison: Comparison) -> str:
    """The signal that parts first, in characters; "" where none does."""
    if comparison.first is None:
        return ""
    case, first = comparison.first
    pair = next(pair for pair in comparison.pairs if pair.name == case)
    if first.texts is not None:
        return ""
    curves = [(trace.time, trace[first.signal]) for trace in (pair.one, pair.other)]
    return characters.plot(f"{case}: {first.signal} [{first.unit or '1'}]", curves[0], curves[1], ("A", "B"))


def page(comparison: Comparison) -> Report:
    """Figures and curves of both sides, and the difference."""
    report = Report("Comparison", f"A: {comparison.one.name}; B: {comparison.other.name}")
    section = report.section("Verdict")
    section.callout("ok" if comparison.agree else "error", f"{sentence(comparison).capitalize()}.")
    section.warnings(f"{note}." for note in comparison.notes)
    section.table(HEADERS, list(rows(comparison)))
    for pair in comparison.pairs:
        part = report.section(f"Case {pair.name}")
        drawable = [one for one in pair.partings if one.signal not in pair.one.texts]
        most = sorted(drawable, key=lambda one: -one.times)[:DRAWN]
        panels = []
        for one in most:
            curves = [
                Curve("A", pair.one.time, pair.one[one.signal], tone="measured"),
                Curve("B", pair.other.time, pair.other[one.signal]),
            ]
            parted = [] if one.first is None else [ChartLine(one.first, "x", "parts", wrong=True)]
            panels.append(Panel(with_unit(one.signal, one.unit), curves, parted))
        if panels:
            part.figure(Chart(panels))
    return report


def _quoted(text: str | None) -> str:
    return "nothing" if text is None else f"'{text if len(text) <= 40 else text[:37] + '...'}'"


def _shown(one: Parting, value: float) -> str:
    return f"{value:.4g}" + ("" if one.unit in ("", "1") else f" {one.unit}")


def write(comparison: Comparison, target: Path, files: Sequence[Path]) -> None:
    """Write the folder of a comparison: manifest.json, report.html.

    Args:
        files: what was compared, which it does not replace.
    """
    with result_folder(target, files) as folder:
        document = {"title": "Comparison", **document_of(comparison), "versions": versions()}
        write_json(folder / "manifest.json", document)
        page(comparison).write(folder / "report.html")
