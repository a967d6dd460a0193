"""The folder that a run leaves: a trace a case, a manifest of what went in, and a report."""

from __future__ import annotations

import itertools
import re
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fmus.files import sha256
from orchestrator import formats
from orchestrator.report import Report, figures
from orchestrator.results import result_folder, versions, write_json
from orchestrator.scenario import CaseResult, ScenarioResult
from orchestrator.slave import Value
from orchestrator.trace import Trace

PLOTTED_CASES = 12
PLOTTED_SIGNALS = 8


def write_run(result: ScenarioResult, overrides: Mapping[str, Value], target: Path) -> None:
    """Write the folder of a run: `<case>.parquet` (or, of a recorder, `<case>.csv`), manifest.json, report.html."""
    with result_folder(target) as folder:
        for case in result.cases:
            if case.result is not None and case.file is not None:
                shutil.move(case.file, folder / trace_file(result, case))
            elif case.result is not None:
                formats.write(result.recorded(case), folder / trace_file(result, case))
        write_json(folder / "manifest.json", document_of(result, overrides, target))
        report(result).write(folder / "report.html")


def trace_file(result: ScenarioResult, case: CaseResult) -> str:
    """Name of the file that a case's trace is written to."""
    suffix = "csv" if result.block.recorder else "parquet"
    return f"{_stems(result.cases)[result.cases.index(case)]}.{suffix}"


def document_of(result: ScenarioResult, overrides: Mapping[str, Value], folder: Path) -> dict[str, Any]:
    """What ran and how it went, as plain values."""
    return {
        "title": result.block.title,
        "scenario": {"file": result.path.name, "sha256": sha256(result.path)},
        "passed": result.passed,
        "overrides": dict(overrides),
        "out": str(folder),
        "fmus": {name: ("model" if built else "file") for name, built in result.assembled.built.items()},
        "cases": [_case(result, case) for case in result.cases],
        "versions": versions(),
    }


def rows_of(result: ScenarioResult) -> list[tuple[str, str, str, str]]:
    """(case, expectation, held, found) of every check; a case without expectations has a row too."""
    rows = []
    for case in result.cases:
        rows += [(case.name, each.text, "yes" if each.held else "NO", each.found) for each in case.checks]
        if not case.checks:
            rows.append((case.name, "-", "-", "ran through"))
    return rows


def report(result: ScenarioResult) -> Report:
    """Checks, traces and step statistics of a run."""
    page = Report(result.block.title, result.block.description)
    section = page.section("Expectations")
    section.callout("ok" if result.passed else "error", "All held." if result.passed else "Not all held.")
    section.table(["case", "expectation", "held", "found"], rows_of(result))
    traces = page.section("Traces")
    shown = [case for case in result.cases if case.result is not None]
    if len(shown) > PLOTTED_CASES:
        traces.paragraph(f"The first {PLOTTED_CASES} of {len(shown)} cases.")
    for case in shown[:PLOTTED_CASES]:
        trace = _trace(case)
        traces.figure(figures.overlay(trace, (), trace.names[:PLOTTED_SIGNALS]), case.name)
    statistics = page.section("Step statistics")
    for case in shown[:1]:
        assert case.result is not None
        rows: list[list[str | float | None]] = [
            [name, s.calls, s.seconds, 1e6 * s.seconds / max(s.calls, 1)] for name, s in case.result.statistics.items()
        ]
        statistics.table(["component", "steps", "time [s]", "µs a step"], rows, caption=f"Case {case.name}")
    return page


def _stems(cases: Sequence[CaseResult]) -> list[str]:
    """A file name for each case, made of its name's letters; distinct also where case is not told apart."""
    stems: list[str] = []
    taken: set[str] = set()
    for case in cases:
        plain = re.sub(r"[^\w.-]+", "_", case.name) or "_"
        numbered = (f"{plain}-{number}" for number in itertools.count(2))
        stem = next(each for each in itertools.chain([plain], numbered) if each.casefold() not in taken)
        taken.add(stem.casefold())
        stems.append(stem)
    return stems


def _case(result: ScenarioResult, case: CaseResult) -> dict[str, Any]:
    document: dict[str, Any] = {
        "name": case.name,
        "passed": case.passed,
        "error": str(case.error) if case.error else None,
        "checks": [{"text": each.text, "held": each.held, "found": each.found} for each in case.checks],
    }
    if case.result is not None:
        document["trace"] = trace_file(result, case)
        document["warnings"] = dict(case.result.warnings)
        document["statistics"] = {
            name: {"calls": each.calls, "seconds": round(each.seconds, 6)}
            for name, each in case.result.statistics.items()
        }
    return document


def _trace(case: CaseResult) -> Trace:
    assert case.result is not None
    return case.result.trace
