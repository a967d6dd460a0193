"""The page of a sweep: how often all held, how figures are spread, what they depend on, and which runs to look at."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pyarrow as pa

from orchestrator.batch.sweep.points.designs import Morris, SobolIndices
from orchestrator.batch.sweep.runs.preparation import PreparedSweep
from orchestrator.batch.sweep.runs.rows import MARGIN, TIME
from orchestrator.batch.sweep.told.again import command
from orchestrator.batch.sweep.told.numbers import SweepNumbers, numbers_of
from orchestrator.batch.sweep.told.result import AskedDocument, SweepResult
from orchestrator.batch.sweep.told.sensitivity import MISSING, Indices, indices
from orchestrator.display.table import Cell
from orchestrator.display.titles import with_unit
from orchestrator.report import Band, Chart, ChartLine, Curve, Panel, Report, Section, figures
from orchestrator.report.chart import ChartPoint
from orchestrator.report.drawings import ChartGrid
from orchestrator.results import versions
from orchestrator.trace import FloatArray

PAGE = "report.html"
WORST = 5  # runs of each expectation
REASONS = 20
POINTS = 2000  # runs that a scatter shows
ENVELOPES = 1000  # runs that an envelope is made of
FACTORS, FIGURES = 6, 4  # of a scatter matrix
PAIRED = 4  # factors, each over each other


def report(study: PreparedSweep, result: SweepResult) -> Report:
    """The whole page."""
    document = result.document
    page = Report(document["title"], study.block.description)
    _outcome(page.section("Outcome"), result)
    numbers = numbers_of(study, result)
    _worst(page.section("Worst runs"), study, result, numbers)
    if document["failed"]:
        _failures(page.section("Runs that failed"), study, result)
    _spread(page.section("Figures"), result)
    if numbers.varied:
        _dependence(page, study, result, numbers)
    if study.setup.kept is not None:
        _envelopes(page.section("Signals"), study, result)
    _provenance(page.section("Provenance"), study, result)
    return page


def _outcome(section: Section, result: SweepResult) -> None:
    document = result.document
    passing = document["passing"]
    if "at_least" in document:
        kind = "ok" if document["passed"] else "error"
        section.callout(kind, f"At least {100 * document['at_least']:g} % of the runs are to pass.")  # type: ignore[arg-type]
    section.warnings(f"{note}." for note in document["notes"])
    section.highlights(
        [
            ("runs", document["runs"], f"{document['points']:,} points in {len(document['cases'])} cases"),
            ("passed", passing["held"], f"of {passing['of']:,}; 95 % sure: {_interval(passing)} %"),
            ("failed", document["failed"], "without a verdict"),
        ]
    )
    headers = ["column", "of each run", "held", "of", "share [%]", "95 % interval [%]"]
    rows: list[list[Cell]] = [
        [one["column"], one["text"], one["held"], one["of"], _percent(one["share"]), _interval(one)]
        for one in result.told
    ]
    section.table(headers, rows)
    section.paragraph(
        "The intervals hold the share of all such runs with 95 % confidence (Clopper and Pearson) where points are "
        "drawn independently; of a grid, a list or a sequence they only tell what so many runs can tell."
    )


def _percent(share: float | None) -> float | None:
    return None if share is None else round(100 * share, 3)


def _interval(asked: AskedDocument) -> str:
    if asked["interval"] is None:
        return "–"
    low, high = asked["interval"]
    return f"{100 * low:.4g} … {100 * high:.4g}"


def _worst(section: Section, study: PreparedSweep, result: SweepResult, numbers: SweepNumbers) -> None:
    """The runs with the smallest margins, with what runs each again."""
    rows: list[list[Cell]] = []
    for asked in result.document["asked"]:
        margins = result.column(asked["column"] + MARGIN)
        known = np.flatnonzero(np.isfinite(margins))
        for run in known[np.argsort(margins[known], kind="stable")[:WORST]].tolist():
            figure = result.column(asked["column"])[run]
            rows.append([asked["column"], run, float(figure), float(margins[run]), command(study.file, run)])
    section.table(["column", "run", "figure", "margin", "again, with its whole record"], rows)


def _failures(section: Section, study: PreparedSweep, result: SweepResult) -> None:
    failed = result.failed
    reasons = result.table(["reason"])["reason"].take(failed).to_pylist()
    first = {reason: int(run) for reason, run in reversed(list(zip(reasons, failed, strict=True)))}
    rows: list[list[Cell]] = [
        [count, reason, first[reason], command(study.file, first[reason])]
        for reason, count in Counter(reasons).most_common(REASONS)
    ]
    section.table(["runs", "reason", "first", "again"], rows)
    section.paragraph("`servotwin sweep --retry` runs them again.")


def _spread(section: Section, result: SweepResult) -> None:
    """A histogram of each figure."""
    charts = []
    for asked in result.document["asked"]:
        values = result.column(asked["column"])
        if len(known := values[np.isfinite(values)]):
            charts.append((asked["text"], figures.distribution(known, asked["column"], asked["unit"])))
    if charts:
        section.figure(ChartGrid(charts), "Histograms of the figures")
    headers = ["column", "unit", "lowest", "5 %", "median", "mean", "95 %", "highest"]
    keys = ("lowest", "q05", "median", "mean", "q95", "highest")
    asked_of = [one for one in result.document["asked"] if one["figure"] is not None]
    rows: list[list[Cell]] = [
        [one["column"], one["unit"] or "–", *((one["figure"] or {})[key] for key in keys)] for one in asked_of
    ]
    section.table(headers, rows)


def _dependence(page: Report, study: PreparedSweep, result: SweepResult, numbers: SweepNumbers) -> None:
    section = page.section("What figures depend on")
    titles = [asked["column"] for asked in result.document["asked"]]
    section.table(
        ["factor", *titles],
        [[name, *row] for name, row in zip(numbers.names, numbers.correlations.tolist(), strict=True)],
        caption="Rank correlations (Spearman)",
    )
    section.figure(_scatter(numbers, result), f"Figures over what varies{numbers.told}; crosses do not hold")
    _pairs(page.section("Where runs pass"), numbers)
    _indices(section, study, result)


def _scatter(numbers: SweepNumbers, result: SweepResult) -> ChartGrid:
    """The figures over the factors, those that matter most."""
    charts = []
    for place, asked in list(enumerate(result.document["asked"]))[:FIGURES]:
        for factor in numbers.leading(place)[:FACTORS]:
            x, y, held = numbers.values[:, factor], numbers.figures[:, place], numbers.held[:, place]
            title = with_unit(asked["column"], asked["unit"])
            chart = Chart([Panel(title, _groups(x, y, held))], x=numbers.titles[factor], legend=False)
            charts.append((f"{asked['column']} over {numbers.names[factor]}", chart))
    return ChartGrid(charts)


def _groups(x: FloatArray, y: FloatArray, held: FloatArray) -> list[Curve]:
    good, bad = held == 1, held == 0
    return [Curve("holds", x[good], y[good], "dots"), Curve("does not hold", x[bad], y[bad], "crosses", 1)]


def _pairs(section: Section, numbers: SweepNumbers) -> None:
    """Which points pass, over each two of the factors that this depends on most."""
    charts = [
        (f"{numbers.names[second]} over {numbers.names[first]}", _pair(numbers, first, second))
        for first, second in itertools.combinations(numbers.decisive[:PAIRED], 2)
    ]
    if charts:
        section.figure(ChartGrid(charts), f"Runs over each two of the factors that decide most{numbers.told}")


def _pair(numbers: SweepNumbers, first: int, second: int) -> Chart:
    x, y = numbers.values[:, first], numbers.values[:, second]
    passed, failed = numbers.passed == 1, numbers.failed
    curves = [
        Curve("passed", x[passed], y[passed], "dots"),
        Curve("did not pass", x[~passed & ~failed], y[~passed & ~failed], "crosses", 1),
        Curve("failed", x[failed], y[failed], "circles", 2),
    ]
    shown = [one for one in curves if len(np.asarray(one.x))]
    return Chart([Panel(numbers.titles[second], shown)], x=numbers.titles[first])


def _indices(section: Section, study: PreparedSweep, result: SweepResult) -> None:
    """Sensitivity indices of each figure and case, where the points were chosen for them."""
    if not isinstance(study.design, SobolIndices | Morris):
        return
    points = study.design.points(0, study.design.count)
    names, cases = study.setup.space.names, len(study.setup.cases)
    rows: list[list[Cell]] = []
    for asked in result.document["asked"]:
        for case, title in enumerate(study.setup.cases):
            try:
                found = indices(study.design, points, result.column(asked["column"])[case::cases], names)
            except ImportError:
                section.callout("warning", f"No sensitivity indices: {MISSING}.")
                return
            if found is not None:
                rows += _index_rows(asked["column"], title, found)
                _draw_indices(section, f"{asked['column']} in case {title}", found)
    if rows:
        section.table(["column", "case", "factor", "index", "value", "± 95 %"], rows)


def _index_rows(column: str, case: str, found: Indices) -> list[list[Cell]]:
    return [[column, case, one.factor, one.kind, one.value, one.confidence] for one in found.entries]


def _draw_indices(section: Section, title: str, found: Indices) -> None:
    kinds = dict.fromkeys(one.kind for one in found.entries)
    groups = {kind: {one.factor: one.value for one in found.entries if one.kind == kind} for kind in kinds}
    left_out = f"; {found.left_out} groups with failed runs are left out" if found.left_out else ""
    section.figure(figures.bars(groups, quantity="index"), f"{title}: from {found.groups} groups of points{left_out}")


def _envelopes(section: Section, study: PreparedSweep, result: SweepResult) -> None:
    """Between which bounds the signals of each case lie."""
    kept = study.setup.kept
    assert kept is not None
    rows = result.sampled(["case", TIME, *kept.signals], ENVELOPES)
    for case in study.setup.cases:
        own = rows.filter(pa.compute.equal(rows["case"], case))
        own = own.filter(pa.compute.is_valid(own[TIME]))
        if not len(own):
            continue
        stamps = [np.asarray(one) for one in own[TIME].to_pylist()]
        longest = max(stamps, key=len)
        panels = [
            Panel(with_unit(name, unit), *_bands(longest, own[name].to_pylist()))
            for name, unit in zip(kept.signals, kept.units, strict=True)
        ]
        told = f"{len(own):,} runs" if len(rows) == result.document["runs"] else f"{len(own):,} runs, spread evenly"
        section.figure(Chart(panels), f"{case}: median, 5 to 95 %, and all of {told}")


def _bands(
    time: FloatArray, samples: Sequence[Sequence[float]]
) -> tuple[list[Curve], list[ChartLine | ChartPoint], list[Band]]:
    """Median and bands of samples that may end early."""
    padded = np.full((len(samples), len(time)), np.nan)
    for row, values in enumerate(samples):
        padded[row, : len(values)] = values
    low, q05, median, q95, high = np.nanquantile(padded, [0, 0.05, 0.5, 0.95, 1], axis=0)
    return [Curve("median", time, median)], [], [Band("all", time, low, high), Band("5 to 95 %", time, q05, q95)]


def _provenance(section: Section, study: PreparedSweep, result: SweepResult) -> None:
    document = result.document
    told = {key: str(value) for key, value in document["design"].items()}
    section.provenance(
        {
            "study": str(study.file),
            "scenario": document["scenario"],
            "data set": f"{Path('runs') / '*.parquet'}, a row a run",
            **{f"design: {key}": value for key, value in told.items()},
            **{f"SHA-256 of {name}": digest for name, digest in study.identity["files"].items()},
            **versions(),
        }
    )
