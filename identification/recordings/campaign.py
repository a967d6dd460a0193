"""The traces of a study: recordings in a folder, or the cases of a scenario run as a stand-in for hardware."""

from __future__ import annotations

import decimal
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from fmus import units
from fmus.errors import ScenarioError, TraceError
from fmus.files import sha256
from fmus.units import ONE
from identification.recordings.bridged import safe_stretches
from identification.recordings.marks import MUCH, Exclusion, covered, excluded
from identification.recordings.parts import RecordingPart, parted
from identification.recordings.rates import filled
from orchestrator import formats
from orchestrator.can.log_suffixes import is_log
from orchestrator.crossing import Crossing, noted
from orchestrator.fmi.interface import Value
from orchestrator.fmi.isolation import Isolation
from orchestrator.formats import Layout
from orchestrator.marks import Kind, Mark, listed
from orchestrator.progress import Progress, silent
from orchestrator.trace import Trace

DAMAGE = {"missing", "checksums", "counters", "not_finite", "out_of_range", "setbacks", "strays", "damaged"}
"""What may be found in a file that may spoil a fit."""
DecimalPoint = Literal["point", "underscore", "after first digit"]


@dataclass(frozen=True)
class FileField:
    """How digits in a file's name make a number: where its decimal point is, and a factor to SI or a known unit."""

    decimal: DecimalPoint = "point"
    factor: float = 1.0
    unit: str = ""

    def number(self, text: str) -> float:
        """The number that the digits mean, in SI.

        Raises:
            ValueError: they are none.
        """
        unit = units.parse(self.unit) or ONE
        return unit.factor * self.read(text) + unit.offset

    def read(self, text: str) -> float:
        """The number that the digits mean, times the factor.

        Raises:
            ValueError: they are none.
        """
        if self.decimal == "underscore":
            text = text.replace("_", ".")
        elif self.decimal == "after first digit":
            text = f"{text[:1]}.{text[1:]}"
        try:
            number = float(decimal.Decimal(text) * decimal.Decimal(repr(self.factor)))
        except ArithmeticError:
            raise ValueError(f"'{text}' is no number") from None
        if not math.isfinite(number):
            raise ValueError(f"'{text}' is not finite")
        return number


@dataclass(frozen=True)
class FileName:
    """What the files' names tell: named groups of a regular expression, as numbers."""

    pattern: str
    fields: Mapping[str, FileField] = field(default_factory=dict)


@dataclass(frozen=True)
class TraceSource:
    """Where the traces of a study come from.

    Attributes:
        folder: of the recordings.
        files: pattern of their names; without one the cases of `scenario` are run.
        layout: which column of a recording is which signal.
        values: component.variable -> field of the file's name (or of the case), known of every trace.
        hold_out: names of traces, and of parts, that are kept out of the fit and judged afterwards.
        parts: those of traces whose rest is fitted.
        exclude: stretches that are left out.
        keep: kinds of marks whose stretches are not left out.
        used: signals that the study uses; marks of others do not matter.
        linear: those that run linearly between their samples, as what is compared does.
    """

    folder: Path
    files: str | None = None
    scenario: Path | None = None
    layout: Layout = field(default_factory=Layout)
    file_name: FileName | None = None
    values: Mapping[str, str] = field(default_factory=dict)
    hold_out: tuple[str, ...] = ()
    parts: tuple[RecordingPart, ...] = ()
    exclude: tuple[Exclusion, ...] = ()
    keep: frozenset[Kind] = frozenset()
    used: frozenset[str] = frozenset()
    linear: frozenset[str] = frozenset()


@dataclass(frozen=True)
class StudyTrace:
    """One trace of a study and what is known about it.

    Attributes:
        fields: what its file name (or the case that made it) tells, by field [SI].
        written: the fields that have a unit, like `120.5 g`.
        source: file it came from, and that file's hash.
        stamps: what was found in its time stamps, in words.
        clean: whether they were in order.
        notes: what else was found in the file, a line each.
        held: whether commands keep their value from stamp to stamp, as those of frames do.
        values: component.variable -> value that holds for this trace [unit of the variable, or the text's].
        crossings: how its signals got to the units that they are in.
        marks: stretches that are left out; kept: that are taken all the same.
        damaged: whether something was seen in the file that may spoil a fit.
        part_of: name of the trace that it is a part of; "" of a whole one.
    """

    trace: Trace
    fields: Mapping[str, float]
    source: Path
    sha256: str
    stamps: str
    clean: bool = True
    notes: tuple[str, ...] = ()
    held: bool = False
    values: Mapping[str, Value] = field(default_factory=dict)
    crossings: tuple[Crossing, ...] = ()
    marks: tuple[Mark, ...] = ()
    written: Mapping[str, str] = field(default_factory=dict)
    kept: tuple[Mark, ...] = ()
    damaged: bool = False
    part_of: str = ""

    @property
    def excluded_as(self) -> str:
        """What `traces.exclude` calls it."""
        return self.part_of or self.trace.name

    @property
    def place(self) -> str:
        """What messages call it: its file, or the case of a scenario."""
        return str(self.source) if self.source.stem == self.trace.name else self.trace.name

    @property
    def left_out(self) -> float:
        """How much of it is left out [s]."""
        return covered(self.marks, self.trace)

    @property
    def remarks(self) -> tuple[str, ...]:
        """The notes, and how much is left out, a line each."""
        left = f"{self.left_out:.3g} of {self.trace.duration:.3g} s are left out: {listed(self.marks)}"
        kept = f"taken all the same, as the study says: {listed(self.kept)}"
        return (*self.notes, *([kept] if self.kept else []), *([left] if self.marks else []))


