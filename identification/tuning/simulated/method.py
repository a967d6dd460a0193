"""Tuning on simulated closed loops: a controller's values for scenarios and goals."""

from __future__ import annotations

from identification.method import Method, without_data
from identification.result_sections import provenance
from identification.tuning.report.told import SHOWN, tell_outcome
from identification.tuning.simulated.schema import SimulatedBlock
from identification.tuning.simulated.tuning import SimulatedTuning, tune
from identification.tuning.summary import TuningSummary, basic_summary, calibrated
from orchestrator.report import Report, figures


def summary(result: SimulatedTuning) -> TuningSummary:
    """The tuning as `summary.json` holds it; there are no poles."""
    return basic_summary(result, "tune-simulated")


def report(result: SimulatedTuning) -> Report:
    """Values, goals by plant, and the runs."""
    page = Report(result.study.title, result.study.description)
    found = summary(result)
    tell_outcome(page, found, result.names)
    if result.found.best.stable:
        curves = [(name, result.problem.loops[name].run(result.found.best.values)) for name in result.names[:SHOWN]]
        page.section("Runs").figure(figures.overlay(curves[0][1], curves[1:]), f"'measured' is {curves[0][0]}")
    provenance(page, found)
    return page


METHOD: Method[SimulatedBlock, SimulatedTuning] = Method(
    SimulatedBlock, without_data(tune), summary, report, calibrated, command="tune"
)
