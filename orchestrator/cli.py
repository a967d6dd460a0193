"""The command line. Each command turns its arguments into one call, and its result into a table or a JSON document.

The identification package is imported inside its commands: nothing else here depends on it.
"""

from __future__ import annotations

import gc
import json
import logging
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, NoReturn

import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.logging import RichHandler
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from fmus.errors import InputError, ServotwinError
from orchestrator.interrupts import Interrupts, whole
from orchestrator.results import check_target
from orchestrator.stdout import stdout_kept

WIDE = 120  # columns of output that goes to no terminal
OUT = Console(highlight=False, markup=False, width=None if sys.stdout.isatty() else WIDE)
ERR = Console(stderr=True, highlight=False, markup=False)
app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False,
                  help="Calibrated digital twins of servo-driven mechanisms as FMUs.")  # fmt: skip
trace_app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")
app.add_typer(trace_app, name="trace")

Json = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Say nothing but errors.")]
Verbose = Annotated[int, typer.Option("-v", "--verbose", count=True, help="Say more; -vv shows tracebacks.")]
Out = Annotated[Path | None, typer.Option("--out", help="Folder for the results.")]
LayoutFrom = Annotated[Path | None, typer.Option("--layout", metavar="STUDY", help="Columns as this study file says.")]
Data = Annotated[Path | None, typer.Option("--data", help="Folder (or file) of recordings.")]
Isolate = Annotated[bool, typer.Option("--isolate", help="Run FMUs given as files in processes of their own.")]
Patience = Annotated[
    float | None,
    typer.Option(metavar="SECONDS", help="With --isolate: how long an FMU may take for an answer; 60 by default."),
]


@dataclass
class Answer:
    """What a command has to say: a document for machines, tables and lines for people, and whether all held.

    Attributes:
        interrupted: where an interrupt left something that is worth to be kept, a line about it.
    """

    document: dict[str, Any]
    shown: Sequence[Table | str] = ()
    held: bool = True
    interrupted: str = ""


@dataclass
class Terminal:
    """How to talk: chosen by --json, -q and -v."""

    json: bool = False
    quiet: bool = False
    verbose: int = 0

    @contextmanager
    def bar(self, label: str) -> Iterator[Callable[[float, str], None]]:
        """A progress bar on a terminal: the function that is given moves it to a fraction, with a remark."""
        columns = (
            TextColumn("{task.description}", markup=False),
            BarColumn(),
            TextColumn("{task.fields[remark]}", markup=False),
            TimeElapsedColumn(),
        )
        hidden = self.quiet or self.json or not ERR.is_terminal
        with Progress(*columns, console=ERR, transient=True, disable=hidden) as progress:
            task = progress.add_task(label, total=1.0, remark="")

            def move(fraction: float, remark: str) -> None:
                progress.update(task, completed=fraction, remark=remark)

            yield move


def main() -> None:
    """Entry point of `servotwin`."""
    try:
        app()
    finally:
        gc.freeze()  # Python would search all that the libraries have made for garbage, for half a second


def _answer(work: Callable[[Terminal], Answer], as_json: bool, quiet: bool, verbose: int) -> None:
    """Do the work, show the answer, and leave with the exit code: 0, 1 (did not hold), 2, 3 or 130."""
    level = logging.ERROR if quiet else (logging.WARNING, logging.INFO, logging.DEBUG)[min(verbose, 2)]
    logging.basicConfig(level=level, format="%(message)s", force=True,
                        handlers=[RichHandler(console=ERR, show_time=False, show_path=False)])  # fmt: skip
    interrupts = Interrupts()
    try:
        with interrupts, stdout_kept():
            answer = work(Terminal(as_json, quiet, verbose))
    except ServotwinError as error:
        if interrupts.requested:
            _interrupted()
        _fail(error, error.exit_code, verbose)
    except KeyboardInterrupt:
        _interrupted()
    except OSError as error:
        _fail(InputError(error.filename or "file", error.strerror or str(error), "check the path"), 2, verbose)
    if as_json:
        sys.stdout.write(json.dumps(answer.document, indent=2, allow_nan=False) + "\n")
    elif not quiet:
        for each in answer.shown:
            OUT.print(each, soft_wrap=isinstance(each, str))
    if answer.interrupted:
        _interrupted(answer.interrupted)
    raise typer.Exit(0 if answer.held else 1)


def _interrupted(line: str = "interrupted") -> NoReturn:
    ERR.print(line, soft_wrap=True)
    raise typer.Exit(130) from None


