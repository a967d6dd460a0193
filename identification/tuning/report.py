"""The report of a tuning: values, goals and figures of every plant, where the starts led, and the step responses."""

from __future__ import annotations

from identification.results import parameter_rows, provenance, verdict_callout
from identification.tuning.summary import goal_summaries, summary, verdict
from identification.tuning.tuning import Tuning
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures
from orchestrator.trace import Trace

SHOWN = 8  # plants whose responses are drawn


def report(result: Tuning) -> Report:
    """Values, goals by plant, starts, step responses, provenance."""
    page = Report(result.study.title, result.study.description)
    section = page.section("Result")
    verdict_callout(section, verdict(result))
    for remark in result.remarks:
        section.callout("warning", remark)
    section.table(*parameter_rows(summary(result)["parameters"]))
    _goals(page.section("Goals"), result)
    if len(result.found.descents) > 1:
        _starts(page.section("Starts"), result)
    if result.found.best.stable:
        _responses(page.section("Step of the reference"), result)
    provenance(page.section("Provenance"), [])
    return page


def _goals(section: Section, result: Tuning) -> None:
    names = list(result.problem.plants.names)[:SHOWN]
    rows: list[list[Cell]] = []
    for goal in goal_summaries(result):
        held = {True: "held", False: "MISSED", None: "-"}[goal["held"]]
        rows.append([goal["goal"], goal["kind"], *(goal["figures"][name] for name in names), held])
    section.table(["goal", "kind", *names, ""], rows)


def _starts(section: Section, result: Tuning) -> None:
    names = list(result.found.starts)
    rows: list[list[Cell]] = [
        [
            *(descent.start[name] for name in names),
            *(descent.found.values[name] for name in names),
            descent.found.objective,
            descent.evaluations,
        ]
        for descent in result.found.descents
    ]
    headers = [*(f"{name}, start" for name in names), *names, "objective", "evaluations"]
    section.table(headers, rows, caption=f"{result.found.agreeing} of {len(rows)} starts led to the values above")


def _responses(section: Section, result: Tuning) -> None:
    trial = result.problem.trial(result.found.best.values)
    followed, plants = trial.followed, result.problem.plants
    curves = []
    for number, name in enumerate(plants.names[:SHOWN]):
        signals = dict(zip(plants.outputs, followed.outputs[number].T, strict=True))
        signals |= dict(zip(plants.inputs, followed.inputs[number].T, strict=True))
        curves.append((name, Trace(followed.time, signals, {}, name)))
    section.figure(figures.overlay(curves[0][1], curves[1:]), f"Linear loops; 'measured' is plant {curves[0][0]}")
