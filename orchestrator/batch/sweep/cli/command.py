"""The command that runs a scenario at many points: sweep."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import InputError
from orchestrator.cli.options import Isolate
from orchestrator.cli.suite import Limited
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from orchestrator.fmi.isolation import Isolation

app = typer.Typer()


@command(app)
def sweep(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study: a YAML file with the key `sweep`.")],
    *,
    jobs: Annotated[
        int | None, typer.Option("-j", "--jobs", min=1, help="Runs at a time; one a processor by default.")
    ] = None,
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster with this scheduler instead.")
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Run those again that failed.")] = False,
    one: Annotated[
        int | None, typer.Option("--run", metavar="N", help="That run alone again, with its whole record and report.")
    ] = None,
    limited: Limited,
    isolate: Isolate,
    out: Out = None,
) -> Answer:
    """Run a scenario at many points into one data set; what is there already is not run again.

    Exit code 1 when fewer runs pass than the study asks for, 3 when all failed.
    """
    from orchestrator.batch.sweep.runs.cluster import Cluster
    from orchestrator.batch.sweep.runs.local import Local
    from orchestrator.batch.sweep.sweep import sweep as run
    from orchestrator.batch.sweep.told.result import HEADERS

    limits, isolation = limited.limits(), isolate.isolation()
    of_processes = {"--jobs": jobs, "--time-limit": limits.seconds, "--memory-limit": limits.megabytes}
    if one is not None:
        given = {"--scheduler": scheduler, "--retry": retry or None, **of_processes}
        _refuse(given, "is for many runs, and --run is one by itself", "leave out one of them")
        return _again(terminal, study, one, out or Path("out") / f"{study.stem}-{one}", isolation)
    folder = out or Path("out") / study.stem
    if scheduler is not None:
        fix = "leave it out, or run without --scheduler"
        _refuse(of_processes, "is of processes of this machine, and not kept by the workers of a cluster", fix)
    runner = Local(jobs or os.cpu_count() or 1, limits) if scheduler is None else Cluster(scheduler)
    try:
        with terminal.bar(study.stem) as move:
            result = run(study, folder, runner, move, retry, isolation)
    except KeyboardInterrupt:
        return _interrupted(folder)
    document = result.document
    listing = Listing(HEADERS, result.rows(), document["title"])
    shown: list[Listing | str] = [listing, *document["notes"], result.sentence]
    shown.append(f"written to {folder}")
    return Answer({**document, "out": str(folder)}, shown, result.passed, failure=result.failure)


def _refuse(options: Mapping[str, object], problem: str, fix: str) -> None:
    """See that none of these options is given."""
    for name, value in options.items():
        if value is not None:
            raise InputError(name, problem, fix)


def _again(terminal: Terminal, study: Path, run: int, out: Path, isolation: Isolation | None) -> Answer:
    """A run of the sweep by itself."""
    from orchestrator.batch.sweep.runs.preparation import prepared
    from orchestrator.batch.sweep.told.again import alone
    from orchestrator.results import check_target
    from orchestrator.scenario.results import document_of, write_run
    from orchestrator.scenario.run import HEADERS as CHECKED
    from orchestrator.scenario.run import run_scenario

    check_target(out, [study])
    with prepared(study) as ready, terminal.bar(study.stem) as move:
        result = run_scenario(alone(ready, run), progress=move, isolation=isolation, going_on=True)
        write_run(result, {}, out)
        return Answer(
            document_of(result, {}, out), [Listing(CHECKED, result.rows()), f"written to {out}"], result.passed
        )


def _interrupted(folder: Path) -> Answer:
    """How far it is; without anything there the interrupt goes on."""
    from orchestrator.batch.sweep.told.unfinished import about_unfinished

    if not (folder / "manifest.jsonl").exists():
        raise KeyboardInterrupt
    there = about_unfinished(folder)
    line = f"interrupted with {there['unfinished']} in {folder}; the same command goes on from there"
    return Answer({**there, "out": str(folder), "interrupted": True}, interrupted=line)
