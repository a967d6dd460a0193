"""What there is to tell of a suite on one page: how many hold, what does not and why, and what took the time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from orchestrator.batch.verdict import Verdict, reasons
from orchestrator.display.plain import plain
from orchestrator.results import CaseDocument

HEADERS = ("scenario", "verdict", "time [s]", "why")
SHORT = 30  # files of a suite that are all listed
MOST = 20  # failures that are told one by one
SLOWEST = 5
_LONGEST = 300  # text of a reason


@dataclass(frozen=True)
class SuiteSummary:
    """The verdicts of a suite, which took so long with so many processes.

    Attributes:
        seconds: wall time from its begin to its end [s].
    """

    verdicts: Sequence[Verdict]
    seconds: float
    processes: int

    @property
    def sentence(self) -> str:
        """How many passed, and how long it took."""
        cases = [case for verdict in self.verdicts for case in verdict.cases]
        spent = sum(verdict.seconds for verdict in self.verdicts)
        passed = sum(verdict.passed for verdict in self.verdicts)
        held = sum(case["passed"] for case in cases)
        idle = sum(case["passed"] and not case["checks"] for case in cases)
        asked = f" ({idle} of them without being asked anything)" if idle else ""
        files, all_cases = _counted(len(self.verdicts), "file"), _counted(len(cases), "case")
        return (
            f"{passed} of {files} and {held} of {all_cases} passed{asked} in {self.seconds:.1f} s; "
            f"one after the other they took {spent:.1f} s (-j {self.processes})"
        )

    def rows(self, all_files: bool = False) -> list[tuple[str, str, str, str]]:
        """Rows under `HEADERS`: of every file where they are few, else of those that failed and of the slowest."""
        slowest = sorted(self.verdicts, key=lambda verdict: -verdict.seconds)[:SLOWEST]
        short = all_files or len(self.verdicts) <= SHORT
        failed = [verdict for verdict in self.verdicts if not verdict.passed]
        told = [verdict for verdict in self.verdicts if short or verdict in failed[:MOST] or verdict in slowest]
        rows = [_row(verdict) for verdict in told]
        if not short and (left := len(failed) - len(failed[:MOST])):
            rows.append((f"and {left} more", "FAILED", "", "-v lists all"))
        return rows

    def markdown(self) -> str:
        """The page for those who read it in a browser, such as a job's summary on GitHub or GitLab."""
        lines = ["## Scenarios", "", self.sentence + ".", ""]
        if failed := list(_failures(self.verdicts)):
            lines += ["| scenario | case | why |", "|---|---|---|"]
            lines += [
                f"| {verdict.file} | {_cell(case['name'])} | {_cell(_why(case))} |" for verdict, case in failed[:MOST]
            ]
            lines += [f"| and {len(failed) - MOST} more | | |"] if len(failed) > MOST else []
            lines.append("")
        lines += ["| slowest | time [s] |", "|---|---|"]
        slowest = sorted(self.verdicts, key=lambda verdict: -verdict.seconds)[:SLOWEST]
        lines += [f"| {verdict.file} | {verdict.seconds:.1f} |" for verdict in slowest]
        return "\n".join(lines) + "\n"


def github_lines(verdicts: Sequence[Verdict], below: Path) -> list[str]:
    """What did not pass, as commands by which GitHub shows it at the files of a pull request.

    Args:
        below: folder that the names of files there are relative to.
    """
    return [
        f"::error file={_property(_relative(verdict.file, below))},title={_property(case['name'])}::{_data(_why(case))}"
        for verdict, case in _failures(verdicts)
    ]


def _failures(verdicts: Sequence[Verdict]) -> Iterator[tuple[Verdict, CaseDocument]]:
    for verdict in verdicts:
        yield from ((verdict, case) for case in verdict.cases if not case["passed"])


def _why(case: CaseDocument) -> str:
    return plain("; ".join(reasons(case)))[:_LONGEST]


def _row(verdict: Verdict) -> tuple[str, str, str, str]:
    return str(verdict.file), "passed" if verdict.passed else "FAILED", f"{verdict.seconds:.1f}", verdict.why


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def _cell(text: str) -> str:
    """Text that neither ends a cell of a table nor is read as HTML."""
    return plain(text).replace("&", "&amp;").replace("<", "&lt;").replace("|", "\\|").replace("\n", " ")


def _relative(file: Path, below: Path) -> str:
    place = file.resolve()
    return str(place.relative_to(below.resolve()) if place.is_relative_to(below.resolve()) else file)


def _data(text: str) -> str:
    """Text as a command of GitHub takes it: what would end it or begin another is escaped."""
    return text.replace("%", "%25").replace("\r", "%0D").replace("\n", "%0A")


def _property(text: str) -> str:
    return _data(plain(text)).replace(":", "%3A").replace(",", "%2C")
