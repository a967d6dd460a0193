"""The regression suite: every scenario, study with claims and procedure under some paths; a verdict each."""

from __future__ import annotations

import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.util import Finalize
from pathlib import Path
from time import perf_counter

from fmus.errors import FmuError, ScenarioError, ServotwinError
from orchestrator.batch.procedure import run_procedure
from orchestrator.fmi.isolation import Isolation
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
    with ThreadPoolExecutor(processes) as pool, _ending(pool):
        tasks = [pool.submit(_apart, file, out / file.parent.name / file.stem, judges, isolation) for file in files]
        for task in as_completed(tasks):
            verdict = task.result()
            verdicts[verdict.file] = verdict
            if done is not None:
                done(verdict)
    return [verdicts[file] for file in files]


@contextmanager
def _ending(pool: ThreadPoolExecutor) -> Iterator[None]:
    """Have nothing else run, and what runs end, when an error comes in between."""
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in active_children():
            process.terminate()
        raise


def _obey(scratch: str) -> None:
    """Have this process keep its temporary files there, and be interrupted by the main process, and by its end, but not
    by a terminal: that would be twice.

    An interrupt cleans up; a second one would cut that short.
    """
    tempfile.tempdir = scratch
    Finalize(None, shutil.rmtree, (scratch, True), exitpriority=1)  # where the main process is killed, nobody else does
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    threading.Thread(target=_await_end, daemon=True).start()


def _await_end() -> None:
    main_process, main_thread = parent_process(), threading.main_thread().ident
    assert main_process is not None and main_thread is not None
    main_process.join()
    signal.pthread_kill(main_thread, signal.SIGTERM)


def _apart(file: Path, out: Path, judges: Mapping[str, Judge], isolation: Isolation | None) -> Verdict:
    """The verdict of a file that is run in a process of its own."""
    begun = perf_counter()
    try:
        with (
            tempfile.TemporaryDirectory(prefix="servotwin-") as scratch,  # gone with all in it also after a crash
            ProcessPoolExecutor(1, get_context("spawn"), _obey, (scratch,), max_tasks_per_child=1) as process,
        ):
            return process.submit(_run, file, out, judges, isolation).result()
    except BrokenProcessPool:
        crash = FmuError(file, "an FMU crashed the process that ran it", "give --isolate to learn which one and where")
        return Verdict(file, perf_counter() - begun, None, str(crash))


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
