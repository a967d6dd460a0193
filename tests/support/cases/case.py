"""A case: commands one after the other, and what must be seen of each."""

from __future__ import annotations

import re
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

_LONGEST = 600  # for a command [s]
_NEVER = r"Traceback \(most recent call last\)"


@dataclass(frozen=True)
class Step:
    """A command of the shell, run in the case's folder, and what must come of it.

    Attributes:
        code: the exit codes that are right; None where any but 1 and 4 is.
        shows, hides: what its output must and must not hold (regular expressions).
    """

    command: str
    code: int | Sequence[int] | None = 0
    shows: Sequence[str] = ()
    hides: Sequence[str] = ()


@dataclass(frozen=True)
class Case:
    """What is done in a folder, once it is prepared."""

    folder: str
    steps: Sequence[Step]
    prepare: Callable[[Path], None] | None = None


@dataclass(frozen=True)
class Verdict:
    """How a case came out: `problem` is empty where it did as it should, `skipped` says why it was not tried."""

    problem: str = ""
    skipped: str = ""

    @property
    def wrong(self) -> bool:
        return bool(self.problem)

    @property
    def line(self) -> str:
        return f"WRONG: {self.problem}" if self.wrong else self.skipped or "as it should"


def verdict(folder: Path, case: Case) -> Verdict:
    """What comes of the case in this folder: the first thing that is wrong."""
    if not folder.is_dir():
        return Verdict("not there")
    try:
        if case.prepare is not None:
            case.prepare(folder)
    except pytest.skip.Exception as missing:
        return Verdict(skipped=f"not tried: {missing}")
    for step in case.steps:
        problem = _problem(folder, step)
        if problem:
            return Verdict(f"{step.command}: {problem}")
    return Verdict()


def _problem(folder: Path, step: Step) -> str:
    try:
        done = subprocess.run(
            ["bash", "-c", step.command],
            cwd=folder,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=_LONGEST,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no end within {_LONGEST} s"
    output = done.stdout.decode(errors="replace")
    if not _right(done.returncode, step.code):
        return f"exit code {done.returncode}: {output.strip()[-300:]!r}"
    for pattern in step.shows:
        if not re.search(pattern, output):
            return f"does not show {pattern!r}: {output.strip()[-300:]!r}"
    for pattern in (*step.hides, _NEVER):
        if re.search(pattern, output):
            return f"shows {pattern!r}: {output.strip()[-300:]!r}"
    return ""


def _right(code: int, wanted: int | Sequence[int] | None) -> bool:
    if wanted is None:
        return code not in (1, 4)
    return code == wanted if isinstance(wanted, int) else code in wanted
