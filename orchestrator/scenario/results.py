"""The folder that a run leaves: a trace a case, a manifest of what went in, and a report."""

from __future__ import annotations

import math
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NotRequired, TypedDict

from fmus.files import sha256
from orchestrator import formats
from orchestrator.crossing import CrossingDocument, documents_of
from orchestrator.engine import ValueChange
from orchestrator.fmi.interface import Value
from orchestrator.fmi.said import LOG_FILE
from orchestrator.realtime.deadlines import Deadlines
from orchestrator.results import CaseDocument, CheckDocument, FileDocument, result_folder, versions, write_json
from orchestrator.scenario import accounts
from orchestrator.scenario.expectations import Check
from orchestrator.scenario.report import report
from orchestrator.scenario.run import CaseResult, ScenarioResult, nonfinite
from orchestrator.scenario.scenario import file_stems

PROFILE = "profile.json"


class RunCaseDocument(CaseDocument):
    """A case of a run; what follows its state is there where it gave a trace."""

    state: str
    ended: NotRequired[str]
    nonfinite: NotRequired[dict[str, int]]
    trace: NotRequired[str]
    processor: NotRequired[float]
    warnings: NotRequired[dict[str, int]]
    stepping: NotRequired[accounts.EngineDocument]
    statistics: NotRequired[dict[str, accounts.ShareDocument]]
    loop: NotRequired[dict[str, float]]
    deadlines: NotRequired[Deadlines]
    changes: NotRequired[Sequence[ValueChange]]
    buses: NotRequired[dict[str, BusDocument]]
    intermediate: NotRequired[dict[str, str]]


class RecordingDocument(TypedDict):
    """A file that drove the run or that it was compared with, as seen from the scenario's folder."""

    read_for: str
    file: str
    sha256: str


class BusDocument(TypedDict):
    """What a bus has carried: frames, the share of the time that they took, their log, and what was out of the
    ordinary."""

    frames: int
    load: float
    log: str
    remarks: list[str]


class RunDocument(FileDocument):
    """What ran and how it went, as manifest.json holds it."""

    scenario: dict[str, str]
    parts: dict[str, str]
    recordings: list[RecordingDocument]
    interrupted: bool
    overrides: dict[str, Value]
    units: list[CrossingDocument]
    held: list[str]
    notes: list[str]
    fmus: dict[str, str]
    record: dict[str, int | bool]
    log: str | None
    versions: dict[str, str]


def write_run(result: ScenarioResult, overrides: Mapping[str, Value], target: Path, shared: str | None = None) -> None:
    """Write the folder of a run: `<case>.parquet` (or, of a recorder, `<case>.csv`), manifest.json, report.html;
    and profile.json where there is one, of each bus `<case>.<bus>.log`, and of each component whose values within
    its steps are kept `<case>.<component>.parquet`.

    Args:
        shared: the folder that the report takes its script from, as seen from its own, where this is one result of
            many: its files do not wait for the disk then. None has the script in the report.
    """
    with result_folder(target, [result.scenario.path, *result.assembled.files.values()]) as folder:
        for case in result.cases:
            if case.result is not None and case.file is not None:
                shutil.move(case.file, folder / trace_file(result, case))
            elif case.result is not None:
                formats.write(result.recorded(case), folder / trace_file(result, case), for_good=shared is None)
            _write_buses(result, case, folder)
            for name, trace in case.result.intermediate.items() if case.result is not None else ():
                formats.write(trace, folder / intermediate_file(result, case, name), for_good=shared is None)
        if (log := said(result)) is not None:
            shutil.copyfile(log, folder / LOG_FILE)
        write_json(folder / "manifest.json", document_of(result, overrides, target))
        with result.keeping.span("write the report"):
            report(result).write(folder / "report.html", shared, for_good=shared is None)
        if result.keeping.profile is not None:
            write_json(folder / PROFILE, result.keeping.profile.document())


def _write_buses(result: ScenarioResult, case: CaseResult, folder: Path) -> None:
    """Write what the buses of a case have carried."""
    if case.result is None or not case.result.carried:
        return
    from orchestrator.can.logs import writing as logs  # noqa: PLC0415 (it brings python-can along, and its readers)

    for bus, carried in case.result.carried.items():
        logs.write(folder / bus_log(result, case, bus), [carried.frames])


def said(result: ScenarioResult) -> Path | None:
    """The file with what FMUs have said, while it is there; None where they said nothing."""
    log = result.keeping.log
    return log if log is not None and log.is_file() else None


def trace_file(result: ScenarioResult, case: CaseResult) -> str:
    """Name of the file that a case's trace is written to."""
    suffix = "csv" if result.scenario.logger else "parquet"
    return f"{file_stems([one.name for one in result.cases])[result.cases.index(case)]}.{suffix}"


def bus_log(result: ScenarioResult, case: CaseResult, bus: str) -> str:
    """Name of the file that the frames of a bus are written to."""
    return f"{Path(trace_file(result, case)).stem}.{bus}.log"


def intermediate_file(result: ScenarioResult, case: CaseResult, component: str) -> str:
    """Name of the file with what a component gave within its steps."""
    return f"{Path(trace_file(result, case)).stem}.{component}.parquet"


def document_of(result: ScenarioResult, overrides: Mapping[str, Value], folder: Path) -> RunDocument:
    """What ran and how it went, as plain values."""
    return {
        "title": result.scenario.title,
        "scenario": {"file": result.scenario.path.name, "sha256": sha256(result.scenario.path)},
        "parts": {file.name: sha256(file) for file in result.scenario.parts},
        "passed": result.passed,
        "recordings": [{"read_for": what, "file": file, "sha256": digest} for what, file, digest in result.recordings],
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


def document_of_check(check: Check) -> CheckDocument:
    """How an expectation turned out, as plain values: figures that are numbers, and what is out of the ordinary."""
    document: CheckDocument = {"text": check.text, "held": check.held, "found": check.found}
    if check.figure is not None and math.isfinite(check.figure):
        document |= {"figure": check.figure, "unit": check.unit}
    if check.margin is not None and math.isfinite(check.margin):
        document["margin"] = check.margin
    if not check.needed:
        document["needed"] = False
    if check.doubt:
        document["doubt"] = check.doubt
    if check.parts:
        document["parts"] = [document_of_check(part) for part in check.parts]
    return document


def _case(result: ScenarioResult, case: CaseResult) -> RunCaseDocument:
    document: RunCaseDocument = {
        "name": case.name,
        "state": str(case.state),
        "passed": case.passed,
        "error": str(case.error) if case.error else None,
        "checks": [document_of_check(check) for check in case.checks],
        "seconds": round(case.seconds, 6),
    }
    if case.result is not None:
        document["processor"] = round(case.processor, 6)
        document["trace"] = trace_file(result, case)
        document["warnings"] = dict(case.result.warnings)
        if case.ended:
            document["ended"] = case.ended
        if counts := nonfinite(case.result.trace):
            document["nonfinite"] = counts
        if case.result.deadlines is not None:
            document["deadlines"] = case.result.deadlines
        if case.result.carried:
            document["buses"] = {
                name: {
                    "frames": len(carried.frames),
                    "load": round(carried.load, 6),
                    "log": bus_log(result, case, name),
                    "remarks": [*carried.remarks],
                }
                for name, carried in case.result.carried.items()
            }
        if case.result.intermediate:
            names = case.result.intermediate
            document["intermediate"] = {name: intermediate_file(result, case, name) for name in names}
        if case.result.changes:
            document["changes"] = case.result.changes
        return {**document, **accounts.document_of(case.result)}
    return document
