"""The regression suite: every scenario, study with claims and procedure under some paths; a verdict each."""

from __future__ import annotations

import shutil
import signal
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from multiprocessing.util import Finalize
from pathlib import Path
from time import perf_counter
from typing import Any
from xml.etree import ElementTree as ET

from fmus.errors import FmuError, ScenarioError, ServotwinError
from fmus.files import atomic_write
from orchestrator.batch.procedure import run_procedure
from orchestrator.fmi.isolation import Isolation
from orchestrator.scenario.results import document_of, write_run
from orchestrator.scenario.run import ScenarioBlock, run_scenario
from orchestrator.yaml_file import keys, load

Study = Callable[[Path, Path], dict[str, Any]]  # runs a study into a folder: whether all came out as stated, and cases


@dataclass(frozen=True)
class Verdict:
    """How one file went: what came out, with `passed` and `cases`, or the `error` that ended it."""

    file: Path
    seconds: float
    document: dict[str, Any] | None
    error: str = ""

    @property
    def passed(self) -> bool:
        return self.document is not None and bool(self.document["passed"])


def find_scenarios(paths: Sequence[Path]) -> list[Path]:
    """The files to be judged among and under these paths: YAML files with `run`, `claims` or `procedure`, but those
    with a `can` block only where they are named.

    Raises:
        ScenarioError: a path is not there, a file given by name is no such file, or there is none at all.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_file():
            if not _kind(path):
                load(path, ScenarioBlock)  # says what is missing
            found.append(path)
        elif path.is_dir():
            found += [file for file in sorted(path.rglob("*.yaml")) if _kind(file)]
        else:
            raise ScenarioError(path, "no such file or folder", "check the path")
    if not found:
        raise ScenarioError(", ".join(map(str, paths)), "there is no scenario", "give a folder that holds some")
    return list(dict.fromkeys(found))


def _kind(file: Path) -> str:
    """The key that tells what the file is, nothing where it is not for the suite: one side of a bus needs the other."""
    found = keys(file)
    return "" if "can" in found else next((key for key in found if key in ("run", "claims", "procedure")), "")


def run_suite(
    files: Sequence[Path],
    out: Path,
    processes: int,
    study: Study,
    done: Callable[[Verdict], None] | None = None,
    isolation: Isolation | None = None,
) -> list[Verdict]:
    """Run each file in a process of its own, at most `processes` at a time; verdicts in the order of the files.

    An FMU that crashes its process fails that file alone. An interrupt ends those that run, too.

    Args:
        study: runs the files that are studies; a function that another process can import.
    """
    verdicts: dict[Path, Verdict] = {}
    with ThreadPoolExecutor(processes) as pool, _ending(pool):
        tasks = [pool.submit(_apart, file, out / file.parent.name / file.stem, study, isolation) for file in files]
        for task in as_completed(tasks):
            verdict = task.result()
            verdicts[verdict.file] = verdict
            if done is not None:
                done(verdict)
    return [verdicts[file] for file in files]


def write_junit(verdicts: Iterable[Verdict], path: Path) -> None:
    """The verdicts as JUnit XML: a suite a scenario, a test case a case."""
    root = ET.Element("testsuites", name="servotwin")
    for verdict in verdicts:
        cases: list[dict[str, Any]] = (
            verdict.document["cases"] if verdict.document else [{"name": "run", "passed": False}]
        )
        failed = sum(not case["passed"] for case in cases)
        suite = ET.SubElement(
            root,
            "testsuite",
            name=str(verdict.file),
            tests=str(len(cases)),
            failures=str(failed),
            errors="0" if verdict.document else "1",
            time=f"{verdict.seconds:.3f}",
        )
        for case in cases:
            entry = ET.SubElement(suite, "testcase", name=case["name"], classname=verdict.file.stem)
            if verdict.document is None:
                ET.SubElement(entry, "error", message=verdict.error)
            elif not case["passed"]:
                ET.SubElement(entry, "failure", message=_why(case))
    ET.indent(root)
    atomic_write(path, ET.tostring(root, encoding="UTF-8", xml_declaration=True))


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


def _apart(file: Path, out: Path, study: Study, isolation: Isolation | None) -> Verdict:
    """The verdict of a file that is run in a process of its own."""
    begun = perf_counter()
    try:
        with (
            tempfile.TemporaryDirectory(prefix="servotwin-") as scratch,  # gone with all in it also after a crash
            ProcessPoolExecutor(1, get_context("spawn"), _obey, (scratch,), max_tasks_per_child=1) as process,
        ):
            return process.submit(_run, file, out, study, isolation).result()
    except BrokenProcessPool:
        crash = FmuError(file, "an FMU crashed the process that ran it", "give --isolate to learn which one and where")
        return Verdict(file, perf_counter() - begun, None, str(crash))


def _run(file: Path, out: Path, study: Study, isolation: Isolation | None) -> Verdict:
    begun = perf_counter()
    try:
        return Verdict(file, perf_counter() - begun, _document(file, out, study, isolation))
    except ServotwinError as error:
        return Verdict(file, perf_counter() - begun, None, str(error))


def _document(file: Path, out: Path, study: Study, isolation: Isolation | None) -> dict[str, Any]:
    kind = _kind(file)
    if kind == "procedure":
        return run_procedure(file, out)
    return study(file, out) if kind == "claims" else _run_scenario(file, out, isolation)


def _run_scenario(file: Path, out: Path, isolation: Isolation | None) -> dict[str, Any]:
    result = run_scenario(file, isolation=isolation)
    write_run(result, {}, out)
    return document_of(result, {}, out)


def _why(case: dict[str, Any]) -> str:
    missed = [f"{check['text']}: {check['found']}" for check in case["checks"] if not check["held"]]
    return str(case["error"]) if case["error"] else "; ".join(missed)
