"""The report of an inverse-dynamics identification: the ways side by side, and the force they explain."""

from __future__ import annotations

from identification.inverse_dynamics.calibration import InverseCalibration
from identification.inverse_dynamics.results import summary
from identification.result_sections import draw_parameters, provenance, verdict_callout
from orchestrator.display.table import Cell
from orchestrator.report import Report, Section, figures
from orchestrator.trace import Trace

SHOWN = 4  # records that are drawn


def report(result: InverseCalibration) -> Report:
    """The whole report."""
    page = Report(result.study.title, result.study.description)
    section, found = page.section("Result"), summary(result)
    verdict_callout(section, found["verdict"])
    section.warnings(result.warnings)
    draw_parameters(section, found["parameters"], "What is written, with half of the 95 % intervals")
    _ways(section, result)
    _forces(page.section("Forces"), result)
    provenance(page, found)
    return page


def _ways(section: Section, result: InverseCalibration) -> None:
    """Each way, and each of those compared, a row."""
    targets = list(result.study.write.values())
    rows: list[list[Cell]] = [[way, *found.values.values()] for way, found in result.found.items()]
    for name, values in result.study.compare.items():
        rows.append([name, *(values.get(target) for target in targets)])
    section.table(["way", *targets], rows, caption="The ways side by side, and what others have")


def _forces(section: Section, result: InverseCalibration) -> None:
    section.paragraph("Recorded forces on the rows of the regression, and what motion and parameters make of them.")
    for one in result.rows[:SHOWN]:
        measured = Trace(one.time, {"force": one.y}, {}, one.record.name)
        explained = Trace(one.time, {"force": result.predicted(one)}, {}, one.record.name)
        section.figure(figures.overlay(measured, [("explained", explained)]), one.record.name)
