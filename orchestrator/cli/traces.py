"""Commands on recordings: trace info, convert, plot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from orchestrator.cli.terminal import Answer, Json, Quiet, Terminal, Verbose, answered, facts

app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")

LayoutFrom = Annotated[Path | None, typer.Option("--layout", metavar="STUDY", help="Columns as this study file says.")]


@app.command("info")
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
        return Answer({"traces": documents}, [facts(document) for document in documents])

    answered(work, as_json, quiet, verbose)


@app.command("convert")
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

    answered(work, as_json, quiet, verbose)


@app.command("plot")
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

    answered(work, as_json, quiet, verbose)


def _layout(study: Path | None) -> Any:
    """The layout that a study file gives, None without one."""
    if study is None:
        return None
    from identification.commands import layout_of

    return layout_of(study)
