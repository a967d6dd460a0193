"""The regression suite: every scenario, study with claims and procedure under some paths; a verdict each."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter

from fmus.errors import FmuError, ScenarioError, ServotwinError
from orchestrator.batch.procedure import run_procedure
from orchestrator.fmi.isolation import Isolation
from orchestrator.processes import Died, Processes, calling
from orchestrator.results import FileDocument
from orchestrator.scenario.results import document_of, write_run
from orchestrator.scenario.run import run_scenario
from orchestrator.scenario.schema import ScenarioBlock
from orchestrator.yaml_file import keys, load

Judge = Callable[[Path, Path], FileDocument]
"""Runs a file into a folder and says whether all came out as the file states; another process can import it."""


@dataclass(frozen=True)
class Verdict:
    """How one file went: what came out, with `passed` and `cases`, or the `error` that ended it."""

    file: Path
    seconds: float
    document: FileDocument | None
    error: str = ""

    @property
    def passed(self) -> bool:
        return self.document is not None and bool(self.document["passed"])


def find_scenarios(paths: Sequence[Path], judged: Collection[str]) -> list[Path]:
    """The files to be judged among and under these paths: YAML files with `run`, `procedure` or a key of `judged`, but
    those with a `can` block only where they are named.

    Raises:
        ScenarioError: a path is not there, a file given by name is no such file, or there is none at all.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_file():
            if not _kind(path, judged):
                load(path, ScenarioBlock)  # says what is missing
            found.append(path)
        elif path.is_dir():
            found += [file for file in sorted(path.rglob("*.yaml")) if _kind(file, judged)]
        else:
            raise ScenarioError(path, "no such file or folder", "check the path")
    if not found:
        raise ScenarioError(", ".join(map(str, paths)), "there is no scenario", "give a folder that holds some")
    return list(dict.fromkeys(found))


def _kind(file: Path, judged: Collection[str]) -> str:
    """The key that tells what the file is, nothing where it is not for the suite: one side of a bus needs the other."""
    found = keys(file)
    return "" if "can" in found else next((key for key in found if key in ("run", "procedure", *judged)), "")


def run_suite(
    files: Sequence[Path],
    out: Path,
    processes: int,
    judges: Mapping[str, Judge],
    done: Callable[[Verdict], None] | None = None,
    isolation: Isolation | None = None,
) -> list[Verdict]:
    """Run each file in a process of its own, at most `processes` at a time; verdicts in the order of the files.

    An FMU that crashes its process fails that file alone. An interrupt ends those that run, too.

    Args:
        judges: key at the top of a file that is neither a scenario nor a procedure -> who runs it.
    """
    verdicts: dict[Path, Verdict] = {}
    tasks = [partial(_run, file, out / file.parent.name / file.stem, judges, isolation) for file in files]
    with Processes[Callable[[], Verdict], Verdict](calling, processes, [__name__], fresh=True) as pool:
        for number, answer in pool.answers(tasks):
            verdict = _crashed(files[number], answer) if isinstance(answer, Died) else answer
            verdicts[verdict.file] = verdict
            if done is not None:
                done(verdict)
    return [verdicts[file] for file in files]


def _crashed(file: Path, died: Died) -> Verdict:
    crash = FmuError(file, "an FMU crashed the process that ran it", "give --isolate to learn which one and where")
    return Verdict(file, died.seconds, None, str(crash))


def _run(file: Path, out: Path, judges: Mapping[str, Judge], isolation: Isolation | None) -> Verdict:
    begun = perf_counter()
    try:
        return Verdict(file, perf_counter() - begun, _document(file, out, judges, isolation))
    except ServotwinError as error:
        return Verdict(file, perf_counter() - begun, None, str(error))


def _document(file: Path, out: Path, judges: Mapping[str, Judge], isolation: Isolation | None) -> FileDocument:
    kind = _kind(file, judges)
    if kind == "procedure":
        return run_procedure(file, out)
    return judges[kind](file, out) if kind in judges else _run_scenario(file, out, isolation)


def _run_scenario(file: Path, out: Path, isolation: Isolation | None) -> FileDocument:
    result = run_scenario(file, isolation=isolation)
    write_run(result, {}, out)
    return document_of(result, {}, out)