def load_campaign(
    source: TraceSource,
    data: Path | None = None,
    progress: Progress = silent,
    isolation: Isolation | None = None,
    foreign: bool = False,
) -> list[StudyTrace]:
    """All traces of a study, by name.

    Args:
        data: folder (or one file) of recordings, over the source's folder.
        isolation: how FMUs of a scenario are isolated, None where they are not.
        foreign: whether the recordings may be others than those that the study was written for.

    Raises:
        TraceError: there are none, one cannot be read, or its name does not tell what it has to.
        DatabaseError: the database of CAN logs cannot be read, or lacks a signal.
        ScenarioError: a field that the study takes a value from is not known of a trace, or an exclusion is of none.
    """
    if source.scenario is not None:
        traces = _simulated(source.scenario, progress, isolation)
    else:
        traces = [_read(file, source) for file in _files(source, data or source.folder)]
    left_out = excluded(source.exclude, [trace.trace for trace in traces], foreign)
    known = [
        replace(
            trace,
            values=trace_values(source.values, trace.trace.name, {**trace.fields, **trace.written}),
            marks=(*trace.marks, *marks),
        )
        for trace, marks in zip(traces, left_out, strict=True)
    ]
    return sorted(_with_parts(known, source.parts, foreign), key=lambda trace: trace.trace.name)


def recorded_bytes(source: TraceSource, data: Path | None = None) -> int:
    """How much there is to be read, as `load_campaign` would; 0 where it is simulated."""
    return (
        0 if source.scenario is not None else sum(file.stat().st_size for file in _files(source, data or source.folder))
    )


def _with_parts(known: list[StudyTrace], parts: Sequence[RecordingPart], foreign: bool) -> Iterator[StudyTrace]:
    """The traces, those that have parts to be held out followed by these."""
    names = {trace.trace.name for trace in known}
    missing = [part.trace for part in parts if part.trace not in names]
    if missing and not foreign:
        raise ScenarioError("traces.hold_out", f"there is no trace '{missing[0]}'", f"there are {_some(sorted(names))}")
    for whole in known:
        own = [part for part in parts if part.trace == whole.trace.name]
        for trace, marks in parted(whole.trace, own):
            yield replace(whole, trace=trace, marks=(*whole.marks, *marks), part_of=whole.trace.name)


def split(traces: list[StudyTrace], hold_out: Sequence[str]) -> tuple[list[StudyTrace], list[StudyTrace]]:
    """Traces to fit and traces kept aside.

    Raises:
        ScenarioError: a name to hold out is not there, or nothing is left to fit.
    """
    names = {trace.trace.name for trace in traces}
    missing = [name for name in hold_out if name not in names]
    if missing:
        raise ScenarioError("traces.hold_out", f"there is no trace '{missing[0]}'", f"there are {_some(sorted(names))}")
    fitted = [trace for trace in traces if trace.trace.name not in hold_out]
    if not fitted:
        raise ScenarioError("traces.hold_out", "leaves no trace to fit", "hold out fewer")
    return fitted, [trace for trace in traces if trace.trace.name in hold_out]


def recording_warnings(traces: Sequence[StudyTrace]) -> list[str]:
    """What is doubtful about units, and a sentence each about traces with stamps out of order, and with notes."""
    crossings = noted(crossed for trace in traces for crossed in trace.crossings)
    warnings = [*(str(crossed) for crossed in crossings if crossed.doubtful), *_same(traces)]
    if uneven := [trace for trace in traces if not trace.clean]:
        warnings.append(
            f"time stamps of {len(uneven)} recordings repeat or run backwards (details under data); "
            f"the first: {uneven[0].trace.name}, {uneven[0].stamps}"
        )
    if much := [trace for trace in traces if trace.left_out > MUCH * trace.trace.duration]:
        warnings.append(_much(traces, much))
    told = [(trace.trace.name, trace.remarks[: -1 if trace in much else None]) for trace in traces]
    if remarked := [(name, remarks) for name, remarks in told if remarks]:
        warnings.append(
            f"what was seen in {len(remarked)} of {len(traces)} recordings is to be known (details under data); "
            f"the first: {remarked[0][0]}, {'; '.join(remarked[0][1])}"
        )
    return warnings


