"""The report of a tuning: values, goals and figures of every plant, where the starts led, and the step responses."""

from __future__ import annotations

from identification.results import parameter_rows, provenance, verdict_callout
from identification.tuning.summary import PERCENTILES, goal_summaries, summary, verdict
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
    if result.found.drawn is not None:
        _draws(page.section("Draws"), result)
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


def _draws(section: Section, result: Tuning) -> None:
    draws = summary(result)["draws"]
    section.highlights(
        [
            ("draws", draws["count"], "of plants whose parameters have a spread"),
            ("stable", f"{100 * draws['stable']:.2f} %", ""),
            ("hold all hard goals", f"{100 * draws['held']:.2f} %", f"{100 * draws['asked']:g} % asked for"),
        ]
    )
    rows: list[list[Cell]] = [
        [goal["goal"], *figures] for goal, figures in zip(goal_summaries(result), draws["goals"], strict=True)
    ]
    headers = ["goal", "least", *(f"{p} %" for p in PERCENTILES[1:-1]), "largest"]
    section.table(headers, [row for row in rows if len(row) == len(headers)], caption="Figures of the stable draws")


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
