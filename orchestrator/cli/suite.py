"""The command that runs the regression suite: test."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import InputError, InternalError
from orchestrator.cli.options import Isolate
from orchestrator.cli.selection import FileSelection
from orchestrator.cli.tables import JUDGES
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from orchestrator.batch.discovery import SuiteFile
    from orchestrator.batch.limits import CaseLimits
    from orchestrator.batch.summary import SuiteSummary
    from orchestrator.batch.verdict import Verdict

app = typer.Typer()


@dataclass(frozen=True)
class Limited:
    """What a case of a scenario, or a study, may take before it is killed, which fails it alone."""

    time_limit: Annotated[
        float | None, typer.Option("--time-limit", metavar="SECONDS", help="The longest a case may take.")
    ] = None
    memory_limit: Annotated[
        float | None, typer.Option("--memory-limit", metavar="MB", help="The most memory that it may take.")
    ] = None

    def limits(self) -> CaseLimits:
        """As the suite takes them."""
        from orchestrator.batch.limits import CaseLimits

        return CaseLimits(self.time_limit, self.memory_limit)


@dataclass(frozen=True)
class Telling:
    """Where verdicts are written to besides standard output."""

    junit: Annotated[Path | None, typer.Option(metavar="FILE", help="JUnit XML file to write.")] = None
    summary: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Markdown file to write, or to add to: a page about the suite.")
    ] = None
    github: Annotated[
        bool, typer.Option("--github", help="Have GitHub show failures at their files, and the page with the job.")
    ] = False

    def check(self) -> None:
        """See that they may be written, before the suite runs."""
        from fmus.files import check_place

        if self.junit is not None:
            check_place(self.junit)
        self._add_to_pages("")

    def tell(self, told: SuiteSummary) -> None:
        """Write them."""
        from orchestrator.batch.junit import write_junit
        from orchestrator.batch.summary import github_lines

        if self.junit is not None:
            write_junit(told.verdicts, self.junit)
        self._add_to_pages(told.markdown())
        if self.github:
            for line in github_lines(told.verdicts, Path(os.environ.get("GITHUB_WORKSPACE", "."))):
                print(line, file=sys.stderr, flush=True)

    def refuse(self, option: str) -> None:
        """See that nothing is to be written with an option that gives no verdicts.

        Raises:
            InputError: something is.
        """
        given = {"--junit": self.junit, "--summary": self.summary, "--github": self.github}
        for name, wanted in given.items():
            if wanted:
                raise InputError(name, f"has verdicts of scenarios, which {option} does not give", "use --json")

    def _add_to_pages(self, text: str) -> None:
        from fmus.files import add_text

        page = os.environ.get("GITHUB_STEP_SUMMARY") if self.github else None
        for file in [Path(one) for one in (self.summary, page) if one]:
            add_text(file, text)


@command(app)
def test(
    terminal: Terminal,
    *,
    paths: Annotated[
        list[Path] | None, typer.Argument(help="Scenarios, studies with claims, and folders; scenarios/ by default.")
    ] = None,
    jobs: Annotated[int, typer.Option("-j", "--jobs", min=1, help="Scenarios run side by side.")] = 1,
    chosen: FileSelection,
    mutate: Annotated[
        bool, typer.Option("--mutate", help="Tell which parameters could change by 1 % and no scenario would notice.")
    ] = False,
    limited: Limited,
    telling: Telling,
    out: Out = None,
    isolate: Isolate,
) -> Answer:
    """Run all scenarios, and all studies that state claims, under the paths: the regression suite.

    Exit code 1 when an expectation fails, or a claim does not come out as its study states; 4 when a file met a fault
    of servotwin, which ends that file alone.
    """
    from orchestrator.batch.discovery import find_scenarios
    from orchestrator.batch.scenario_judge import ScenarioJudge
    from orchestrator.batch.summary import SuiteSummary

    limits, folder, places = limited.limits(), out or Path("out/test"), paths or [Path("scenarios")]
    if mutate:
        telling.refuse("--mutate")
        tasks = chosen.of(_to_be_changed(places, isolate), folder, terminal)
        return _mutated(terminal, tasks, jobs, folder, limits)
    tasks = chosen.of(find_scenarios(places, JUDGES, ScenarioJudge(isolate.isolation())), folder, terminal)
    telling.check()
    if not tasks:  # the page of those that ran before stays
        none = SuiteSummary([], 0.0, jobs)
        telling.tell(none)
        return Answer(_document(none), [f"nothing to run: {chosen.nothing}"])
    summary = _run(terminal, tasks, jobs, folder, limits)
    telling.tell(summary)
    return _judged(terminal, summary, folder)


def _run(terminal: Terminal, tasks: Sequence[SuiteFile], jobs: int, folder: Path, limits: CaseLimits) -> SuiteSummary:
    """How the files turned out, which is remembered for the next time."""
    from orchestrator.batch import index
    from orchestrator.batch.history import remember
    from orchestrator.batch.suite import run_suite
    from orchestrator.batch.summary import SuiteSummary

    index.prepare(folder)
    passed: dict[Path, bool] = {}
    begun = perf_counter()
    with terminal.bar("scenarios") as move:

        def done(verdict: Verdict) -> None:
            passed[verdict.file] = verdict.passed
            move(len(passed) / len(tasks), verdict.file.stem)

        try:
            verdicts = run_suite(tasks, folder, jobs, done, limits)
        finally:  # what an interrupt has left is known, too
            remember(passed, folder)
    return SuiteSummary(verdicts, perf_counter() - begun, jobs)


def _judged(terminal: Terminal, summary: SuiteSummary, folder: Path) -> Answer:
    """What there is to say of a suite, and whether all held."""
    from orchestrator.batch.index import write_index
    from orchestrator.batch.procedure import outputs_of
    from orchestrator.batch.summary import HEADERS

    verdicts, page = summary.verdicts, write_index(summary, folder)
    said = [text for verdict in verdicts if (text := outputs_of(verdict.document))] if terminal.verbose else []
    for verdict in verdicts if terminal.verbose >= 2 else ():
        if verdict.fault:
            terminal.say(verdict.fault)
    table = Listing(HEADERS, summary.rows(all_files=terminal.verbose > 0))
    shown: list[Listing | str] = [*said, table, summary.sentence, f"all reports from {page} on"]
    document = _document(summary)
    return Answer(document, shown, bool(document["passed"]), failure=_fault(verdicts))


def _to_be_changed(paths: Sequence[Path], isolate: Isolate) -> list[SuiteFile]:
    """The scenarios under the paths, to be asked what they notice of their parameters."""
    from orchestrator.batch.discovery import find_scenarios
    from orchestrator.batch.mutation.judge import MutationJudge

    found = find_scenarios(paths, {}, MutationJudge(isolate.isolation()))
    return [task for task in found if isinstance(task.judge, MutationJudge)]


def _mutated(terminal: Terminal, tasks: Sequence[SuiteFile], jobs: int, folder: Path, limits: CaseLimits) -> Answer:
    """What scenarios notice of their parameters."""
    from orchestrator.batch.mutation.coverage import HEADERS, Coverage
    from orchestrator.batch.suite import run_suite

    finished: list[Path] = []
    with terminal.bar("scenarios") as move:

        def done(verdict: Verdict) -> None:
            finished.append(verdict.file)
            move(len(finished) / len(tasks), verdict.file.stem)

        verdicts = run_suite(tasks, folder, jobs, done, limits)
    coverage, errors = Coverage.of(verdicts), [verdict.error for verdict in verdicts if verdict.error]
    unseen, unnoticed = coverage.unseen, coverage.unnoticed
    rows = [(name, ", ".join(map(str, files)), "" if name in unnoticed else "yes") for name, files in unseen.items()]
    told = Listing(("parameter that goes unseen", "where it acts", "seen elsewhere"), rows)
    shown: list[Listing | str] = [
        Listing(HEADERS, coverage.rows()),
        *([told] if rows else []),
        coverage.sentence,
        *errors,
    ]
    document = {
        "noticed": coverage.share,
        "unseen": unseen,
        "unnoticed": unnoticed,
        "errors": errors,
        "parameters": [
            {"file": file, "parameter": name, "outcome": outcome, "found": coverage.found[file, name]}
            for (file, name), outcome in coverage.outcomes.items()
        ],
    }
    return Answer(document, shown, not errors, failure=_fault(verdicts))


def _document(summary: SuiteSummary) -> dict[str, object]:
    scenarios = [
        {
            "file": str(verdict.file),
            "passed": verdict.passed,
            "seconds": round(verdict.seconds, 3),
            "error": verdict.first_error,
            "result": verdict.document,
        }
        for verdict in summary.verdicts
    ]
    return {
        "passed": all(verdict.passed for verdict in summary.verdicts),
        "seconds": round(summary.seconds, 3),
        "processes": summary.processes,
        "scenarios": scenarios,
    }


def _fault(verdicts: Sequence[Verdict]) -> InternalError | None:
    """What ends a suite in which files met faults of ours; the others went on."""
    files = [str(verdict.file) for verdict in verdicts if verdict.fault]
    if not files:
        return None
    return InternalError(", ".join(files), "met a fault of servotwin", "run with -vv and report what that says")
