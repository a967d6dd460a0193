"""The regression suite: every scenario, study with claims and procedure under some paths; a verdict each."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

from fmus.errors import FmuError, InternalError, ScenarioError, ours
from orchestrator.batch.procedure import run_procedure
from orchestrator.fmi.isolation import Isolation
from orchestrator.interrupts import requested
from orchestrator.processes import Died, Processes, calling
from orchestrator.results import FileDocument, Permission, aside, check_target, permission, permitted
from orchestrator.scenario.results import LOG_FILE, document_of, write_run
from orchestrator.scenario.run import Keeping, ScenarioFailed, run_scenario
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import keys, load

FileJudge = Callable[[Path, Path], FileDocument]
"""Runs a file into a folder and says whether all came out as the file states; another process can import it."""


@dataclass(frozen=True)
class Verdict:
    """How one file went: what came out, with `passed` and `cases`, or the `error` that ended it.

    Attributes:
        fault: where the error is a fault of this project, its traceback.
    """

    file: Path
    seconds: float
    document: FileDocument | None
    error: str = ""
    fault: str = ""

    @property
    def passed(self) -> bool:
        return self.document is not None and bool(self.document["passed"])

    @property
    def why(self) -> str:
        """Why it has not passed, "" where it has: the error, or the first case that failed."""
        cases = self.document["cases"] if self.document else ()
        failed = next((case for case in cases if not case["passed"]), None)
        if self.error or failed is None:
            return self.error
        checks = [f"{check['text']}, found {check['found']}" for check in failed["checks"] if not check["held"]]
        return f"{failed['name']}: {failed['error'] or ', '.join(checks[:1])}"


def find_scenarios(
    paths: Sequence[Path], judges: Mapping[str, FileJudge], isolation: Isolation | None = None
) -> dict[Path, FileJudge]:
    """The files to be judged among and under these paths, with who judges each: YAML files with `run`, `procedure` or a
    key of `judges`, but those with a `can` block only where they are named.

    Args:
        judges: key at the top of a file that is neither a scenario nor a procedure -> who judges it.
        isolation: how FMUs that scenarios give as files are isolated, None where they are not.

    Raises:
        ScenarioError: a path is not there, a file given by name is no such file, or there is none at all.
    """
    run = partial(_run_scenario, isolation=isolation)
    known: dict[str, FileJudge] = {"run": run, "procedure": run_procedure, **judges}
    found: dict[Path, FileJudge] = {}
    for path in paths:
        if path.is_file():
            judge = _judge(path, known)
            if judge is None:
                load(path, ScenarioBlock)  # says what is missing
            found[path] = judge or run
        elif path.is_dir():
            found |= {file: judge for file in sorted(path.rglob("*.yaml")) if (judge := _judge(file, known))}
        else:
            raise ScenarioError(path, "no such file or folder", "check the path")
    if not found:
        raise ScenarioError(", ".join(map(str, paths)), "there is no scenario", "give a folder that holds some")
    return found


def _judge(file: Path, known: Mapping[str, FileJudge]) -> FileJudge | None:
    """Who judges a file, by its keys; nobody where it is not for the suite: one side of a bus needs the other."""
    found = keys(file)
    return None if "can" in found else next((known[key] for key in found if key in known), None)


def run_suite(
    files: Mapping[Path, FileJudge],
    out: Path,
    processes: int,
    done: Callable[[Verdict], None] | None = None,
) -> list[Verdict]:
    """Run each file in a process of its own, at most `processes` at a time; verdicts in the order of the files.

    An FMU that crashes its process, or a fault of ours, fails that file alone. An interrupt ends those that run, too.

    Args:
        files: file -> who judges it.
        done: told each verdict when it is there.
    """
    verdicts: dict[Path, Verdict] = {}
    order = list(files)
    allowed = permission()
    tasks = [
        partial(_judged, judge, file, out / file.parent.name / file.stem, allowed) for file, judge in files.items()
    ]
    with Processes[Callable[[], Verdict], Verdict](calling, processes, [__name__], fresh=True) as pool:
        for number, answer in pool.answers(tasks):
            verdict = _crashed(order[number], answer) if isinstance(answer, Died) else answer
            verdicts[verdict.file] = verdict
            if done is not None:
                done(verdict)
    return [verdicts[file] for file in files]


def _crashed(file: Path, died: Died) -> Verdict:
    problem = f"{died.fmus or 'an FMU'} crashed the process that ran it, which {died.ending}"
    crash = FmuError(file, problem, "give --isolate to learn where")
    return Verdict(file, died.seconds, None, str(crash))


def _judged(judge: FileJudge, file: Path, out: Path, allowed: Permission) -> Verdict:
    begun = perf_counter()
    document, problem, fault = None, "", ""
    try:
        with permitted(allowed):
            document = judge(file, out)
    except Exception as error:
        if requested():  # whoever met the interrupt has made another error of it
            raise
        met = ours(error)
        problem, fault = str(met), traceback.format_exc() if isinstance(met, InternalError) else ""
    return Verdict(file, perf_counter() - begun, document, problem, fault)


def _run_scenario(file: Path, out: Path, isolation: Isolation | None) -> FileDocument:
    check_target(out, [file])
    with aside(out) as near:
        try:
            result = run_scenario(file, keeping=Keeping(log=near / LOG_FILE), isolation=isolation)
        except ScenarioFailed as failed:
            write_run(failed.result, {}, out)
            raise
        write_run(result, {}, out)
        return document_of(result, {}, out)
