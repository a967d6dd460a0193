"""The folder a campaign of experiments leaves: claims and tables in report.html, numbers and models in summary.json."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from identification.experiments.claims import Judgement, figures, judge
from identification.experiments.data_set import SetResult, mean
from identification.experiments.experiments import Experiments
from identification.experiments.reduction import Errors, Reduction
from identification.experiments.tables import model_name, reduced_name, tables
from identification.linear.model import LinearModel
from identification.linear.modes import labels, modes
from identification.method import Calibrated
from identification.results import ClaimsSummary, ClaimSummary, data_summary, finite, provenance
from identification.subspace.results import linear_fmu
from orchestrator.report import Report, Section
from orchestrator.report import figures as plots
from orchestrator.report.blocks import Cell, Kind
from orchestrator.results import versions

MARKS: dict[str, Kind] = {"held": "ok", "held in part": "warning", "not borne out": "error"}


def calibrated(experiments: Experiments, folder: Path) -> Calibrated:
    """Every chosen and updated model as an FMU."""
    models = final_models(experiments)
    return Calibrated({name: linear_fmu(model, folder / f"{name}.fmu") for name, model in models.items()})


Verdicts = list[tuple[Judgement, Judgement | None]]  # under the study's preparation, and under the other one


def _judged(experiments: Experiments) -> Verdicts:
    own = judge(experiments)
    others: list[Judgement] | list[None] = judge(experiments.compared) if experiments.compared else [None] * len(own)
    return list(zip(own, others, strict=True))


class ExperimentsSummary(ClaimsSummary):
    """The summary of a campaign of experiments."""

    sets: dict[str, dict[str, Any]]
    examples: dict[str, dict[str, Any]]
    linear_models: dict[str, dict[str, Any]]
    figures: dict[str, float | None]
    compared: dict[str, float | None] | None
    physical_modes: list[dict[str, float]]
    tables: dict[str, dict[str, Any]]


def summary(experiments: Experiments) -> ExperimentsSummary:
    """The study as `summary.json` holds it."""
    study, claims, found = experiments.study, _judged(experiments), tables(experiments)
    return {
        "title": study.title,
        "method": study.method,
        "parameters": {},
        "fit": {},
        "as_stated": all(each.as_stated for each, _ in claims),
        "claims": [{**_claim(each), "compared": _claim(other) if other else None} for each, other in claims],
        "sets": {label: _set(experiments, result) for label, result in experiments.results.items()},
        "examples": {name: _example(experiments, each) for name, each in experiments.reductions.items()},
        "linear_models": {name: _model(each) for name, each in final_models(experiments).items()},
        "figures": {name: finite(value) for name, value in figures(experiments).items()},
        "compared": {name: finite(value) for name, value in figures(experiments.compared).items()}
        if experiments.compared
        else None,
        "physical_modes": [
            {"payload": payload, "frequency": each.frequency, "damping": each.damping}
            for payload, found_modes in experiments.physical.items()
            for each in found_modes
        ],
        "tables": {
            each.number: {"caption": each.caption, "headers": each.headers, "rows": each.rows} for each in found
        },
        "data": data_summary(experiments.recorded),
        "versions": versions(),
        "warnings": [*_warnings(experiments), *_unexpected(claims)],
    }


def report(experiments: Experiments) -> Report:
    """Claims, the tables of both chapters, errors at a glance, physical modes, provenance."""
    claims, found = _judged(experiments), tables(experiments)
    page = Report(experiments.study.title, experiments.study.description)
    other = experiments.study.compare
    warnings = [*_warnings(experiments), *_unexpected(claims)]
    _claims(page.section("Claims"), claims, warnings, other.name if other else "")
    _overview(page.section("Errors at a glance"), experiments)
    for number, heading in (("2", "Chapter 2: identification"), ("3", "Chapter 3: reduction and updating")):
        section = page.section(heading)
        for table in found:
            if table.number.startswith(number):
                section.table(table.headers, table.rows, caption=f"Table {table.number}. {table.caption}")
    _frequencies(page.section("Flexible modes"), experiments)
    provenance(page.section("Provenance"), data_summary(experiments.recorded))
    return page


def _claims(section: Section, claims: Verdicts, warnings: list[str], name: str) -> None:
    counts = {outcome: sum(each.outcome == outcome for each, _ in claims) for outcome in MARKS}
    section.highlights([(outcome, count, f"of {len(claims)} claims") for outcome, count in counts.items()])
    for warning in warnings:
        section.callout("warning", warning)
    for each, other in claims:
        verdict = f"{each.claim.statement}: {_verdict(each)}."
        against = f"With {name}: {_verdict(other)}." if other else ""
        section.callout(MARKS[each.outcome], " ".join(filter(None, [verdict, each.reason, against])))
        rows: list[list[Cell]] = [[str(one), one.held] for one in each.comparisons]
        for row, one in zip(rows, other.comparisons if other else (), strict=False):
            row += [str(one), one.held]
        section.table(["comparison", "holds", *([name, "holds"] if other else [])], rows)


def _verdict(judgement: Judgement) -> str:
    return f"{judgement.outcome} ({judgement.count} of {len(judgement.comparisons)})"


def _unexpected(claims: Verdicts) -> list[str]:
    """Claims that come out otherwise than the study states."""
    return [
        f"'{each.claim.statement}' is {each.outcome}, where the study states '{each.claim.outcome}'"
        for each, _ in claims
        if not each.as_stated
    ]


def _overview(section: Section, experiments: Experiments) -> None:
    """Mean delta of each data set's model in both validations, and the thesis' in the first."""
    results = {label: result for label, result in experiments.results.items() if result.removed}
    printed = {code: each.published.delta[-1] for code, each in experiments.study.sets.items() if each.published}
    groups = {
        "DMV": {label: mean(result.chosen.errors.dmv) for label, result in results.items()},
        "SFV": {label: mean(result.chosen.errors.sfv) for label, result in results.items()},
        "DMV, thesis": printed,
    }
    finite_groups = {name: {code: value for code, value in each.items() if value < 2} for name, each in groups.items()}
    section.figure(plots.bars(finite_groups, None, "mean δ"), "Mean δ; none where the loop is unstable or δ is above 2")
    if experiments.compared:
        _preparations(section, experiments, experiments.compared)


def _preparations(section: Section, experiments: Experiments, other: Experiments) -> None:
    """What the preparation makes of each data set."""
    names = [each.study.preparation.name for each in (experiments, other)]
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
        [payload * 1000, number, each.frequency, each.damping]
        for payload, found in experiments.physical.items()
        for number, each in enumerate(found, start=1)
    ]
    section.table(["payload [g]", "mode", "frequency [Hz]", "damping"], rows, caption="The physical model")
    away = [
        [label, *(None if np.isinf(each) else 100 * each for each in result.frequencies)]
        for label, result in experiments.results.items()
    ]
    headers = ["data", *(f"mode {number} [%]" for number in range(1, study.physical.modes + 1))]
    section.table(headers, away, caption="Distances")


def _claim(judgement: Judgement) -> ClaimSummary:
    return {
        "statement": judgement.claim.statement,
        "outcome": judgement.outcome,
        "stated": judgement.claim.outcome,
        "reason": judgement.reason,
        "comparisons": [
            {"text": str(each), "less": finite(each.less), "than": finite(each.than), "held": each.held}
            for each in judgement.comparisons
        ],
    }


def _set(experiments: Experiments, result: SetResult) -> dict[str, Any]:
    block = experiments.study.sets[result.code]
    return {
        **block.model_dump(exclude={"published"}),
        "compensation_removed": result.removed,
        "stable_orders": result.stable,
        "order": result.chosen.order,
        "stop_time": result.stop,
        "frequency_distances": [finite(each) for each in result.frequencies],
        "by_order": {str(each.order): {"stable": each.stable, **_errors(each.errors)} for each in result.attempts},
        "model": model_name(result),
    }


def _example(experiments: Experiments, reduction: Reduction) -> dict[str, Any]:
    example = reduction.example
    return {
        "data": example.data,
        "compensation_removed": example.removed,
        "ranking": [
            {"mode": label, "mrm": mrm, "msv": msv}
            for label, mrm, msv in zip(
                *(getattr(reduction.ranking, name) for name in ("labels", "mrm", "msv")), strict=True
            )
        ],
        "stages": {
            stage.name: {"kept": list(stage.kept), "order": stage.model.order, **_errors(stage.errors)}
            for stage in reduction.stages
        },
    }


def _errors(errors: Errors) -> dict[str, Any]:
    return {
        "dmv": [finite(float(each)) for each in errors.dmv],
        "sfv": None if errors.sfv is None else [finite(float(each)) for each in errors.sfv],
    }


def final_models(experiments: Experiments) -> dict[str, LinearModel]:
    """In the signals' own units: the chosen model of each data set, and the updated ones of each example."""
    found = {}
    for result in experiments.results.values():
        found[model_name(result)] = result.unscaled(result.chosen.model)
        for reduction in result.reductions:
            found |= {reduced_name(reduction, stage): result.unscaled(stage.model) for stage in reduction.final}
    return found


def _model(model: LinearModel) -> dict[str, Any]:
    found = modes(model)
    return {
        "order": model.order,
        "step": model.step,
        "matrices": {name: getattr(model, name).tolist() for name in "abcd"},
        "modes": [
            {"mode": label, "frequency": finite(mode.frequency), "damping": finite(mode.damping)}
            for label, mode in zip(labels(found), found, strict=False)
        ],
    }


def _warnings(experiments: Experiments) -> list[str]:
    touched = [
        f"{each.code} ({each.stop:.2g} s)" for each in experiments.results.values() if each.removed and each.stop > 0
    ]
    unstable = [label for label, each in experiments.results.items() if not each.stable]
    warnings = []
    if touched:
        warnings.append(
            f"the arm touched an end stop in {', '.join(touched)}; the thesis would have ended the experiment"
        )
    if unstable:
        warnings.append(f"no order of the range is stable for {', '.join(unstable)}; the best of all is shown")
    return warnings
