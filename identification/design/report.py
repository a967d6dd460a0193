"""The page of a design: intervals before and after, experiments, responses against the limits, what others give."""

from __future__ import annotations

import math

from identification.design.design import Design
from identification.design.search import TriedExperiment
from identification.design.summary import SHOWN, DesignSummary, summary
from identification.design.written import CALIBRATION, EXPERIMENTS
from identification.result_sections import provenance
from identification.results import finite
from orchestrator.display.table import Cell
from orchestrator.display.titles import with_unit
from orchestrator.report import Report, Section
from orchestrator.report.chart import Chart, ChartLine, Curve, Panel


def report(design: Design) -> Report:
    """The page."""
    document, study = summary(design), design.study
    page = Report(study.title, study.description)
    section = page.section("Intervals")
    section.warnings(design.remarks)
    if sought := document.get("duration"):
        section.callout("ok" if sought["reached"] else "error", sought["said"])
        tried: list[list[Cell]] = [[float(one.duration), finite(one.of_target), one.problem] for one in design.trials]
        section.table(["duration [s]", "largest half-width over the target", ""], tried, caption="Durations tried")
    worst = document["worst"]
    entries: list[tuple[str, Cell, str]] = [("worst half-width, predicted", _share(worst["after"]), "of its value")]
    entries += [
        (f"worst half-width, {name}", _share(value), "of its value")
        for name, value in worst.items()
        if name != "after" and value
    ]
    section.highlights(entries)
    _intervals(section, design, document)
    section.paragraph(
        f"Predicted for the recordings of {EXPERIMENTS}, fitted together by {CALIBRATION}, where the parameters are as "
        f"they are known. Criterion: {study.criterion}, of {', '.join(study.parameters)}."
    )
    _experiments(page.section("Experiments"), design)
    _candidates(page.section("Candidates"), design, document)
    provenance(page, document)
    return page


def _share(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.3g} %"


def _intervals(section: Section, design: Design, document: DesignSummary) -> None:
    others = list(design.compared)
    known = [] if design.before is None else ["known before"]
    rows: list[list[Cell]] = []
    for name, entry in document["half_widths"].items():
        before = [] if design.before is None else [entry["before"]]
        rows.append(
            [
                name,
                design.study.values[name],
                *before,
                *(entry["compared"][other] for other in others),
                entry["after"],
                entry["unit"],
            ]
        )
    section.table(
        ["parameter", "value", *known, *others, "design", "unit"], rows, caption="Half-widths of the 95 % intervals"
    )


def _experiments(section: Section, design: Design) -> None:
    names = list(dict.fromkeys(name for one in design.experiments.values() for name in one.tried.values))
    rows: list[list[Cell]] = [
        [name, *(_cell(one.tried.values.get(key)) for key in names)] for name, one in design.experiments.items()
    ]
    section.table(["experiment", *names], rows)
    for name, one in design.experiments.items():
        section.figure(_responses(design, one), f"{name}: what is driven and limited, and its limits")


def _responses(design: Design, candidate: TriedExperiment) -> Chart:
    whole, panels = candidate.tried.whole, []
    names = [name for name in design.study.calibration.run.inputs if name in whole.names]
    for name in dict.fromkeys([*names, *design.study.limits, *design.study.calibration.outputs]):
        limit = design.study.limits.get(name)
        marks = [
            ChartLine(end, "y", "limit") for end in ((limit.above, limit.below) if limit else ()) if math.isfinite(end)
        ]
        panels.append(Panel(with_unit(name, whole.unit(name)), [Curve(name, whole.time, whole[name])], marks))
    return Chart(panels, legend=False)


def _candidates(section: Section, design: Design, document: DesignSummary) -> None:
    search = document["search"]
    refused = ", ".join(f"{count} for {name}" for name, count in search["exceeded"].items()) or "none"
    section.paragraph(
        f"{search['runs']} runs of the rig, of which {search['kept']} experiments keep the limits; refused: {refused}. "
        f"The figure is that of the criterion if all {design.study.count} experiments were the one of the row."
    )
    names = list(dict.fromkeys(name for one in document["candidates"] for name in one["values"]))
    rows: list[list[Cell]] = [
        [one["family"], one["alone"], *(_cell(one["values"].get(name)) for name in names)]
        for one in document["candidates"]
    ]
    section.table(["family", "figure", *names], rows, caption=f"The best of all, {min(SHOWN, len(rows))} shown")
    figures: list[list[Cell]] = [[number, one] for number, one in enumerate(search["figures"])]
    section.table(["round", "figure of the design"], figures)


def _cell(value: object) -> Cell:
    return value if isinstance(value, float | int | str) or value is None else str(value)
