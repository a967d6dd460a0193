"""The report of a tuning: values, goals of every plant and over draws, where the starts led, and the loops' figures."""

from __future__ import annotations

from identification.result_sections import provenance
from identification.tuning.report import frequency, poles, responses, trade_off
from identification.tuning.report.shown import shown, stable
from identification.tuning.report.told import tell_outcome
from identification.tuning.summary import PERCENTILES, DrawsSummary, ShareSummary, share_words, summary
from identification.tuning.tuning import Tuning
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section


def report(result: Tuning) -> Report:
    """Values, goals by plant and over draws, starts, trade-offs, loops, poles, responses, provenance."""
    page = Report(result.study.title, result.study.description)
    found = summary(result)
    tell_outcome(page, found, result.names)
    if "draws" in found:
        _draws(page.section("Draws"), found["draws"])
    if len(result.found.descents) > 1:
        _starts(page.section("Starts"), result)
    if result.found.trades:
        trade_off.draw(page.section("Trade-off"), result)
    every = shown(result)
    frequency.draw(page.section("Opened loops"), result, every)
    poles.draw(page.section("Poles"), result, every)
    loops = stable(result, every)
    if loops.names:
        responses.draw(page.section("Responses"), result, loops)
    provenance(page, found)
    return page


def _draws(section: Section, draws: DrawsSummary) -> None:
    unseen, asked = draws["unseen"], f"{100 * draws['asked']:g} % asked for"
    section.highlights(
        [
            ("draws that the values had to hold for", draws["count"], ""),
            ("of these hold all hard goals", f"{100 * draws['held']:.2f} %", asked),
            ("of as many others", f"{100 * unseen['held']['share']:.2f} %", f"95 %: {_interval(unseen['held'])}"),
            ("of these are stable", f"{100 * unseen['stable']['share']:.2f} %", f"95 %: {_interval(unseen['stable'])}"),
        ]
    )
    rows: list[list[Cell]] = [
        [goal["goal"], "-" if goal["held"] is None else share_words(goal["held"]), *goal["percentiles"]]
        for goal in unseen["goals"]
        if goal["percentiles"]
    ]
    headers = ["goal", "held by", "least", *(f"{p} %" for p in PERCENTILES[1:-1]), "largest"]
    said = "Draws that nothing was fitted to: which share holds a goal (95 % interval), and figures of stable loops"
    section.table(headers, rows, caption=said)


def _interval(share: ShareSummary) -> str:
    low, high = share["ci95"]
    return f"{100 * low:.2f} to {100 * high:.2f} %"


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
