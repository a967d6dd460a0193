"""References that `servotwin accept` keeps: where that of a case lies, what it says of itself, and its signals.

A scenario that asks for `reference: accepted` is compared with `references/<scenario>/<case>.parquet` beside it, or,
`per platform`, with `<case>.<platform>.parquet`. Whoever reads or writes such a file comes through here.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NotRequired

import numpy as np
from pydantic import TypeAdapter
from typing_extensions import TypedDict

from fmus.errors import InputError, TraceError
from fmus.packaging.native import compiler
from orchestrator import formats
from orchestrator.formats import parquet
from orchestrator.trace import Trace

FOLDER = "references"
LARGEST = 1 << 20  # bytes of a file: references live beside their scenarios, under version control
PROVENANCE = "servotwin.reference"  # name in the file's metadata

Accepted = Literal["accepted", "accepted per platform"]
"""What a scenario calls a reference that `servotwin accept` keeps; one of this kind of machine alone."""


class Provenance(TypedDict):
    """Where a reference is from.

    Attributes:
        by, at: who accepted it, and when (ISO 8601, UTC).
        sha256: file that went in -> its hash.
        samples: of the run that it was taken from.
        step: between these [s]; between them it knows nothing of the run.
        tolerances: signal -> how far the lines between its samples may be from the run [unit of the signal].
        replaces: hash of the reference that was there before, "" where there was none.
    """

    scenario: str
    case: str
    by: str
    at: str
    platform: str
    versions: dict[str, str]
    sha256: dict[str, str]
    samples: int
    step: NotRequired[float]
    tolerances: dict[str, float]
    replaces: str


@dataclass(frozen=True)
class CaseReferences:
    """The accepted references of a case.

    Attributes:
        scenario: the file.
        stem: name of the case in names of files.
        read: whether they are read; what is to be replaced need not be fit for it.
        asked: takes the files that expectations ask for.
    """

    scenario: Path
    case: str
    stem: str
    read: bool = True
    asked: set[Path] = field(default_factory=set)

    def file(self, kind: Accepted) -> Path:
        """Where that of this kind is, or would be."""
        platform = f".{compiler.host_name()}" if kind == "accepted per platform" else ""
        file = folder_of(self.scenario) / f"{self.stem}{platform}.parquet"
        self.asked.add(file)
        return file

    def trace(self, kind: Accepted, signal: str) -> tuple[Trace | None, float]:
        """The reference of a signal, None where there is no file, or it is not to be read; and the step of the run that
        it is from [s], 0 where that is not known.

        Raises:
            TraceError: it is no reference of this case and signal, or not fit to be one.
        """
        file = self.file(kind)
        if not self.read or not file.exists():
            return None, 0.0
        trace, origin = read(file)
        again = f"look at it and take another with `servotwin accept {self.scenario}`"
        if origin["case"] != self.case:
            raise TraceError(file, f"is the reference of case {origin['case']}, not of {self.case}", again)
        if signal not in trace.names:
            raise TraceError(file, f"is no reference of {signal}, but of {', '.join(trace.names)}", again)
        check_owner(file, origin, self.scenario)
        return trace.select([signal]), origin.get("step", 0.0)


def folder_of(scenario: Path) -> Path:
    """The folder with the accepted references of a scenario file."""
    return scenario.parent / FOLDER / scenario.stem


def read(file: Path) -> tuple[Trace, Provenance]:
    """A reference that was accepted, all its samples finite, and where it is from.

    Raises:
        TraceError: it is none, cannot be read, or holds a sample that is not finite.
    """
    origin = provenance(file)
    if origin is None:
        raise TraceError(file, "was not written by `servotwin accept`", "move it away, or name it as `reference.file`")
    trace = formats.read(file).trace
    for name in trace.names:
        bad = np.flatnonzero(~np.isfinite(trace[name]))
        if len(bad):
            raise TraceError(
                file, f"{name} is not finite at {trace.time[bad[0]]:g} s", "restore it, or accept the run again"
            )
    return trace, origin


def provenance(file: Path) -> Provenance | None:
    """Where a Parquet file says that it is from, None where `servotwin accept` has not written it.

    Raises:
        TraceError: it cannot be read, or what it says is not to be understood.
    """
    text = parquet.facts(file).get(PROVENANCE)
    if text is None:
        return None
    try:
        return TypeAdapter(Provenance).validate_python(json.loads(text))
    except (ValueError, RecursionError):
        raise TraceError(file, "does not say where it is from", "restore it, or move it away") from None


def check_owner(file: Path, origin: Provenance, scenario: Path) -> None:
    """See that no other scenario has this file for its reference, too.

    Raises:
        TraceError: one has.
    """
    owner = scenario.with_name(origin["scenario"])
    if owner.name != scenario.name and owner.exists():
        raise TraceError(file, f"is a reference of {owner}, too", f"rename {scenario} or {owner.name}")


def content(trace: Trace, origin: Provenance) -> bytes:
    """A reference as its file has it.

    Raises:
        InputError: it is too large for one.
    """
    file = io.BytesIO()
    parquet.write_small(trace, file, {PROVENANCE: json.dumps(origin, sort_keys=True)})
    made = file.getvalue()
    if len(made) > LARGEST:
        raise InputError(
            f"the reference of case {origin['case']}",
            f"would take {len(made) / 1e6:.1f} MB, more than {LARGEST / 1e6:.1f} MB",
            "compare fewer signals, or a shorter run, or widen `within`",
        )
    return made


def unused(scenario: Path, wanted: Iterable[Path]) -> list[Path]:
    """Files in the folder of a scenario's accepted references that none of its cases asks for, on any platform."""
    known = {name for file in wanted for name in _on_all_platforms(file.name)}
    folder = folder_of(scenario)
    return [file for file in sorted(folder.iterdir()) if file.name not in known] if folder.is_dir() else []


def abandoned(folder: Path) -> list[Path]:
    """Folders of accepted references, in a folder of scenarios, whose scenario is no longer there."""
    kept = folder / FOLDER
    scenarios = {file.stem for file in folder.iterdir() if file.suffix in (".yaml", ".yml")}
    inside = [one for one in sorted(kept.iterdir()) if one.is_dir()] if kept.is_dir() else []
    return [one for one in inside if one.name not in scenarios and any(map(_is_ours, one.glob("*.parquet")))]


def _is_ours(file: Path) -> bool:
    try:
        return provenance(file) is not None
    except TraceError:
        return False


def _on_all_platforms(name: str) -> list[str]:
    """The name of a reference's file, or, of one of a platform, those on all platforms."""
    stem = name.removesuffix(f".{compiler.host_name()}.parquet")
    return [name] if stem == name else [f"{stem}.{platform}.parquet" for platform in compiler.PLATFORMS]