def _same(traces: Sequence[StudyTrace]) -> Iterator[str]:
    """Files that hold the same: what is fitted twice tells no more, and what is kept aside was seen."""
    by_content: dict[str, dict[Path, str]] = {}
    for trace in traces:
        by_content.setdefault(trace.sha256, {}).setdefault(trace.source, trace.trace.name)
    for files in by_content.values():
        if len(files) > 1:
            yield (
                f"{' and '.join(files.values())} are the same recording: fitted twice it makes intervals narrower than "
                "they are, and kept aside it judges nothing; remove all but one"
            )


def _much(traces: Sequence[StudyTrace], much: Sequence[StudyTrace]) -> str:
    """How much of the recordings is left out, and why."""
    lost, whole = (
        sum(seconds) for seconds in zip(*((trace.left_out, trace.trace.duration) for trace in traces), strict=True)
    )
    first = max(much, key=lambda trace: trace.left_out)
    return (
        f"{lost:.3g} of {whole:.3g} s of the recordings are left out ({lost / whole:.0%}; details under data), most of "
        f"{first.trace.name}: {listed(first.marks)}"
    )


def trace_values(values: Mapping[str, str], trace: str, fields: Mapping[str, Value]) -> dict[str, Value]:
    """component.variable -> value that is known of a trace, by its fields.

    Raises:
        ScenarioError: a field is not known of it.
    """
    for name, known in values.items():
        if known not in fields:
            raise ScenarioError(
                f"traces.values.{name}",
                f"trace {trace} has no field '{known}'",
                f"there are {', '.join(fields) or 'none'}",
            )
    return {name: fields[known] for name, known in values.items()}


def _files(source: TraceSource, folder: Path) -> list[Path]:
    assert source.files is not None
    if folder.is_file():
        return [folder]
    if not folder.is_dir():
        raise TraceError(folder, "no such file or folder", "give --data PATH")
    try:
        files = sorted(folder.glob(source.files))
    except (ValueError, NotImplementedError):
        raise ScenarioError("traces.files", f"'{source.files}' is no pattern below a folder", "write *.mat") from None
    if not files:
        raise TraceError(folder, f"holds no file '{source.files}'", "give --data PATH, the recordings' folder")
    return _distinct(files)


def _distinct(files: list[Path]) -> list[Path]:
    """The files, whose names without suffix are the names of the traces."""
    known: dict[str, Path] = {}
    for file in files:
        if known.setdefault(file.stem, file) is not file:
            raise TraceError(file, f"has the name of {known[file.stem]}", "rename one, or narrow `traces.files`")
    return files


def _read(file: Path, source: TraceSource) -> StudyTrace:
    fields, written = _fields(file, source.file_name) if source.file_name else ({}, {})
    recording = formats.read(file, source.layout)
    trace, stamps, held = replace(recording.trace, name=file.stem), recording.stamps, is_log(file)
    # what a message says first comes a little later than others
    begun, slower = (trace.complete(), ()) if held else filled(trace, source.used, source.linear)
    told = recording.marks if held else (*recording.marks, *safe_stretches(file, float(trace.time[-1])))
    matter = [mark for mark in told if not source.used or mark.concerns(source.used)]
    marks, kept = (tuple(mark for mark in matter if (mark.kind in source.keep) == side) for side in (False, True))
    damaged = bool(DAMAGE & recording.found.keys() or matter)
    return StudyTrace(
        begun,
        fields,
        file,
        recording.sha256,
        str(stamps),
        stamps.clean,
        (*recording.notes, *slower),
        held=held,
        marks=marks,
        kept=kept,
        damaged=damaged,
        written=written,
    )


def _fields(file: Path, name: FileName) -> tuple[dict[str, float], dict[str, str]]:
    """What a file's name tells, in SI; and what has a unit, as text with it."""
    match = re.fullmatch(name.pattern, file.stem)
    if match is None:
        raise TraceError(
            file, f"its name does not give {', '.join(name.fields)}", f"name it after the pattern {name.pattern}"
        )
    fields, written = dict[str, float](), dict[str, str]()
    for key, digits in name.fields.items():
        try:
            fields[key] = digits.number(match[key] or "")
            written |= {key: f"{digits.read(match[key])!r} {digits.unit}"} if digits.unit else {}
        except ValueError:
            raise TraceError(file, f"its name gives no {key} ('{match[key]}')", "correct the name") from None
    return fields, written


def _simulated(path: Path, progress: Progress, isolation: Isolation | None) -> list[StudyTrace]:
    from orchestrator.scenario.run import run_scenario  # noqa: PLC0415 - loads slowly

    result = run_scenario(path, progress=progress, isolation=isolation)
    digest = sha256(path)
    traces = []
    for case, asked in zip(result.cases, result.scenario.cases, strict=True):
        if case.result is None or case.error is not None:
            raise ScenarioError(f"{path}: case {case.name}", f"gave no trace ({case.error})", "correct the scenario")
        written = {name: value for name, value in asked.values.items() if isinstance(value, str)}
        fields = {name: float(value) for name, value in asked.values.items() if not isinstance(value, str)}
        trace = replace(result.recorded(case), name=case.name)
        traces.append(StudyTrace(trace, fields, path, digest, "simulated", written=written))
    return traces


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", ..." if len(names) > 6 else "")
