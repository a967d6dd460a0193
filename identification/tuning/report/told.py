"""What the reports of all tunings begin with: verdict, remarks, values, and the goals by plant."""

from __future__ import annotations

from collections.abc import Sequence

from identification.result_sections import parameter_rows, verdict_callout
from identification.tuning.summary import TuningSummary
from orchestrator.display.table import Cell
from orchestrator.report import Report

SHOWN = 8  # plants whose figures stand in a table


def tell_outcome(page: Report, found: TuningSummary, plants: Sequence[str]) -> None:
    """The sections of a tuning's values and goals."""
    section, names = page.section("Result"), plants[:SHOWN]
    verdict_callout(section, found["verdict"])
    section.warnings(found["warnings"])
    section.table(*parameter_rows(found["parameters"]))
    rows: list[list[Cell]] = []
    for goal in found["goals"]:
        held = {True: "held", False: "MISSED", None: "-"}[goal["held"]]
        rows.append([goal["goal"], goal["kind"], *(goal["figures"][name] for name in names), held])
    page.section("Goals").table(["goal", "kind", *names, ""], rows)
