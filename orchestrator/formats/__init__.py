"""Recordings as files: one module a format behind one table from suffix to module.

Files come from outside: whatever is wrong with one ends in a `TraceError` that names file, place and fix.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import BinaryIO, Protocol, TypeGuard

from fmus.errors import TraceError
from fmus.files import atomic_write
from orchestrator.can.log_suffixes import PACKED, PACKED_PROBLEM, SUFFIXES, is_log
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording, coarse, largest
from orchestrator.marks import of_stamps
from orchestrator.plugins import plugins
from orchestrator.progress import Progress, silent
from orchestrator.trace import Trace, check_file

__all__ = ["FORMATS", "Layout", "Recording", "read", "write"]


class Format(Protocol):
    """What a format's module offers."""

    def read(self, path: Path, layout: Layout) -> Recording: ...

    def write(self, trace: Trace, file: BinaryIO) -> None: ...


FORMATS = {".csv": "csv", ".mat": "arrays.mat", ".parquet": "parquet", ".tsv": "text", ".txt": "text"}
"""Those that come along; other packages add theirs as entry points `SUFFIX = module` of `servotwin.formats`."""

TEXTS = (".csv", ".parquet")
"""Those that hold signals of text, too."""

READ = {
    ".arrows": "arrows",
    ".dat": "text",
    ".h5": "arrays.hdf5",
    ".hdf5": "arrays.hdf5",
    ".lvm": "text",
    ".mdf": "arrays.mdf",
    ".mf4": "arrays.mdf",
    ".npy": "arrays.npz",
    ".npz": "arrays.npz",
    ".prn": "text",
    ".tdms": "arrays.tdms",
    ".xlsx": "texts.xlsx",
}
"""Those that are read alone."""

MARKS = {
    b"MDF     ": ".mdf",
    b"TDSm": ".tdms",
    b"\x89HDF": ".h5",
    b"PAR1": ".parquet",
    b"MATLAB": ".mat",
    b"\x93NUMPY": ".npy",
    b"PK\x03\x04": ".xlsx",
}
"""First bytes -> the suffix of such files."""


def read(path: str | Path, layout: Layout | None = None, progress: Progress = silent) -> Recording:
    """The recording in a file; its trace is named after the file where the file does not name it.

    Numbers are doubles; whole ones that these do not tell apart are noted.

    Args:
        progress: told the share of a CAN log that is read.

    Raises:
        TraceError: an unknown suffix, no such file, nothing in it, or it does not hold what `layout` says.
        DatabaseError: it is a CAN log, and the layout's database cannot be read or lacks a signal.
    """
    file = Path(path)
    found = _read(file, layout, progress)
    marks = found.marks if is_log(file) else tuple(of_stamps(found.trace.time))
    return replace(found, notes=(*found.notes, *coarse(largest(found.trace))), marks=marks)


def _read(file: Path, layout: Layout | None, progress: Progress) -> Recording:
    if is_log(file):
        check_file(file)
        from orchestrator.formats import can_log  # noqa: PLC0415 (it brings python-can and cantools along)

        return can_log.read(file, layout or Layout(), progress)
    suffix = _by_content(file)
    form = _format(file, suffix, FORMATS | READ)
    check_file(file)
    if layout is not None and layout.database is not None:
        raise TraceError(file, "holds no CAN frames", "leave out the database (--dbc; `database` in a layout)")
    recording = form.read(file, layout or Layout())
    if suffix == file.suffix.lower():
        return recording
    return replace(recording, notes=(f"is read as {suffix}, by its first bytes", *recording.notes))


def write(trace: Trace, path: str | Path, *, for_good: bool = True) -> None:
    """The trace in the format that the suffix names; the file is there as a whole or not at all.

    Args:
        for_good: whether it is on the disk, too, before it is there.

    Raises:
        TraceError: an unknown suffix, or names that the format cannot hold.
    """
    suffix = Path(path).suffix.lower()
    form = _format(Path(path), suffix, FORMATS)
    if trace.texts and suffix not in TEXTS:
        problem = f"is text, which a {suffix} file cannot hold"
        raise TraceError(next(iter(trace.texts)), problem, f"leave it out, or write {', '.join(TEXTS)}")
    if "time" in trace.names:
        raise TraceError(trace.name, "a signal is named 'time', as the stamps are", "rename it")
    atomic_write(path, partial(form.write, trace), for_good=for_good)


def _by_content(path: Path) -> str:
    """The suffix that tells the format; where it says text, or is not known, the first bytes have the last word."""
    suffix = path.suffix.lower()
    known = FORMATS | READ
    if not path.is_file() or known.get(suffix, "text") not in ("csv", "text"):
        return suffix
    with path.open("rb") as file:
        start = file.read(8)
    return next((found for mark, found in MARKS.items() if start.startswith(mark)), suffix)


def _format(path: Path, suffix: str, modules: Mapping[str, str]) -> Format:
    if suffix in modules:
        form: Format = import_module(f"{__name__}.{modules[suffix]}")
        return form
    added = {f".{name}": form for name, form in plugins("servotwin.formats", _is_format).items()}
    if suffix == PACKED:
        raise TraceError(path, PACKED_PROBLEM, f"gunzip {path.name}")
    if suffix not in added:
        known = ", ".join(dict.fromkeys((*modules, *SUFFIXES, *added)))
        what = "is read, not written" if suffix in READ else "is not known"
        raise TraceError(path, f"format '{path.suffix}' {what}", f"use {known} (a table of text is a .csv or .txt)")
    return added[suffix]


def _is_format(loaded: object) -> TypeGuard[Format]:
    return callable(getattr(loaded, "read", None)) and callable(getattr(loaded, "write", None))
