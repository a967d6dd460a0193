"""Tuning on simulated closed loops: a controller's values for scenarios and goals."""

from __future__ import annotations

from pathlib import Path

from identification.method import Method
from identification.result_sections import parameter_rows, provenance, verdict_callout
from identification.tuning.simulated.schema import SimulatedBlock
from identification.tuning.simulated.tuning import SimulatedTuning, tune
from identification.tuning.summary import TuningSummary, basic_summary, calibrated, goal_summaries, verdict
from orchestrator.display.table import Cell
from orchestrator.fmi.isolation import Isolation
from orchestrator.progress import Progress
from orchestrator.report import Report, figures

SHOWN = 8  # plants that are drawn


def summary(result: SimulatedTuning) -> TuningSummary:
    """The tuning as `summary.json` holds it; there are no poles."""
    return basic_summary(result, "tune-simulated")


def report(result: SimulatedTuning) -> Report:
    """Values, goals by plant, and the runs."""
    page = Report(result.study.title, result.study.description)
    section = page.section("Result")
    verdict_callout(section, verdict(result))
    for remark in result.remarks:
        section.callout("warning", remark)
    section.table(*parameter_rows(summary(result)["parameters"]))
    names = result.names[:SHOWN]
    rows: list[list[Cell]] = [
        [
            goal["goal"],
            goal["kind"],
            *(goal["figures"][name] for name in names),
            {True: "held", False: "MISSED", None: "-"}[goal["held"]],
        ]
        for goal in goal_summaries(result)
    ]
    page.section("Goals").table(["goal", "kind", *names, ""], rows)
    if result.found.best.stable:
        curves = [(name, result.problem.loops[name].run(result.found.best.values)) for name in names]
        page.section("Runs").figure(figures.overlay(curves[0][1], curves[1:]), f"'measured' is {curves[0][0]}")
    provenance(page.section("Provenance"), [])
    return page


def _run(
    block: SimulatedBlock, base: Path, data: Path | None, progress: Progress, isolation: Isolation | None
) -> SimulatedTuning:
    return tune(block.study(base), progress, isolation)


METHOD: Method[SimulatedBlock, SimulatedTuning] = Method(
    SimulatedBlock, _run, summary, report, calibrated, command="tune"
)
