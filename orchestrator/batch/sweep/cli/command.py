"""The command that runs a scenario at many points: sweep."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.suite import Limited
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command

if TYPE_CHECKING:
    from orchestrator.batch.sweep.told.result import AskedDocument

app = typer.Typer()
HEADERS = ("of each run", "held", "95 % sure", "5 % to 95 % of the runs", "worst run")


@command(app)
def sweep(
    terminal: Terminal,
    study: Annotated[Path, typer.Argument(help="A study: a YAML file with the key `sweep`.")],
    *,
    jobs: Annotated[int, typer.Option("-j", "--jobs", min=1, help="Runs at a time; one a processor by default.")] = (
        os.cpu_count() or 1
    ),
    scheduler: Annotated[
        str | None, typer.Option(metavar="ADDRESS", help="Run on the Dask cluster with this scheduler instead.")
    ] = None,
    retry: Annotated[bool, typer.Option("--retry", help="Run those again that failed.")] = False,
    one: Annotated[
        int | None, typer.Option("--run", metavar="N", help="That run alone again, with its whole record and report.")
    ] = None,
    limited: Limited,
    out: Out = None,
) -> Answer:
    """Run a scenario at many points into one data set; what is there already is not run again.

    Exit code 1 when fewer runs pass than the study asks for.
    """
    from orchestrator.batch.sweep.runs.cluster import Cluster
    from orchestrator.batch.sweep.runs.local import Local
    from orchestrator.batch.sweep.sweep import sweep as run

    if one is not None:
        return _again(terminal, study, one, out or Path("out") / f"{study.stem}-{one}")
    folder = out or Path("out") / study.stem
    with terminal.bar(study.stem) as move:
        runner = Local(jobs, limited.limits()) if scheduler is None else Cluster(scheduler)
        result = run(study, folder, runner, move, retry)
    document = result.document
    rows = [_row(one) for one in (document["passing"], *document["asked"])]
    failed = f"; {document['failed']:,} failed, see `reason`" if document["failed"] else ""
    sentence = f"{document['runs']:,} runs at {document['points']:,} points{failed}"
    shown: list[Listing | str] = [Listing(HEADERS, rows, document["title"]), *document["notes"], sentence]
    return Answer({**document, "out": str(folder)}, [*shown, f"written to {folder}"], result.passed)


def _row(asked: AskedDocument) -> tuple[str, ...]:
    share = "-" if asked["share"] is None else f"{asked['held']:,} of {asked['of']:,}"
    interval = "-" if asked["interval"] is None else "{:.3g} to {:.3g} %".format(*(100 * e for e in asked["interval"]))
    spread = asked["figure"]
    figures = "-" if spread is None else f"{spread['q05']:.4g} to {spread['q95']:.4g} {asked['unit']}".strip()
    return asked["text"], share, interval, figures, "-" if asked["worst"] is None else str(asked["worst"])


def _again(terminal: Terminal, study: Path, run: int, out: Path) -> Answer:
    """A run of the sweep by itself."""
    from orchestrator.batch.sweep.runs.preparation import prepared
    from orchestrator.batch.sweep.told.again import alone
    from orchestrator.results import check_target
    from orchestrator.scenario.results import document_of, write_run
    from orchestrator.scenario.run import HEADERS as CHECKED
    from orchestrator.scenario.run import run_scenario

    check_target(out, [study])
    with prepared(study) as ready, terminal.bar(study.stem) as move:
        result = run_scenario(alone(ready, run), progress=move, going_on=True)
        write_run(result, {}, out)
        return Answer(
            document_of(result, {}, out), [Listing(CHECKED, result.rows()), f"written to {out}"], result.passed
        )
