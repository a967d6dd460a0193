"""A procedure: commands of this project, one after the other and some beside others, as one case of the suite.

What takes several processes (a rig on a bus, a recorder, a controller) becomes a scenario that one command runs.
"""

from __future__ import annotations

import shlex
import shutil
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter

from pydantic import Field, field_validator

from fmus.errors import ScenarioError
from fmus.files import sha256
from orchestrator.results import CaseDocument, FileDocument, check_target, versions, write_json
from orchestrator.yaml_file import Block, load, naming

START_TIME, END_TIME, RUN_TIME = 120.0, 30.0, 1800.0  # for a first line, to end when asked to, to run [s]
LINES_KEPT = 60


class StepBlock(Block):
    """Commands without `servotwin`; `{here}` is the folder of the file and `{out}` that of the results.

    Attributes:
        beside: started first, each when the one before has said its first line (that it is on a bus), and ended
            (SIGTERM) in the opposite order when all of `run` are done.
        run: run side by side.
    """

    beside: list[str] = []
    run: list[str] = Field(min_length=1)

    @field_validator("beside", "run")
    @classmethod
    def _readable(cls, value: list[str]) -> list[str]:
        for command in value:
            if not shlex.split(command):
                raise ValueError("an empty command")
        return value


class ProcedureBlock(Block):
    """A procedure file."""

    title: str
    description: str = ""
    procedure: list[StepBlock] = Field(min_length=1)


@dataclass(frozen=True)
class Done:
    """A command that has ended."""

    command: str
    code: int
    seconds: float
    output: str

    def document(self) -> CaseDocument:
        """As a case of the suite."""
        last = self.output.splitlines()[-1:] or ["nothing said"]
        problem = None if self.code == 0 else f"exit code {self.code}: {last[0]}"
        return {
            "name": self.command,
            "passed": self.code == 0,
            "error": problem,
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


def _step(block: StepBlock, names: Mapping[str, str]) -> list[Done]:
    with ExitStack() as stack:
        beside = []
        for command in block.beside:
            beside.append(stack.enter_context(_running(command, names)))
            beside[-1].await_first_line()
        front = [stack.enter_context(_running(command, names)) for command in block.run]
        done = [process.ended(RUN_TIME) for process in front]
        return done + [process.stopped() for process in reversed(beside)]


class _RunningCommand:
    """A command that runs; its output is taken all the time, so that it never waits for us."""

    def __init__(self, command: str, names: Mapping[str, str]) -> None:
        self.command, self._begun = command, perf_counter()
        arguments = [_filled(word, names) for word in shlex.split(command)]
        self._process = subprocess.Popen(
            [_installed_command(), *arguments],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
        )
        self._lines: deque[str] = deque(maxlen=LINES_KEPT)
        self._heard = threading.Event()
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def await_first_line(self) -> None:
        """Wait until it has said something, or ended."""
        if not self._heard.wait(START_TIME):
            raise ScenarioError(self.command, f"has said nothing after {START_TIME:g} s", "see what it waits for")

    def ended(self, limit: float) -> Done:
        """What it gave, once it has ended by itself."""
        try:
            code = self._process.wait(limit)
        except subprocess.TimeoutExpired:
            raise ScenarioError(self.command, f"has not ended after {limit:g} s", "see what it waits for") from None
        self._reader.join()
        return Done(self.command, code, perf_counter() - self._begun, "".join(self._lines))

    def stopped(self) -> Done:
        """What it gave, once it has ended as asked."""
        self._process.terminate()
        return self.ended(END_TIME)

    def kill(self) -> None:
        """See that it is gone."""
        self._process.terminate()
        try:
            self._process.wait(END_TIME / 10)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def _read(self) -> None:
        assert self._process.stdout is not None
        for line in self._process.stdout:
            self._lines.append(line)
            self._heard.set()
        self._heard.set()


def _installed_command() -> str:
    """The command `servotwin` beside this Python, else on the path."""
    found = shutil.which("servotwin", path=str(Path(sys.executable).parent)) or shutil.which("servotwin")
    if found is None:
        raise ScenarioError("procedure", "the command `servotwin` is not installed", "pip install servotwin")
    return found


@contextmanager
def _running(command: str, names: Mapping[str, str]) -> Iterator[_RunningCommand]:
    process = _RunningCommand(command, names)
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
