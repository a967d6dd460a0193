"""A procedure: commands of this project, one after the other and some beside others, as one case of the suite.

What takes several processes (a rig on a bus, a recorder, a controller) becomes a scenario that one command runs.
"""

from __future__ import annotations

import os
import shlex
import shutil
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from pydantic import Field, field_validator

from fmus.errors import ScenarioError
from fmus.files import sha256
from orchestrator.progress import READY
from orchestrator.results import CaseDocument, FileDocument, check_target, versions, write_json
from orchestrator.yaml_file import Block, Time, load, naming

LINES_KEPT = 60
_NAP = 0.02  # between two looks at what commands do [s]
_KILLING = 3.0  # to end when nothing of it matters any more [s]


class ProcedureStepBlock(Block):
    """Commands without `servotwin`; `{here}` is the folder of the file and `{out}` that of the results.

    Attributes:
        beside: started first, each when the one before is ready (on a bus) or has said a line, and ended (SIGTERM) in
            the opposite order when all of `run` are done.
        run: run side by side.
        may_end: whether commands beside may end well before they are told to; else that is a failure.
        ready_within: how long a command beside may take to be ready [s].
        run_within: how long all of `run` may take to end by themselves [s].
        end_within: how long a command may take to end when it is told to [s].
    """

    beside: list[str] = []
    run: list[str] = Field(min_length=1)
    may_end: bool = False
    ready_within: Time = Field(120.0, gt=0)
    run_within: Time = Field(1800.0, gt=0)
    end_within: Time = Field(30.0, gt=0)

    @field_validator("beside", "run")
    @classmethod
    def _readable(cls, value: list[str]) -> list[str]:
        for command in value:
            if not shlex.split(command):
                raise ValueError("an empty command")
        return value


class ProcedureBlock(Block):
    """A procedure file.

    Attributes:
        title: what it is, in a line.
        description: more of it.
        procedure: its steps, one after the other until one fails.
    """

    title: str
    description: str = ""
    procedure: list[ProcedureStepBlock] = Field(min_length=1)


@dataclass(frozen=True)
class EndedCommand:
    """A command that has ended.

    Attributes:
        early: whether it has, although it was to go on until told to end.
    """

    command: str
    code: int
    seconds: float
    output: str
    early: bool = False

    @property
    def problem(self) -> str | None:
        """Why it has failed, None where it has not."""
        if not self.code and not self.early:
            return None
        early = "ended before it was told to, with " if self.early else ""
        said = [line for line in self.output.splitlines() if any(map(str.isalnum, line))] or ["nothing said"]
        errors = [line for line in said if line.startswith("servotwin: ")]
        return f"{early}exit code {self.code}: {(errors or said)[-1]}"

    def document(self) -> CaseDocument:
        """As a case of the suite."""
        return {
            "name": self.command,
            "passed": self.problem is None,
            "error": self.problem,
            "checks": [],
            "seconds": round(self.seconds, 3),
            "output": self.output,
        }


class ProcedureDocument(FileDocument):
    """What came of a procedure, a case a command."""

    procedure: dict[str, str]
    versions: dict[str, str]


def run_procedure(path: Path, out: Path) -> ProcedureDocument:
    """Run the steps until a command fails; what each gave.

    Raises:
        ScenarioError: the file does not fit, or a command is never ready or never ends.
    """
    block = load(path, ProcedureBlock)
    check_target(out, replaces=False)
    out.mkdir(parents=True, exist_ok=True)
    names = {"here": str(path.parent), "out": str(out)}
    cases: list[CaseDocument] = []
    with naming(path):
        for step in block.procedure:
            cases += [done.document() for done in _step(step, names)]
            if not all(case["passed"] for case in cases):
                break
    document: ProcedureDocument = {
        "title": block.title,
        "procedure": {"file": path.name, "sha256": sha256(path)},
        "passed": all(case["passed"] for case in cases),
        "out": str(out),
        "cases": cases,
        "versions": versions(),
    }
    write_json(out / "manifest.json", document)
    return document


