"""Commands on recordings: trace info, convert, plot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from orchestrator.cli.terminal import Answer, Json, Quiet, Terminal, Verbose, answered, facts

if TYPE_CHECKING:
    from orchestrator.formats import Layout

app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")

LayoutFrom = Annotated[Path | None, typer.Option("--layout", metavar="STUDY", help="Columns as this study file says.")]


Dbc = Annotated[Path | None, typer.Option("--dbc", metavar="FILE", help="Database of a CAN log: .dbc, .arxml, ...")]
Signals = Annotated[list[str] | None, typer.Option("--signal", help="Only this one of the database; repeatable.")]


@app.command("info")
def trace_info(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """What recordings hold: signals, units, time stamps; of a CAN log without --dbc its frames."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.information import about_trace

        documents = [about_trace(file, _layout(layout, dbc, signal)) for file in files]
        return Answer({"traces": documents}, [facts({**each, "found": []}) for each in documents])

    answered(work, as_json, quiet, verbose)


@app.command("convert")
def trace_convert(
    source: Annotated[Path, typer.Argument(help="A recording.")],
    target: Annotated[Path, typer.Argument(help="The file to write; its suffix names the format.")],
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Write a recording in another format; a CAN log becomes a trace, or a trace a log, with --dbc."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.formats.can_conversion import convert

        with terminal.bar(source.name) as move:
            done = convert(source, target, _layout(layout, dbc, signal), lambda share: move(share, ""))
        document = {"source": str(source), "target": str(target), done.what: done.count, "start": done.begin,
                    "notes": list(done.notes), "found": done.found}  # fmt: skip
        return Answer(document, done.lines(target))

    answered(work, as_json, quiet, verbose)


@app.command("plot")
def trace_plot(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    out: Annotated[Path, typer.Option("--out", help="The HTML file to write.")] = Path("out/traces.html"),
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Plot recordings into one HTML file."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator import formats
        from orchestrator.report.plot import plot_traces

        plot_traces([formats.read(file, _layout(layout, dbc, signal)) for file in files]).write(out)
        return Answer({"report": str(out)}, [f"plotted into {out}"])

    answered(work, as_json, quiet, verbose)


def _layout(study: Path | None, dbc: Path | None, signals: list[str] | None) -> Layout:
    """The layout that a study file gives, with the database and the signals of the command."""
    from orchestrator.formats import Layout

    layout = Layout()
    if study is not None:
        from identification.commands import layout_of

        layout = layout_of(study)
    if dbc is not None:
        layout = replace(layout, database=dbc)
    return layout if signals is None else replace(layout, signals=signals)
