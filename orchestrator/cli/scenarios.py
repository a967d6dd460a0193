"""Commands that make FMUs and run scenarios: build, run, test; and info."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from fmus.errors import InputError
from orchestrator.cli.terminal import Answer, Json, Out, Quiet, Terminal, Verbose, answered, facts
from orchestrator.interrupts import whole
from orchestrator.results import check_target

app = typer.Typer()

Isolate = Annotated[bool, typer.Option("--isolate", help="Run FMUs given as files in processes of their own.")]
Patience = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="With --isolate: how long an FMU may take for an answer; 60 by default."),
]


@app.command()
def build(
    models: Annotated[
        list[str] | None, typer.Argument(help="Models of the library, or model files; all by default.")
    ] = None,
    target: Annotated[
        str | None,
        typer.Option(help="native: generated C (default where there is a C compiler); python: run by pythonfmu."),
    ] = None,
    fmi: Annotated[int, typer.Option(help="FMI version, 2 or 3.")] = 2,
    platform: Annotated[
        list[str] | None, typer.Option(help="Of native FMUs: host, all, x86_64-linux, aarch64-darwin, ...; repeatable.")
    ] = None,
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Build FMUs from model files."""

    def work(terminal: Terminal) -> Answer:
        from fmus import library
        from fmus.packaging import targets

        chosen = [library.find(name) for name in models or library.names()]
        packaging = target or targets.preferred()
        folder = out or Path("out/fmus")
        table = Table("model", "FMU", "description")
        with terminal.bar("building") as move:
            for number, model in enumerate(chosen):
                path = folder / f"{model.name}.fmu"
                targets.build(packaging, model, path, fmi=fmi, platforms=platform or ("host",))
                table.add_row(model.name, str(path), model.description)
                move((number + 1) / len(chosen), model.name)
        files = {model.name: str(folder / f"{model.name}.fmu") for model in chosen}
        return Answer({"fmus": files, "target": packaging, "fmi": fmi}, [table])

    answered(work, as_json, quiet, verbose)


@app.command()
def run(
    scenario: Annotated[Path, typer.Argument(help="A scenario file.")],
    out: Out = None,
    set_: Annotated[
        list[str] | None, typer.Option("--set", metavar="COMP.PARAM=VALUE", help="Over the file's values.")
    ] = None,
    stride: Annotated[int, typer.Option(min=1, metavar="N", help="Record, and judge, every N-th step only.")] = 1,
    stream: Annotated[bool, typer.Option("--stream", help="Write the record to its file while running.")] = False,
    isolate: Isolate = False,
    patience: Patience = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Run one scenario; exit code 1 when an expectation fails."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.scenario import accounts
        from orchestrator.scenario.results import document_of, interruption, rows_of, write_run
        from orchestrator.scenario.run import Keeping, ScenarioInterrupted, parse_override, run_scenario

        overrides = dict(parse_override(each) for each in set_ or [])
        isolation = _isolation(isolate, patience)
        folder = out or Path("out") / scenario.stem
        check_target(folder)
        near = next(each for each in folder.resolve().parents if each.is_dir())  # on the disk that the result goes to
        with (
            terminal.bar(scenario.stem) as move,
            tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=near) as aside,
        ):
            keeping = Keeping(stride, Path(aside) if stream else None)
            try:
                result = run_scenario(
                    scenario, overrides, lambda fraction: move(fraction, ""), keeping=keeping, isolation=isolation
                )
            except ScenarioInterrupted as stop:
                result = stop.result
            with whole():
                write_run(result, overrides, folder)
        document = document_of(result, overrides, folder)
        if result.interrupted:
            line = f"{interruption(result)}; the result up to there is in {folder}"
            return Answer(document, held=False, interrupted=line)
        checks = Table("case", "expectation", "held", "found", title=result.block.title)
        for row in rows_of(result):
            checks.add_row(*row)
        shown: list[Table | str] = [checks, f"results in {folder}"]
        if verbose:
            shown[1:1] = [_statistics(accounts.rows_of(result), accounts.HEADERS), accounts.sentence_of(result)]
        return Answer(document, shown, result.passed)

    answered(work, as_json, quiet, verbose)


@app.command()
def test(
    paths: Annotated[
        list[Path] | None, typer.Argument(help="Scenarios, studies with claims, and folders; scenarios/ by default.")
    ] = None,
    jobs: Annotated[int, typer.Option("-j", "--jobs", min=1, help="Scenarios run side by side.")] = 1,
    junit: Annotated[Path | None, typer.Option(help="JUnit XML file to write.")] = None,
    out: Out = None,
    isolate: Isolate = False,
    patience: Patience = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Run all scenarios, and all studies that state claims, under the paths: the regression suite.

    Exit code 1 when an expectation fails, or a claim does not come out as its study states.
    """

    def work(terminal: Terminal) -> Answer:
        from identification.calibrate import judge_claims
        from orchestrator.batch.procedure import outputs_of
        from orchestrator.batch.suite import Verdict, find_scenarios, run_suite, write_junit

        isolation = _isolation(isolate, patience)
        files = find_scenarios(paths or [Path("scenarios")])
        table = Table("scenario", "verdict", "time [s]", "why")
        finished = 0
        with terminal.bar("scenarios") as move:

            def done(verdict: Verdict) -> None:
                nonlocal finished
                finished += 1
                move(finished / len(files), verdict.file.stem)

            verdicts = run_suite(files, out or Path("out/test"), jobs, judge_claims, done, isolation)
        if junit is not None:
            write_junit(verdicts, junit)
        for each in verdicts:
            table.add_row(str(each.file), "passed" if each.passed else "FAILED", f"{each.seconds:.1f}", each.error)
        shown: list[Table | str] = [table]
        if verbose:
            shown[:0] = [said for each in verdicts if (said := outputs_of(each.document))]
        held = all(each.passed for each in verdicts)
        document = {
            "passed": held,
            "scenarios": [
                {
                    "file": str(each.file),
                    "passed": each.passed,
                    "seconds": round(each.seconds, 3),
                    "error": each.error,
                    "result": each.document,
                }
                for each in verdicts
            ],
        }
        return Answer(document, shown, held)

    answered(work, as_json, quiet, verbose)


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="An FMU, a trace, or a folder of results.")],
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """What an FMU, a trace or a result holds."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.info import about

        document = about(file)
        return Answer(document, [facts(document)])

    answered(work, as_json, quiet, verbose)


def _isolation(isolate: bool, patience: float | None) -> Any:
    """How FMUs are isolated, None when they are not."""
    from orchestrator.fmi.isolation import Isolation

    if isolate:
        return Isolation() if patience is None else Isolation(patience)
    if patience is not None:
        raise InputError("--patience", "is for isolated FMUs", "give --isolate, too")
    return None


def _statistics(rows: Sequence[tuple[str, int, float, float, float]], headers: Sequence[str]) -> Table:
    table = Table(*headers, title="Step statistics, all cases")
    for name, calls, seconds, microseconds, share in rows:
        table.add_row(name, f"{calls:,}", f"{seconds:.3g}", f"{microseconds:.3g}", f"{share:.1f}")
    return table
