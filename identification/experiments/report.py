"""The report of a campaign of experiments: claims, tables, and errors at a glance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from identification.experiments.claims import ClaimJudgement, JudgedClaim, verdicts
from identification.experiments.experiments import Experiments
from identification.experiments.set_result import SetResult, mean
from identification.experiments.summary import summary
from identification.experiments.tables import tables
from identification.result_sections import provenance
from identification.results import finite
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section
from orchestrator.report import figures as plots
from orchestrator.report.content import CalloutKind

MARKS: dict[str, CalloutKind] = {"held": "ok", "held in part": "warning", "not borne out": "error"}


def report(experiments: Experiments) -> Report:
    """Claims, the tables of both chapters, errors at a glance, physical modes, provenance."""
    claims, found = verdicts(experiments), summary(experiments)
    page = Report(experiments.study.title, experiments.study.description)
    other = experiments.study.compare
    _claims(page.section("Claims"), claims, found["warnings"], other.name if other else "")
    _overview(page.section("Errors at a glance"), experiments)
    for number, heading in (("2", "Chapter 2: identification"), ("3", "Chapter 3: reduction and updating")):
        section = page.section(heading)
        for table in tables(experiments):
            if table.number.startswith(number):
                section.table(table.headers, table.rows, caption=f"Table {table.number}. {table.caption}")
    _frequencies(page.section("Flexible modes"), experiments)
    provenance(page, found)
    return page


def _claims(section: Section, claims: Sequence[JudgedClaim], warnings: list[str], name: str) -> None:
    counts = {outcome: sum(own.outcome == outcome for own in claims) for outcome in MARKS}
    section.highlights([(outcome, count, f"of {len(claims)} claims") for outcome, count in counts.items()])
    section.warnings(warnings)
    for own in claims:
        other = own.compared
        verdict = f"{own.statement}: {_verdict(own)}."
        against = f"With {name}: {_verdict(other)}." if other else ""
        section.callout(MARKS[own.outcome], " ".join(filter(None, [verdict, own.reason, against])))
        rows: list[list[Cell]] = [[comparison.text, comparison.held] for comparison in own.comparisons]
        for row, comparison in zip(rows, other.comparisons if other else (), strict=False):
            row += [comparison.text, comparison.held]
        section.table(["comparison", "holds", *([name, "holds"] if other else [])], rows)


def _verdict(judgement: ClaimJudgement) -> str:
    return f"{judgement.outcome} ({judgement.count} of {len(judgement.comparisons)})"


def _overview(section: Section, experiments: Experiments) -> None:
    """Mean delta of each data set's model in both validations, and the thesis' in the first."""
    results = {label: result for label, result in experiments.results.items() if result.data_set.removed}
    sets = experiments.study.sets
    printed = {code: known.published.delta[-1] for code, known in sets.items() if known.published}
    groups = {
        "DMV": {label: mean(result.chosen.errors.dmv) for label, result in results.items()},
        "SFV": {label: mean(result.chosen.errors.sfv) for label, result in results.items()},
        "DMV, thesis": printed,
    }
    shown = {name: {code: value for code, value in bars.items() if value < 2} for name, bars in groups.items()}
    section.figure(plots.bars(shown, None, "mean δ"), "Mean δ; none where the loop is unstable or δ is above 2")
    if experiments.compared:
        _preparations(section, experiments, experiments.compared)


def _preparations(section: Section, experiments: Experiments, other: Experiments) -> None:
    """What the preparation makes of each data set."""
    names = [experiments.preparation.name, other.preparation.name]
    headers = ["data", *(f"{what}, {name}" for name in names for what in ("order", "DMV", "SFV"))]
    rows = [[label, *_short(result), *_short(other.results[label])] for label, result in experiments.results.items()]
    section.table(headers, rows, caption="Mean δ under both preparations; a dash stands for an unstable loop")


def _short(result: SetResult) -> list[float | None]:
    errors = result.chosen.errors
    return [result.chosen.order, finite(mean(errors.dmv)), finite(mean(errors.sfv))]


def _frequencies(section: Section, experiments: Experiments) -> None:
    section.paragraph(
        "Distance of the identified flexible modes from those of the physical model with dry friction off: the median "
        "over all orders of the modes that come back from one order to the next near each physical one."
    )
    study = experiments.study
    rows = [
        [payload * 1000, number, mode.frequency, mode.damping]
        for payload, found in experiments.physical.items()
        for number, mode in enumerate(found, start=1)
    ]
    section.table(["payload [g]", "mode", "frequency [Hz]", "damping"], rows, caption="The physical model")
    away = [
        [label, *(None if np.isinf(distance) else 100 * distance for distance in result.frequencies)]
        for label, result in experiments.results.items()
    ]
    headers = ["data", *(f"mode {number} [%]" for number in range(1, study.physical.modes + 1))]
    section.table(headers, away, caption="Distances")
