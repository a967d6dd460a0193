"""Commands on recordings: trace info, convert, plot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from orchestrator.cli.terminal import Answer, Json, Quiet, Terminal, Verbose, answered, facts

if TYPE_CHECKING:
    from orchestrator.formats import Layout

Result = TypeVar("Result")
app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")

LayoutFrom = Annotated[Path | None, typer.Option("--layout", metavar="STUDY", help="Columns as this study file says.")]
Dbc = Annotated[Path | None, typer.Option("--dbc", metavar="FILE", help="Database of a CAN log: .dbc, .arxml, ...")]
Signals = Annotated[list[str] | None, typer.Option("--signal", help="Only this one of the database; repeatable.")]
Channel = Annotated[int | None, typer.Option("--channel", min=0, help="Only frames of this channel of a CAN log.")]


@app.command("info")
def trace_info(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    channel: Channel = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """What recordings hold: signals, units, time stamps; of a CAN log without --dbc its frames."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.info import about_trace

        chosen = _layout(layout, dbc, signal, channel)
        documents = [_with_bar(terminal, file, lambda file, told: about_trace(file, chosen, told)) for file in files]
        return Answer({"traces": documents}, [facts({**each, "found": []}) for each in documents])

    answered(work, as_json, quiet, verbose)


@app.command("convert")
def trace_convert(
    source: Annotated[Path, typer.Argument(help="A recording.")],
    target: Annotated[Path, typer.Argument(help="The file to write; its suffix names the format.")],
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    channel: Channel = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Write a recording in another format; a CAN log becomes a trace, or a trace a log, with --dbc."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.formats.can_conversion import convert

        chosen = _layout(layout, dbc, signal, channel)
        done = _with_bar(terminal, source, lambda file, told: convert(file, target, chosen, told))
        document = {
            "source": str(source),
            "target": str(target),
            done.what: done.count,
            "start": done.begin,
            "notes": list(done.notes),
            "found": done.found,
        }
        return Answer(document, done.lines(target))

    answered(work, as_json, quiet, verbose)


@app.command("plot")
def trace_plot(
    files: Annotated[list[Path], typer.Argument(help="Recordings.")],
    out: Annotated[Path, typer.Option("--out", help="The HTML file to write.")] = Path("out/traces.html"),
    layout: LayoutFrom = None,
    dbc: Dbc = None,
    signal: Signals = None,
    channel: Channel = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Plot recordings into one HTML file."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator import formats
        from orchestrator.report.plot import plot_traces

        chosen = _layout(layout, dbc, signal, channel)
        recordings = [_with_bar(terminal, file, lambda file, told: formats.read(file, chosen, told)) for file in files]
        plot_traces(recordings).write(out)
        return Answer({"report": str(out)}, [f"plotted into {out}"])

    answered(work, as_json, quiet, verbose)


def _with_bar(terminal: Terminal, file: Path, work: Callable[[Path, Callable[[float], None]], Result]) -> Result:
    """What the work on a file gives, while a bar shows how much of it is read."""
    with terminal.bar(file.name) as move:
        return work(file, lambda share: move(share, ""))


def _layout(study: Path | None, dbc: Path | None, signals: list[str] | None, channel: int | None) -> Layout:
    """The layout that a study file gives, with the database and the signals of the command."""
    from orchestrator.formats import Layout

    layout = Layout()
    if study is not None:
        from identification.calibrate import layout_of

        layout = layout_of(study)
    if dbc is not None:
        layout = replace(layout, database=dbc)
    if channel is not None:
        layout = replace(layout, channel=channel)
    return layout if signals is None else replace(layout, signals=signals)
