"""The regression suite: every scenario, study with claims and procedure under some paths; a verdict each."""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import cast

from fmus.errors import InternalError, ours
from fmus.packaging import targets
from orchestrator.batch.discovery import SuiteFile
from orchestrator.batch.limits import CaseLimits
from orchestrator.batch.procedure import run_procedure
from orchestrator.batch.scenario_judge import LostCase, ScenarioJudge
from orchestrator.batch.verdict import FileJudge, Verdict
from orchestrator.fmi import unpacked
from orchestrator.processes import last_words
from orchestrator.processes.child import Died
from orchestrator.processes.interrupts import requested
from orchestrator.processes.last_words import LastWords
from orchestrator.processes.pool import Processes
from orchestrator.results import FileDocument, Permission, permission, permitted

MOST_FILES = 50  # of a process: libraries that it has loaded stay
AHEAD = ["orchestrator.batch.ahead", __name__]


def run_suite(
    tasks: Sequence[SuiteFile],
    out: Path,
    processes: int,
    done: Callable[[Verdict], None] | None = None,
    limits: CaseLimits | None = None,
) -> list[Verdict]:
    """Run the files in processes, at most `processes` at a time; verdicts in the order of the tasks.

    A process takes another file only where none but native FMUs of models have run in it, and memory is not limited.
    An FMU that crashes its process, or a case over its limits, fails that case alone: the scenario is run once more
    without it. A fault of ours fails its file. An interrupt ends those that run, too.

    Args:
        done: told each verdict when it is there.
        limits: what a case may take; procedures have limits of their own.
    """
    queue = _Queue(tasks, out)
    watch = partial(queue.watched, limits) if limits else None
    verdicts: dict[Path, Verdict] = {}
    alone = limits is not None and limits.megabytes is not None  # what a process has taken for others is not counted
    spent = partial(_spent, alone)
    with Processes[Callable[[], Verdict], Verdict](_SuiteWorker, processes, AHEAD, spent=spent, watch=watch) as pool:
        for number, answer in pool.answers(queue):
            verdict = queue.answered(number, answer)
            if verdict is None:
                continue
            verdicts[verdict.file] = verdict
            if done is not None:
                done(verdict)
    return [verdicts[task.file] for task in tasks]


def _spent(alone: bool, verdict: Verdict) -> bool:
    return alone or verdict.last


class _SuiteWorker:
    """What judges files in a process, one after the other."""

    def __init__(self) -> None:
        self._files = 0
        unpacked.keep()

    def __call__(self, task: Callable[[], Verdict]) -> Verdict:
        self._files += 1
        last_words.own().forget(last_words.GONE)
        verdict = task()
        return replace(verdict, last=self._files >= MOST_FILES or not _of_models_alone(verdict.document))


def _of_models_alone(document: FileDocument | None) -> bool:
    """Whether all that has run is C made here: other FMUs, and Python code in ours, may leave anything behind."""
    fmus = cast("Mapping[str, str]", {} if document is None else document.get("fmus", {}))
    return set(fmus.values()) == {"model"} and targets.preferred() == "native"


class _Queue(Iterator[Callable[[], Verdict]]):
    """Files that wait for a process. One that has lost a case comes again, so the queue may end more than once."""

    def __init__(self, tasks: Sequence[SuiteFile], out: Path) -> None:
        self._waiting, self._out = deque(tasks), out
        self._begun: list[SuiteFile] = []
        self._spent: dict[Path, float] = {}
        self._allowed = permission()

    def __next__(self) -> Callable[[], Verdict]:
        if not self._waiting:
            raise StopIteration
        task = self._waiting.popleft()
        self._begun.append(task)
        return partial(judged, task.judge, task.file, self._out / task.place, self._allowed)

    def watched(self, limits: CaseLimits, number: int, pid: int, words: LastWords, begun: float) -> str:
        """Why the process of the task that was the `number`-th to begin is to be killed; "" where it may go on."""
        exempt = self._begun[number].judge is run_procedure
        return "" if exempt else limits.exceeded(pid, words, begun)

    def answered(self, number: int, answer: Verdict | Died) -> Verdict | None:
        """The verdict of the task that was the `number`-th to begin, None where it is to be tried again."""
        task = self._begun[number]
        before = self._spent.get(task.file, 0.0)
        if isinstance(answer, Verdict):
            return replace(answer, seconds=answer.seconds + before)
        self._spent[task.file] = before + answer.seconds
        lost = _lost(answer)
        if answer.part is None or not isinstance(task.judge, ScenarioJudge):
            return Verdict(task.file, self._spent[task.file], None, str(lost.error(task.file)))
        judge = task.judge.without(answer.part, lost)
        self._waiting.appendleft(replace(task, judge=judge))
        return None


def _lost(died: Died) -> LostCase:
    if died.ended_by_us:
        return LostCase(died.ending, "see what takes it, or give it more", died.part_seconds)
    problem = f"{died.fmus or 'an FMU'} crashed the process that ran it, which {died.ending}"
    return LostCase(problem, "give --isolate to learn where", died.part_seconds)


def judged(judge: FileJudge, file: Path, out: Path, allowed: Permission) -> Verdict:
    """The verdict about a file, whatever is wrong with it."""
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