def _step(block: ProcedureStepBlock, names: Mapping[str, str]) -> list[EndedCommand]:
    with ExitStack() as stack:
        beside: list[_RunningCommand] = []
        for command in block.beside:
            beside.append(stack.enter_context(_running(command, names)))
            beside[-1].await_ready(block.ready_within)
        front = [] if _lost(beside, block) else [stack.enter_context(_running(command, names)) for command in block.run]
        until = perf_counter() + block.run_within
        while any(process.runs for process in front) and not _lost(beside, block):
            if perf_counter() > until:
                late = next(process for process in front if process.runs)
                raise ScenarioError(
                    late.command, f"has not ended after {block.run_within:g} s", "see what it waits for"
                )
            time.sleep(_NAP)
        lost = _lost(beside, block)
        done = {process: process.stopped(block.end_within) for process in front}
        done |= {process: process.stopped(block.end_within, not block.may_end) for process in reversed(beside)}
        first = [done.pop(lost)] if lost else []
        return [*first, *done.values()]


def _lost(beside: Sequence[_RunningCommand], block: ProcedureStepBlock) -> _RunningCommand | None:
    """The first command beside that has ended although the others need it."""
    return next((process for process in beside if process.code or (process.code == 0 and not block.may_end)), None)


class _RunningCommand:
    """A command that runs; its output is taken all the time, so that it never waits for us."""

    def __init__(self, command: str, names: Mapping[str, str], ready: Path) -> None:
        self.command, self._begun = command, perf_counter()
        arguments = [_filled(word, names) for word in shlex.split(command)]
        self._process = subprocess.Popen(
            [_installed_command(), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            env=os.environ | {READY: str(ready)},
        )
        self._ready = ready
        self._lines: deque[str] = deque(maxlen=LINES_KEPT)
        self._heard = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    @property
    def code(self) -> int | None:
        """Its exit code, None while it runs."""
        return self._process.poll()

    @property
    def runs(self) -> bool:
        """Whether it has not ended."""
        return self.code is None

    def await_ready(self, limit: float) -> None:
        """Wait until it is ready, has said something, or has ended."""
        until = perf_counter() + limit
        while self.runs and not self._heard.is_set() and not self._ready.exists():
            if perf_counter() > until:
                raise ScenarioError(self.command, f"is not ready after {limit:g} s", "see what it waits for")
            time.sleep(_NAP)

    def stopped(self, limit: float, lasting: bool = False) -> EndedCommand:
        """What it gave, once it has ended, as asked where it runs; a `lasting` one was to run until now."""
        early = lasting and not self.runs
        self._process.terminate()
        try:
            code = self._process.wait(limit)
        except subprocess.TimeoutExpired:
            raise ScenarioError(self.command, f"has not ended after {limit:g} s", "see what it waits for") from None
        self._reader.join()
        return EndedCommand(self.command, code, perf_counter() - self._begun, "".join(self._lines), early)

    def kill(self) -> None:
        """See that it is gone."""
        self._process.terminate()
        try:
            self._process.wait(_KILLING)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line)
            self._heard.set()


def _installed_command() -> str:
    """The command `servotwin` beside this Python, else on the path."""
    found = shutil.which("servotwin", path=str(Path(sys.executable).parent)) or shutil.which("servotwin")
    if found is None:
        raise ScenarioError("procedure", "the command `servotwin` is not installed", "pip install servotwin")
    return found


@contextmanager
def _running(command: str, names: Mapping[str, str]) -> Iterator[_RunningCommand]:
    with TemporaryDirectory(prefix="servotwin-") as folder:
        process = _RunningCommand(command, names, Path(folder) / "ready")
        try:
            yield process
        finally:
            process.kill()


def _filled(word: str, names: Mapping[str, str]) -> str:
    """The word with its placeholders; other braces stay."""
    for name, value in names.items():
        word = word.replace(f"{{{name}}}", value)
    return word


def outputs_of(document: FileDocument | None) -> str:
    """What the commands of a procedure said, for people; nothing of another scenario, or of none."""
    cases = document["cases"] if document else []
    return "\n".join(f"$ servotwin {case['name']}\n{case['output'].rstrip()}" for case in cases if "output" in case)
