"""The traces of a study: recordings in a folder, or the cases of a scenario run as a stand-in for hardware."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from fmus.errors import ScenarioError, TraceError
from fmus.files import sha256
from identification.recordings.schema import Signals, TracesBlock
from orchestrator import formats
from orchestrator.can.logs.suffixes import is_log
from orchestrator.fmi.interface import Value
from orchestrator.formats import Layout
from orchestrator.progress import Progress, silent
from orchestrator.scenario.run import run_scenario
from orchestrator.trace import Trace

NONE = Signals()


@dataclass(frozen=True)
class Recorded:
    """One trace of a campaign and what is known about it.

    Attributes:
        fields: what its file name (or the case that made it) tells, by field [SI].
        source: file it came from, and that file's hash.
        stamps: what was found in its time stamps, in words.
        clean: whether they were in order.
        notes: what else was found in the file, a line each.
        held: whether commands keep their value from stamp to stamp, as those of frames do.
    """

    trace: Trace
    fields: Mapping[str, float]
    source: Path
    sha256: str
    stamps: str
    clean: bool = True
    notes: tuple[str, ...] = ()
    held: bool = False


def load_campaign(
    traces: TracesBlock,
    base: Path,
    data: Path | None,
    progress: Progress = silent,
    signals: Signals = NONE,
) -> list[Recorded]:
    """All traces of a study, by name.

    Args:
        base: folder of the study file, to which its paths are relative.
        data: folder (or one file) of recordings, over the study's folder.
        signals: what the study uses; of a CAN log the rest is not decoded.

    Raises:
        TraceError: there are none, one cannot be read, or its name does not tell what it has to.
        DatabaseError: the database of CAN logs cannot be read, or lacks a signal.
        ScenarioError: `hold_out` names a trace that is not there.
    """
    if traces.scenario is not None:
        recorded = _simulated(base / traces.scenario, progress)
    else:
        layout = traces.layout.layout(base, signals)
        recorded = [_read(file, traces, layout) for file in _files(traces, data or base)]
    return sorted(recorded, key=lambda each: each.trace.name)


def split(recorded: list[Recorded], hold_out: list[str]) -> tuple[list[Recorded], list[Recorded]]:
    """Traces to fit and traces kept aside.

    Raises:
        ScenarioError: a name to hold out is not there, or nothing is left to fit.
    """
    names = {each.trace.name for each in recorded}
    missing = [name for name in hold_out if name not in names]
    if missing:
        raise ScenarioError("traces.hold_out", f"there is no trace '{missing[0]}'", f"there are {_some(sorted(names))}")
    fitted = [each for each in recorded if each.trace.name not in hold_out]
    if not fitted:
        raise ScenarioError("traces.hold_out", "leaves no trace to fit", "hold out fewer")
    return fitted, [each for each in recorded if each.trace.name in hold_out]


def recording_warnings(recorded: Sequence[Recorded]) -> list[str]:
    """A sentence about the traces whose time stamps had to be put in order, and one about those with notes."""
    warnings = []
    if uneven := [each for each in recorded if not each.clean]:
        warnings.append(
            f"time stamps of {len(uneven)} recordings repeat or run backwards (details under data); "
            f"the first: {uneven[0].trace.name}, {uneven[0].stamps}"
        )
    if noted := [each for each in recorded if each.notes]:
        warnings.append(
            f"{len(noted)} of {len(recorded)} recordings are not as they should be (details under data); "
            f"the first: {noted[0].trace.name}, {'; '.join(noted[0].notes)}"
        )
    return warnings


def trace_values(traces: TracesBlock, trace: str, fields: Mapping[str, float]) -> dict[str, Value]:
    """component.variable -> value that is known of a trace, by its fields.

    Raises:
        ScenarioError: a field is not known of it.
    """
    for name, field in traces.values.items():
        if field not in fields:
            raise ScenarioError(
                f"traces.values.{name}",
                f"trace {trace} has no field '{field}'",
                f"there are {', '.join(fields) or 'none'}",
            )
    return {name: fields[field] for name, field in traces.values.items()}


def _files(traces: TracesBlock, folder: Path) -> list[Path]:
    assert traces.files is not None
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise TraceError(folder, "no such file or folder", "give --data PATH")
    try:
        files = sorted(folder.glob(traces.files))
    except (ValueError, NotImplementedError):
        raise ScenarioError("traces.files", f"'{traces.files}' is no pattern below a folder", "write *.mat") from None
    if not files:
        raise TraceError(folder, f"holds no file '{traces.files}'", "give --data PATH, the recordings' folder")
    return _distinct(files)


def _distinct(files: list[Path]) -> list[Path]:
    """The files, whose names without suffix are the names of the traces."""
    known: dict[str, Path] = {}
    for file in files:
        if known.setdefault(file.stem, file) is not file:
            raise TraceError(file, f"has the name of {known[file.stem]}", "rename one, or narrow `traces.files`")
    return files


def _read(file: Path, traces: TracesBlock, layout: Layout) -> Recorded:
    fields = _fields(file, traces)
    recording = formats.read(file, layout)
    trace = replace(recording.trace, name=file.stem)
    return Recorded(
        trace,
        fields,
        file,
        recording.sha256,
        str(recording.stamps),
        recording.stamps.clean,
        recording.notes,
        is_log(file),
    )


def _fields(file: Path, traces: TracesBlock) -> dict[str, float]:
    if traces.file_name is None:
        return {}
    match = re.fullmatch(traces.file_name.pattern, file.stem)
    if match is None:
        raise TraceError(
            file,
            f"its name does not give {', '.join(traces.file_name.fields)}",
            f"name it after the pattern {traces.file_name.pattern}",
        )
    fields = {}
    for name, block in traces.file_name.fields.items():
        try:
            fields[name] = block.number(match[name] or "")
        except ValueError:
            raise TraceError(file, f"its name gives no {name} ('{match[name]}')", "correct the name") from None
    return fields


def _simulated(path: Path, progress: Progress) -> list[Recorded]:
    result = run_scenario(path, progress=progress)
    digest = sha256(path)
    recorded = []
    for case, asked in zip(result.cases, result.scenario.cases, strict=True):
        if case.result is None:
            raise ScenarioError(f"{path}: case {case.name}", f"gave no trace ({case.error})", "correct the scenario")
        fields = {name: float(value) for name, value in asked.values.items() if not isinstance(value, str)}
        trace = replace(result.recorded(case), name=case.name)
        recorded.append(Recorded(trace, fields, path, digest, "simulated"))
    return recorded


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
