"""The folder of a sweep: rows that are there stay, whoever is killed when; a manifest says who ran what.

    manifest.jsonl           what the study is, then a line for each stretch of runs that is done
    pending/A-B.parquet      rows of parts that are not complete
    runs/part-N.parquet      complete parts, the data set

A file is whole or not there, so that what is done is what files hold: a command that goes on reads it from them.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, TypedDict, cast

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray
from pyarrow import compute, parquet

from fmus.errors import InputError
from fmus.files import RawMap, atomic_write
from orchestrator.batch.sweep.runs.rows import FAILED
from orchestrator.batch.sweep.runs.setup import ChunkResult, Numbers
from orchestrator.results import check_target, permission, versions

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl

MANIFEST, RUNS, PENDING = "manifest.jsonl", "runs", "pending"
WRITING: dict[str, Any] = {"compression": "zstd", "write_page_checksum": True, "write_statistics": True}
LARGEST_PART = 1000  # rows
PART_BYTES = 32 << 20  # about which the samples of a part take at most
_FORMAT = 1
_BEHIND = 1 << 40  # where a file has no bytes


def part_rows(samples: int) -> int:
    """Rows of a part, where each has so many samples."""
    return int(np.clip(PART_BYTES // (8 * max(samples, 1)), 1, LARGEST_PART))


class Same(Protocol):
    """Whether rows are those of a study."""

    @property
    def columns(self) -> Sequence[str]:
        """That it looks at."""

    def check(self, file: Path, rows: pa.Table) -> None:
        """See that rows are what the study would give.

        Raises:
            InputError: they are not.
        """


@dataclass
class Folder:
    """A folder that this process alone writes to.

    Attributes:
        size: rows of a part.
        done: (N,) which runs have a row.
        failed: how many of those failed.
    """

    path: Path
    size: int
    done: NDArray[np.bool_]
    failed: int
    _manifest: int

    @property
    def parts(self) -> int:
        """How many parts there will be."""
        return -(-len(self.done) // self.size)

    @property
    def left(self) -> int:
        """How many runs have no row yet."""
        return len(self.done) - int(self.done.sum())

    def runs(self, part: int) -> range:
        """Numbers of the runs of a part."""
        return range(part * self.size, min((part + 1) * self.size, len(self.done)))

    def missing(self) -> Iterator[Numbers]:
        """The runs of each part that have no row yet, where some have none."""
        for part in range(self.parts):
            own = self.runs(part)
            left = np.flatnonzero(~self.done[own.start : own.stop]) + own.start
            if len(left):
                yield left

    def keep(self, runs: Numbers, rows: pa.Table, done: ChunkResult) -> None:
        """Have the rows of some runs of one part on the disk, and know that.

        Raises:
            InputError: the disk takes no more.
        """
        part = int(runs[0]) // self.size
        whole = len(runs) == len(self.runs(part))
        _write(self._file(part) if whole else self._pending(runs), rows)
        self.done[runs] = True
        self.failed += done.failed
        line: dict[str, Any] = {"runs": _stretches(runs), "failed": done.failed, "seconds": round(done.seconds, 6)}
        self.say(line | ({"by": done.by} if done.by else {}))
        if not whole and self.done[self.runs(part).start : self.runs(part).stop].all():
            self._complete(part)

    def say(self, line: Mapping[str, Any]) -> None:
        """Add a line to the manifest."""
        data = json.dumps(line, allow_nan=False).encode() + b"\n"
        try:
            while data:
                data = data[os.write(self._manifest, data) :]
        except OSError as error:
            raise InputError(self.path / MANIFEST, f"cannot be written ({error.strerror})", "make space") from error

    def retry(self) -> int:
        """Take away the rows of runs that failed, so that they are run again; how many there were."""
        before = int(self.done.sum())
        for file in [*self._files(RUNS), *self._files(PENDING)]:
            rows = parquet.read_table(file)
            good = rows.filter(compute.not_equal(rows["state"], FAILED))
            if len(good) == len(rows):
                continue
            self.done[rows["run"].to_numpy()] = False
            if len(good):
                _write(self._pending(good["run"].to_numpy()), good)
                self.done[good["run"].to_numpy()] = True
            file.unlink()
        self.failed = 0
        return before - int(self.done.sum())

    def _files(self, name: str) -> list[Path]:
        return sorted((self.path / name).glob("*.parquet"))

    def _file(self, part: int) -> Path:
        return self.path / RUNS / f"part-{part:06d}.parquet"

    def _pending(self, runs: Numbers) -> Path:
        return self.path / PENDING / f"{int(runs[0]):010d}-{int(runs[-1]):010d}-{len(runs)}.parquet"

    def _complete(self, part: int) -> None:
        """Make a part of what is pending of it."""
        own = self.runs(part)
        files = [file for file in self._files(PENDING) if int(file.name[:10]) in own]
        rows = pa.concat_tables(map(parquet.read_table, files)).sort_by("run")
        _write(self._file(part), rows.filter(_first_of_each(rows["run"].to_numpy())))
        for file in files:
            file.unlink()

    def look(self, same: Same) -> None:
        """Find out what is there; parts that have to grow, and whatever a killed command has left, are put right.

        Args:
            same: asked of the rows of each file, for the columns that it names.

        Raises:
            InputError: there are more runs than are asked for, or rows that the study would not give.
        """
        for file in [*self._files(RUNS), *self._files(PENDING)]:
            rows = parquet.read_table(file, columns=["run", *same.columns])
            if rows["run"][-1].as_py() >= len(self.done):
                problem = f"holds more than the {len(self.done):,} runs that are asked for"
                raise InputError(self.path, problem, "ask for as many points, or give another --out")
            same.check(file, rows)
        for file in self._files(RUNS):
            part, runs = int(file.stem.removeprefix("part-")), _runs(file)
            if len(runs) == len(self.runs(part)):
                self._found(file, runs)
            else:
                file.replace(self._pending(runs))
        for file in self._files(PENDING):
            runs = _runs(file)
            if self.done[runs].all():  # its part was completed, and the command killed before it went
                file.unlink()
            else:
                self._found(file, runs)
        for part in range(self.parts):
            own = self.runs(part)
            if not self._file(part).exists() and self.done[own.start : own.stop].all():
                self._complete(part)

    def _found(self, file: Path, runs: Numbers) -> None:
        self.done[runs] = True
        states = parquet.read_table(file, columns=["state"])["state"]
        self.failed += int(compute.sum(compute.equal(states, FAILED)).as_py() or 0)


@contextmanager
def opened(
    path: Path, runs: int, size: int, identity: Mapping[str, Any], inputs: Sequence[Path], same: Same
) -> Iterator[Folder]:
    """The folder of a study with so many runs, as it was left or new.

    Args:
        size: rows of a part, where it is new.
        same: what is asked of rows that are there.

    Raises:
        InputError: it is another study's, holds something else, has more runs than that, cannot be written, or another
            command writes to it.
    """
    manifest = path / MANIFEST
    if permission().force and path.exists():
        check_target(path, inputs)
        shutil.rmtree(path)
    elif manifest.exists():
        _check_same(path, identity, runs)
    else:
        check_target(path, inputs)
        if path.exists():
            shutil.rmtree(path)  # an earlier result of another command
    (path / RUNS).mkdir(parents=True, exist_ok=True)
    (path / PENDING).mkdir(exist_ok=True)
    descriptor = os.open(manifest, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o644)
    try:
        _lock(descriptor, path)
        begun = _whole_lines(descriptor)
        own = int(header(path)["part"]) if begun else size
        folder = Folder(path, own, np.zeros(runs, dtype=bool), 0, descriptor)
        if not begun:
            folder.say({"servotwin sweep": _FORMAT, "identity": identity, "part": size, "versions": versions()})
        folder.look(same)
        if len(unsaid := np.flatnonzero(folder.done & ~_said(manifest, runs))):
            folder.say({"runs": _stretches(unsaid)})  # kept by a command that was killed before it could say so
        folder.say({"begun": runs, "there": int(folder.done.sum()), "versions": versions()})
        yield folder
    finally:
        os.close(descriptor)


SweepHeader = TypedDict("SweepHeader", {"servotwin sweep": int, "identity": RawMap, "part": int})
"""The first line of a manifest: its format, what its rows depend on, and runs a part."""


def header(path: Path) -> SweepHeader:
    """What the manifest of a sweep says the study is.

    Raises:
        InputError: there is none.
    """
    manifest = path / MANIFEST
    try:
        with manifest.open(encoding="utf-8") as lines:
            found = json.loads(lines.readline())
        if found["servotwin sweep"] != _FORMAT or not isinstance(found["identity"], dict):
            raise ValueError("of another format")
    except OSError:
        raise InputError(path, f"has no {MANIFEST}", "give the folder of a sweep") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(manifest, f"is no manifest of a sweep ({error})", "give another --out, or --force") from None
    return cast(SweepHeader, found)


def _check_same(path: Path, identity: Mapping[str, Any], runs: int) -> None:
    with (path / MANIFEST).open("rb") as file:
        if not file.readline().endswith(b"\n"):  # its command was killed before it had said what it is
            return
    known = header(path)["identity"]
    asked = json.loads(json.dumps(identity))
    if differ := [key for key in {**known, **asked} if known.get(key) != asked.get(key)]:
        told = "; ".join(_difference(key, known.get(key), asked.get(key)) for key in differ[:3])
        raise InputError(path, f"holds another study: {told}", "give another --out, or --force to begin anew")


def _difference(key: str, known: Any, asked: Any) -> str:
    """What differs, as deep as it lies."""
    if isinstance(known, dict) and isinstance(asked, dict):
        inner = next(name for name in {**known, **asked} if known.get(name) != asked.get(name))
        return _difference(f"{key}.{inner}", known.get(inner), asked.get(inner))
    shown = [json.dumps(one)[:60] if one is not None else "nothing" for one in (known, asked)]
    return f"{key} was {shown[0]} and is {shown[1]}"


def _lock(descriptor: int, path: Path) -> None:
    try:
        if sys.platform == "win32":
            os.lseek(descriptor, _BEHIND, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        else:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        raise InputError(path, "is written to by another command", "wait for that, or give another --out") from None


def _whole_lines(descriptor: int) -> bool:
    """Cut off a line that a killed command has not finished; whether there are others."""
    size = os.fstat(descriptor).st_size
    os.lseek(descriptor, max(0, size - (1 << 20)), os.SEEK_SET)
    data = os.read(descriptor, min(size, 1 << 20))
    end = data.rfind(b"\n") + 1
    if end < len(data):
        os.ftruncate(descriptor, size - len(data) + end)
    return size - len(data) + end > 0


def _said(manifest: Path, runs: int) -> NDArray[np.bool_]:
    """(runs,) which runs a manifest says are done."""
    said = np.zeros(runs, dtype=bool)
    with manifest.open(encoding="utf-8") as lines:
        for line in lines:
            for first, last in json.loads(line).get("runs", []):
                said[first : last + 1] = True
    return said


def _write(file: Path, rows: pa.Table) -> None:
    atomic_write(file, lambda opened: parquet.write_table(rows, opened, row_group_size=LARGEST_PART, **WRITING))


def _runs(file: Path) -> Numbers:
    found: Numbers = parquet.read_table(file, columns=["run"])["run"].to_numpy()
    return found


def _first_of_each(runs: Numbers) -> NDArray[np.bool_]:
    """Which rows are the first of their run: a killed command may have left some twice, in equal rows."""
    return np.concatenate([[True], runs[1:] != runs[:-1]])


def _stretches(runs: Numbers) -> list[list[int]]:
    """Runs as stretches [first, last]."""
    ends = np.flatnonzero(np.diff(runs) > 1)
    firsts, lasts = [0, *(ends + 1).tolist()], [*ends.tolist(), len(runs) - 1]
    return [[int(runs[first]), int(runs[last])] for first, last in zip(firsts, lasts, strict=True)]
