"""The folder that a run leaves: a trace a case, a manifest of what went in, and a report."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NotRequired

from fmus.files import sha256
from orchestrator import formats
from orchestrator.crossing import Crossing, CrossingDocument, documents_of
from orchestrator.fmi.interface import Value
from orchestrator.report import Report, Section, figures
from orchestrator.results import CaseDocument, FileDocument, result_folder, versions, write_json
from orchestrator.scenario import accounts
from orchestrator.scenario.run import HEADERS, CaseResult, CaseState, ScenarioResult, nonfinite
from orchestrator.scenario.scenario import file_stems

LOG_FILE = "fmu.log"
PLOTTED_CASES = 12
PLOTTED_SIGNALS = 8


class RunCaseDocument(CaseDocument):
    """A case of a run; what follows its state is there where it gave a trace."""

    state: str
    ended: NotRequired[str]
    nonfinite: NotRequired[dict[str, int]]
    trace: NotRequired[str]
    warnings: NotRequired[dict[str, int]]
    stepping: NotRequired[dict[str, str | int | float]]
    statistics: NotRequired[dict[str, accounts.ShareDocument]]
    loop: NotRequired[dict[str, float]]


class RunDocument(FileDocument):
    """What ran and how it went, as manifest.json holds it."""

    scenario: dict[str, str]
    interrupted: bool
    overrides: dict[str, Value]
    units: list[CrossingDocument]
    held: list[str]
    notes: list[str]
    fmus: dict[str, str]
    record: dict[str, int | bool]
    log: str | None
    versions: dict[str, str]


def write_run(result: ScenarioResult, overrides: Mapping[str, Value], target: Path) -> None:
    """Write the folder of a run: `<case>.parquet` (or, of a recorder, `<case>.csv`), manifest.json, report.html."""
    with result_folder(target, [result.scenario.path, *result.assembled.files.values()]) as folder:
        for case in result.cases:
            if case.result is not None and case.file is not None:
                shutil.move(case.file, folder / trace_file(result, case))
            elif case.result is not None:
                formats.write(result.recorded(case), folder / trace_file(result, case))
        if (log := said(result)) is not None:
            shutil.copyfile(log, folder / LOG_FILE)
        write_json(folder / "manifest.json", document_of(result, overrides, target))
        report(result).write(folder / "report.html")


def said(result: ScenarioResult) -> Path | None:
    """The file with what FMUs have said, while it is there; None where they said nothing."""
    log = result.keeping.log
    return log if log is not None and log.is_file() else None


def trace_file(result: ScenarioResult, case: CaseResult) -> str:
    """Name of the file that a case's trace is written to."""
    suffix = "csv" if result.scenario.logger else "parquet"
    return f"{file_stems([one.name for one in result.cases])[result.cases.index(case)]}.{suffix}"


def document_of(result: ScenarioResult, overrides: Mapping[str, Value], folder: Path) -> RunDocument:
    """What ran and how it went, as plain values."""
    return {
        "title": result.scenario.title,
        "scenario": {"file": result.scenario.path.name, "sha256": sha256(result.scenario.path)},
        "passed": result.passed,
        "interrupted": result.interrupted,
        "overrides": {**overrides, **result.overrides},
        "units": documents_of(result.crossings),
        "held": result.scenario.held,
        "notes": list(dict.fromkeys(result.scenario.notes)),
        "out": str(folder),
        "fmus": {name: "model" if name in result.assembled.built else "file" for name in result.assembled.files},
        "record": {"stride": result.keeping.every, "stream": result.keeping.stream is not None},
        "log": LOG_FILE if said(result) else None,
        "cases": [_case(result, case) for case in result.cases],
        "versions": versions(),
    }


def interruption(result: ScenarioResult) -> str:
    """Where a run was interrupted."""
    last = [case for case in result.cases if case.state is not CaseState.NOT_RUN][-1]
    done = last.state is CaseState.DONE
    return f"interrupted after case {last.name}" if done else f"{last.how_far} of case {last.name}"


def report(result: ScenarioResult) -> Report:
    """Checks, traces and step statistics of a run; no traces of an interrupted one, which is to end at once."""
    page = Report(result.scenario.title, result.scenario.description)
    section = page.section("Expectations")
    if result.interrupted:
        section.callout("warning", f"The run was {interruption(result)}.")
    else:
        section.callout("ok" if result.passed else "error", "All held." if result.passed else "Not all held.")
    for case in result.cases:
        if case.ended or case.state is CaseState.FAILED:
            section.callout("warning", f"Case {case.name}: {case.error or case.ended}.")
    for line in result.scenario.held:
        section.callout("warning", f"{line}.")
    section.table(HEADERS, result.rows())
    tell_units(page, result.crossings)
    if not result.interrupted:
        _draw(result, page.section("Traces"))
    stepping = page.section("Step statistics")
    stepping.paragraph(accounts.sentence_of(result))
    stepping.table(accounts.HEADERS, accounts.rows_of(result))
    return page


def tell_units(page: Report, crossings: Sequence[Crossing]) -> None:
    """A section about what was converted, where something was; what is doubtful first."""
    if not crossings:
        return
    section = page.section("Units")
    for one in crossings:
        if one.doubtful:
            section.callout("warning", str(one))
    sure = [(str(one),) for one in crossings if not one.doubtful]
    if sure:
        section.table(("how values got to their units",), sure)


def _draw(result: ScenarioResult, section: Section) -> None:
    shown = [case for case in result.cases if case.result is not None]
    if len(shown) > PLOTTED_CASES:
        section.paragraph(f"The first {PLOTTED_CASES} of {len(shown)} cases.")
    for case in shown[:PLOTTED_CASES]:
        if not case.trace.names:
            section.paragraph(f"Case {case.name} has recorded nothing.")
            continue
        section.figure(figures.overlay(case.trace, (), case.trace.names[:PLOTTED_SIGNALS]), case.name)


def _case(result: ScenarioResult, case: CaseResult) -> RunCaseDocument:
    document: RunCaseDocument = {
        "name": case.name,
        "state": str(case.state),
        "passed": case.passed,
        "error": str(case.error) if case.error else None,
        "checks": [{"text": check.text, "held": check.held, "found": check.found} for check in case.checks],
    }
    if case.result is not None:
        document["trace"] = trace_file(result, case)
        document["warnings"] = dict(case.result.warnings)
        if case.ended:
            document["ended"] = case.ended
        if counts := nonfinite(case.result.trace):
            document["nonfinite"] = counts
        return {**document, **accounts.document_of(case.result)}
    return document
