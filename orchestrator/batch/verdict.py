"""How a file of the regression suite went."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.results import CaseDocument, FileDocument

FileJudge = Callable[[Path, Path], FileDocument]
"""Runs a file into a folder and says whether all came out as the file states; another process can import it."""


@dataclass(frozen=True)
class Verdict:
    """How one file went: what came out, with `passed` and `cases`, or the `error` that ended it.

    Attributes:
        seconds: wall time of all that was done for it [s].
        fault: where the error is a fault of this project, its traceback.
        last: whether the process that it is from is to take no other file.
    """

    file: Path
    seconds: float
    document: FileDocument | None
    error: str = ""
    fault: str = ""
    last: bool = True

    @property
    def passed(self) -> bool:
        return self.document is not None and bool(self.document["passed"])

    @property
    def cases(self) -> Sequence[CaseDocument]:
        """Its cases; where there are none, for an error ended it before, one that has the error."""
        if self.document is not None:
            return self.document["cases"]
        return [{"name": "run", "passed": False, "error": self.error, "checks": [], "seconds": self.seconds}]

    @property
    def first_error(self) -> str:
        """The error that ended it, or the first of its cases that failed by one; "" where there was none."""
        return self.error or next((case["error"] for case in self.cases if case["error"] and not case["passed"]), "")

    @property
    def why(self) -> str:
        """Why it has not passed, "" where it has: the error, or the first case that failed."""
        failed = next((case for case in self.cases if not case["passed"]), None)
        if self.error or failed is None:
            return self.error
        return f"{failed['name']}: {reasons(failed)[0]}"


def reasons(case: CaseDocument) -> list[str]:
    """Why a case has not passed: its error, or each check that did not hold with what was found."""
    if case["error"]:
        return [case["error"]]
    failed = [check for check in case["checks"] if not check["held"] and check.get("needed", True)]
    missed = [f"{check['text']}, found {check['found']}" for check in failed]
    return missed or ["did not run to its end"]