def _fail(error: ServotwinError, code: int, verbose: int) -> NoReturn:
    if verbose >= 2:
        ERR.print_exception()
    ERR.print(f"servotwin: {error}", style="red", soft_wrap=True, markup=False)
    raise typer.Exit(code) from None


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

    _answer(work, as_json, quiet, verbose)


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
        from orchestrator import accounts
        from orchestrator.run_results import document_of, interruption, rows_of, write_run
        from orchestrator.scenario import Keeping, ScenarioInterrupted, parse_override, run_scenario

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
                result = run_scenario(scenario, overrides, lambda fraction: move(fraction, ""), keeping=keeping,
                                      isolation=isolation)  # fmt: skip
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

    _answer(work, as_json, quiet, verbose)


@app.command()
def test(
    paths: Annotated[
        list[Path] | None, typer.Argument(help="Scenario files and folders; scenarios/ by default.")
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
    """Run all scenarios under the paths: the regression suite; exit code 1 when one fails."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.suite import Verdict, find_scenarios, run_suite, write_junit

        isolation = _isolation(isolate, patience)
        files = find_scenarios(paths or [Path("scenarios")])
        table = Table("scenario", "verdict", "time [s]", "why")
        finished = 0
        with terminal.bar("scenarios") as move:

            def done(verdict: Verdict) -> None:
                nonlocal finished
                finished += 1
                move(finished / len(files), verdict.file.stem)

            verdicts = run_suite(files, out or Path("out/test"), jobs, done, isolation)
        if junit is not None:
            write_junit(verdicts, junit)
        for each in verdicts:
            table.add_row(str(each.file), "passed" if each.passed else "FAILED", f"{each.seconds:.1f}", each.error)
        held = all(each.passed for each in verdicts)
        document = {"passed": held, "scenarios": [
            {"file": str(each.file), "passed": each.passed, "seconds": round(each.seconds, 3), "error": each.error,
             "result": each.document} for each in verdicts]}  # fmt: skip
        return Answer(document, [table], held)

    _answer(work, as_json, quiet, verbose)


@app.command()
def calibrate(
    study: Annotated[Path, typer.Argument(help="A study file.")],
    data: Data = None,
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Traces to calibrated FMUs, parameters.ssv, summary.json and report.html."""

    def work(terminal: Terminal) -> Answer:
        from identification.commands import calibrate_study

        folder = out or Path("out") / study.stem
        with terminal.bar(study.stem) as move:
            document = calibrate_study(study, data, folder, move)
        shows = next((each for key, each in _RESULTS.items() if key in document), _parameters)
        shown: list[Table | str] = [shows(document), *_fits(document), *_warnings(document)]
        fmus = f"FMUs in {folder / 'fmus'}, " if (folder / "fmus").is_dir() else ""
        return Answer(document, [*shown, f"{fmus}report in {folder / 'report.html'}"])

    _answer(work, as_json, quiet, verbose)


@app.command()
def validate(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="A folder that `calibrate` wrote.")],
    data: Annotated[Path, typer.Option("--data", help="Folder (or file) of other recordings.")],
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Judge a calibrated result on other traces; exit code 1 when it misses the study's target."""

    def work(terminal: Terminal) -> Answer:
        from identification.commands import validate_result

        target = out or folder / "validation"
        with terminal.bar("validating") as move:
            document = validate_result(folder, data, target, move)
        shown = [*_fits(document), *_warnings(document), f"report in {target / 'report.html'}"]
        return Answer(document, shown, document["held"])

    _answer(work, as_json, quiet, verbose)


@trace_app.command("info")
def trace_info(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    layout: LayoutFrom = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """What recordings hold: signals, units, time stamps."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.information import about_trace

        documents = [about_trace(file, _layout(layout)) for file in files]
        return Answer({"traces": documents}, [_facts(document) for document in documents])

    _answer(work, as_json, quiet, verbose)


@trace_app.command("convert")
def trace_convert(
    source: Annotated[Path, typer.Argument(help="A recording.")],
    target: Annotated[Path, typer.Argument(help="The file to write; its suffix names the format.")],
    layout: LayoutFrom = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Write a recording in another format."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator import formats

        recording = formats.read(source, _layout(layout))
        formats.write(recording.trace, target)
        document = {"source": str(source), "target": str(target), "samples": len(recording.trace),
                    "stamps": str(recording.stamps)}  # fmt: skip
        return Answer(document, [f"{target}: {recording.stamps}"])

    _answer(work, as_json, quiet, verbose)


@trace_app.command("plot")
def trace_plot(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    out: Annotated[Path, typer.Option("--out", help="The HTML file to write.")] = Path("out/traces.html"),
    layout: LayoutFrom = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Plot recordings into one HTML file."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator import formats
        from orchestrator.report.plot import plot_traces

        plot_traces([formats.read(file, _layout(layout)) for file in files]).write(out)
        return Answer({"report": str(out)}, [f"plotted into {out}"])

    _answer(work, as_json, quiet, verbose)


@app.command()
def info(
    file: Annotated[Path, typer.Argument(help="An FMU, a trace, or a folder of results.")],
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """What an FMU, a trace or a result holds."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.information import about

        document = about(file)
        return Answer(document, [_facts(document)])

    _answer(work, as_json, quiet, verbose)


def _isolation(isolate: bool, patience: float | None) -> Any:
    """How FMUs are isolated, None when they are not."""
    from orchestrator.isolation import Isolation

    if isolate:
        return Isolation() if patience is None else Isolation(patience)
    if patience is not None:
        raise InputError("--patience", "is for isolated FMUs", "give --isolate, too")
    return None


def _layout(study: Path | None) -> Any:
    """The layout that a study file gives, None without one."""
    if study is None:
        return None
    from identification.commands import layout_of

    return layout_of(study)


def _parameters(document: dict[str, Any]) -> Table:
    from identification.calibration_report import parameter_rows

    headers, rows = parameter_rows(document)
    table = Table(title=document["title"], box=SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for number, header in enumerate(headers):
        text = number in (0, len(headers) - 1)
        table.add_column(header, justify="left" if text else "right", overflow="fold", no_wrap=number == 0)
    for row in rows:
        table.add_row(*map(_cell, headers, row))
    return table


def _cell(header: str, value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{2 if header.startswith('±') else 5}g}"
    return "-" if value is None else str(value)


def _models(document: dict[str, Any]) -> Table:
    """Order and median FIT of each output, on fitted and on unseen traces, of every model of a subspace study."""
    outputs = list(document["fit"]["train"]["outputs"])
    sides = {"fitted": "train", "unseen": "validation"}
    table = Table("model", "order", *(f"{output}, {side}" for side in sides for output in outputs), title="median FIT")
    for name, model in document["models"].items():
        judged = [model["fit"][group] for group in sides.values()]
        values = [_figure(each["outputs"][output] if each else None) for each in judged for output in outputs]
        table.add_row(name, str(model["order"]), *values)
    return table


def _claims(document: dict[str, Any]) -> Table:
    table = Table("claim", "outcome", "comparisons", title=document["title"])
    for claim in document["claims"]:
        held = sum(each["held"] for each in claim["comparisons"])
        table.add_row(claim["statement"], claim["outcome"], f"{held} of {len(claim['comparisons'])}")
    return table


_RESULTS = {"models": _models, "claims": _claims}  # what tells a summary's kind, and its table


def _fits(document: dict[str, Any]) -> list[str]:
    lines = []
    for group, judged in document["fit"].items():
        if group == "compared":
            lines += [f"median FIT of {name}: {_figure(each['median'])}" for name, each in judged.items()]
        elif judged is not None:
            lines.append(f"median FIT, {group}: {_figure(judged['median'])} ({len(judged['traces'])} traces)")
            outputs = judged.get("outputs", {})
            lines += [f"  {name}: {_figure(value)}" for name, value in outputs.items() if len(outputs) > 1]
    return lines


def _figure(value: float | None) -> str:
    return "none" if value is None else f"{value:.4f}"


def _warnings(document: dict[str, Any]) -> list[str]:
    return [f"warning: {warning}" for warning in document["warnings"]]


def _statistics(rows: Sequence[tuple[str, int, float, float, float]], headers: Sequence[str]) -> Table:
    table = Table(*headers, title="Step statistics, all cases")
    for name, calls, seconds, microseconds, share in rows:
        table.add_row(name, f"{calls:,}", f"{seconds:.3g}", f"{microseconds:.3g}", f"{share:.1f}")
    return table


def _facts(document: dict[str, Any]) -> Table:
    """A document of one level of lists as a two-column table."""
    table = Table(show_header=False, title=str(document.get("name", "")))
    for key, value in document.items():
        if isinstance(value, list):
            for number, each in enumerate(value):
                cells = each.values() if isinstance(each, dict) else [each]
                table.add_row("" if number else key, "  ".join(str(cell) for cell in cells if cell not in (None, "")))
        elif key != "name":
            table.add_row(key, str(value))
    return table
