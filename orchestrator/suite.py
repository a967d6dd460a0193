"""The regression suite: every scenario under some paths, run side by side, with a verdict each and a JUnit file."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass
from multiprocessing import active_children, get_context, parent_process
from pathlib import Path
from time import perf_counter
from typing import Any
from xml.etree import ElementTree as ET

from fmus.errors import ScenarioError, ServotwinError
from fmus.files import atomic_write
from orchestrator.isolation import Isolation
from orchestrator.run_results import document_of, write_run
from orchestrator.scenario import ScenarioBlock, run_scenario
from orchestrator.yaml_file import holds, load


@dataclass(frozen=True)
class Verdict:
    """How one scenario went: `document` as `servotwin run --json` prints it, or the `error` that ended it."""

    file: Path
    seconds: float
    document: dict[str, Any] | None
    error: str = ""

    @property
    def passed(self) -> bool:
        return self.document is not None and bool(self.document["passed"])


def find_scenarios(paths: Sequence[Path]) -> list[Path]:
    """The scenario files among and under these paths: YAML files with a `run`.

    Raises:
        ScenarioError: a path is not there, a file given by name does not fit, or there is no scenario at all.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_file():
            load(path, ScenarioBlock)
            found.append(path)
        elif path.is_dir():
            found += [file for file in sorted(path.rglob("*.yaml")) if holds(file, "run")]
        else:
            raise ScenarioError(path, "no such file or folder", "check the path")
    if not found:
        raise ScenarioError(", ".join(map(str, paths)), "there is no scenario", "give a folder that holds some")
    return list(dict.fromkeys(found))


def run_suite(
    files: Sequence[Path],
    out: Path,
    processes: int,
    done: Callable[[Verdict], None] | None = None,
    isolation: Isolation | None = None,
) -> list[Verdict]:
    """Run scenarios in processes of their own, at most `processes` at a time; verdicts in the order of the files.

    With isolation an FMU that crashes fails its scenario alone. An interrupt ends those that run, too.
    """
    verdicts: dict[Path, Verdict] = {}
    spawn = get_context("spawn")
    with ProcessPoolExecutor(processes, spawn, _obey, max_tasks_per_child=1) as pool, _ending(pool):
        tasks = {pool.submit(_run, file, out / file.parent.name / file.stem, isolation): file for file in files}
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
        suite = ET.SubElement(root, "testsuite", name=str(verdict.file), tests=str(len(cases)), failures=str(failed),
                              errors="0" if verdict.document else "1", time=f"{verdict.seconds:.3f}")  # fmt: skip
        for case in cases:
            entry = ET.SubElement(suite, "testcase", name=case["name"], classname=verdict.file.stem)
            if verdict.document is None:
                ET.SubElement(entry, "error", message=verdict.error)
            elif not case["passed"]:
                ET.SubElement(entry, "failure", message=_why(case))
    ET.indent(root)
    atomic_write(path, ET.tostring(root, encoding="UTF-8", xml_declaration=True))


@contextmanager
def _ending(pool: ProcessPoolExecutor) -> Iterator[None]:
    """Have nothing else run, and what runs end, when an error comes in between."""
    try:
        yield
    except BaseException:
        pool.shutdown(wait=False, cancel_futures=True)
        for process in active_children():
            process.terminate()
        raise


def _obey() -> None:
    """Let this process be interrupted by the main process, and by its end, but not by a terminal: that would be twice.

    An interrupt cleans up; a second one would cut that short.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    threading.Thread(target=_await_end, daemon=True).start()


def _await_end() -> None:
    main_process, main_thread = parent_process(), threading.main_thread().ident
    assert main_process is not None and main_thread is not None
    main_process.join()
    signal.pthread_kill(main_thread, signal.SIGTERM)


def _run(file: Path, out: Path, isolation: Isolation | None) -> Verdict:
    begun = perf_counter()
    try:
        result = run_scenario(file, isolation=isolation)
        write_run(result, {}, out)
        return Verdict(file, perf_counter() - begun, document_of(result, {}, out))
    except ServotwinError as error:
        return Verdict(file, perf_counter() - begun, None, str(error))


def _why(case: dict[str, Any]) -> str:
    missed = [f"{check['text']}: {check['found']}" for check in case["checks"] if not check["held"]]
    return "; ".join(missed) or str(case["error"])
