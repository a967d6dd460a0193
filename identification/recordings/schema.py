"""What study files have in common: a title, and where their traces come from: files, or the cases of a scenario."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, model_validator

from fmus import units
from identification.recordings.campaign import DecimalPoint, FileField, FileName, TraceSource
from identification.recordings.marks import Exclusion
from identification.recordings.parts import RecordingPart
from orchestrator.can.database.sources import paths
from orchestrator.formats import Layout
from orchestrator.formats.schema import LayoutBlock
from orchestrator.marks import Seen
from orchestrator.yaml_file import Block, Time


@dataclass(frozen=True)
class UsedSignals:
    """The signals of its traces that a study uses.

    Attributes:
        commands: keep the value of a frame until the next.
        measured: run linearly from frame to frame; what is a command too is held.
    """

    commands: frozenset[str] = frozenset()
    measured: frozenset[str] = frozenset()


class FieldBlock(Block):
    """How digits in a file's name make a number, in SI by a factor or in a unit.

    Attributes:
        decimal: where the decimal point of the digits is.
        factor: what the number is multiplied by, to SI.
        unit: what it is in, in the place of a factor.
    """

    decimal: DecimalPoint = FileField.decimal
    factor: float = FileField.factor
    unit: str = FileField.unit

    @model_validator(mode="after")
    def _one_way(self) -> FieldBlock:
        if self.unit and "factor" in self.model_fields_set:
            raise ValueError("give `factor` or `unit`")
        if self.unit and units.parse(self.unit) is None:
            raise ValueError(f"'{self.unit}' is no unit that is known; give a `factor` to SI")
        return self


class FileNameBlock(Block):
    """What the files' names tell: named groups of a regular expression, as numbers.

    Attributes:
        pattern: the regular expression, with groups like `(?P<mass>[0-9]+)`.
    """

    pattern: str
    fields: dict[str, FieldBlock] = {}

    @model_validator(mode="after")
    def _groups(self) -> FileNameBlock:
        try:
            groups = set(re.compile(self.pattern).groupindex)
        except re.error as error:
            raise ValueError(f"`pattern` is no regular expression ({error})") from error
        if set(self.fields) - groups:
            raise ValueError(f"`pattern` has no group {sorted(set(self.fields) - groups)[0]}; write (?P<name>...)")
        return self


class StretchBlock(Block):
    """A stretch that is left out, of every trace or of one; with a `signal`, where it is beyond a limit.

    Attributes:
        trace: the one that it is of; all without.
        from_, to: in the time of the recording, both included; open ones reach to its ends [s].
        signal: of the traces, that has a limit.
        above, below: of the signal [its unit].
    """

    trace: str | None = None
    from_: Time | None = Field(None, alias="from")
    to: Time | None = None
    signal: str | None = None
    above: float | None = None
    below: float | None = None

    @model_validator(mode="after")
    def _something(self) -> StretchBlock:
        limits, times = {self.above, self.below} != {None}, {self.from_, self.to} != {None}
        if (self.signal is not None) != limits:
            raise ValueError("`signal` goes with `above` or `below`")
        if not (limits or times):
            raise ValueError("give `from`, `to`, or a `signal` with `above` or `below`")
        if self.exclusion().start > self.exclusion().stop:
            raise ValueError("`from` is after `to`")
        return self

    def exclusion(self) -> Exclusion:
        """As a plain value."""
        given = {"start": self.from_, "stop": self.to, "above": self.above, "below": self.below}
        return Exclusion(self.trace, self.signal, **{key: end for key, end in given.items() if end is not None})


Stretch = tuple[Time, Time] | StretchBlock


def _stretch(value: Any) -> Any:
    """[5, 7.2] as the keys that it is short for."""
    if not isinstance(value, list):
        return value
    if len(value) != 2:
        raise ValueError("a stretch has two ends: [from, to]")
    return {"from": value[0], "to": value[1]}


class ExcludedPartBlock(Block):
    """A part of a trace that is kept out of the fit, from one time to another of the recording [s]; one may be open.

    Attributes:
        trace: name of the trace.
        from_, to: in the time of the recording [s].
    """

    trace: str
    from_: Time | None = Field(None, alias="from")
    to: Time | None = None

    @model_validator(mode="after")
    def _some(self) -> ExcludedPartBlock:
        part = self.part()
        if {self.from_, self.to} == {None} or part.start >= part.stop:
            raise ValueError("give `from`, `to` or both, `from` before `to`")
        return self

    def part(self) -> RecordingPart:
        """As a plain value."""
        given = {"start": self.from_, "stop": self.to}
        return RecordingPart(self.trace, **{key: end for key, end in given.items() if end is not None})


class TracesBlock(Block):
    """Where traces come from: files (a pattern under the data folder), or the cases of a scenario that is run.

    Attributes:
        files: pattern of names, `*.csv`, under the data folder.
        scenario: a scenario whose cases are run for it.
        layout: how the files are laid out, where they do not tell.
        file_name: what names of files tell.
        values: component.variable -> field of the file's name, given to every window of that trace.
        hold_out: names of traces that are kept out of the fit and judged afterwards, or parts of traces whose rest is
            fitted: `{trace: rig, from: 10, to: 20}` [s].
        exclude: stretches that are left out: [from, to] of every trace [s], or by keys.
        keep: kinds of marks (gap, late, checksum, counter, range, nan, safe) whose stretches are not left out.
    """

    files: str | None = None
    scenario: Path | None = None
    layout: LayoutBlock = LayoutBlock()
    file_name: FileNameBlock | None = None
    values: dict[str, str] = {}
    hold_out: list[str | ExcludedPartBlock] = []
    exclude: list[Annotated[StretchBlock, BeforeValidator(_stretch, json_schema_input_type=Stretch)]] = []
    keep: list[Seen] = []

    @property
    def held_out(self) -> list[str]:
        """Names of the traces, and of the parts, that are kept out of the fit."""
        return [known if isinstance(known, str) else known.part().name for known in self.hold_out]

    def source(self, base: Path, signals: UsedSignals) -> TraceSource:
        """Where the traces come from; `base` is the folder of the study file, and `signals` is what it uses of them."""
        name, exclude = self.file_name, tuple(block.exclusion() for block in self.exclude)
        conditions = frozenset(exclusion.signal for exclusion in exclude if exclusion.signal is not None)
        return TraceSource(
            base,
            self.files,
            base / self.scenario if self.scenario else None,
            _layout(self.layout.layout(base), signals, conditions),
            FileName(name.pattern, {key: FileField(**dict(block)) for key, block in name.fields.items()})
            if name
            else None,
            self.values,
            tuple(self.held_out),
            tuple(block.part() for block in self.hold_out if isinstance(block, ExcludedPartBlock)),
            exclude,
            frozenset(self.keep),
            signals.commands | signals.measured,
            signals.measured - signals.commands,
        )

    @model_validator(mode="after")
    def _one_source(self) -> TracesBlock:
        if (self.files is None) == (self.scenario is None):
            raise ValueError("give either `files` or `scenario`")
        known = set(self.file_name.fields) if self.file_name else set()
        for name, field in self.values.items():
            if self.files is not None and field not in known:
                raise ValueError(f"{name}: `file_name` has no field '{field}'")
        return self


def _layout(layout: Layout, signals: UsedSignals, conditions: frozenset[str]) -> Layout:
    """The layout with what the study takes of a database, and how it runs between the frames."""
    if layout.database is None:
        return layout
    columns = layout.columns or {name: name for name in sorted(signals.commands | signals.measured | conditions)}
    linear = [str(columns[name]) for name in sorted(signals.measured - signals.commands) if name in columns]
    return replace(layout, columns=columns, interpolated=linear)


class StudyBlock(Block):
    """What the study files of all methods have.

    Attributes:
        title: what it is, in a line.
        description: more of it.
        method: how it is done; the other keys follow from it.
    """

    title: str
    description: str = ""
    method: str

    def layout(self, base: Path) -> Layout:
        """How the study reads its recordings; `base` is the folder of its file."""
        return Layout()

    def databases(self, base: Path) -> list[Path]:
        """The database files of its CAN logs."""
        return []


class RecordedStudyBlock(StudyBlock, ABC):
    """What the study files of methods that work on recordings have.

    Attributes:
        traces: where they come from.
    """

    traces: TracesBlock

    @property
    @abstractmethod
    def signals(self) -> UsedSignals:
        """What the method uses of the traces."""

    def source(self, base: Path) -> TraceSource:
        """Where its traces come from; `base` is the folder of its file."""
        return self.traces.source(base, self.signals)

    def layout(self, base: Path) -> Layout:
        """How the study reads its recordings; `base` is the folder of its file."""
        return self.source(base).layout

    def databases(self, base: Path) -> list[Path]:
        """The database files of its CAN logs."""
        files = self.traces.layout.database_file(base)
        return [] if files is None else paths(files)
