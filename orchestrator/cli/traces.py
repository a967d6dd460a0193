"""Commands on recordings: trace info, convert, plot."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fmus.errors import InputError
from orchestrator.cli.tables import LAYOUTS
from orchestrator.cli.terminal import Answer, Terminal, command, facts

if TYPE_CHECKING:
    from orchestrator.formats import Layout
    from orchestrator.progress import Progress

Read = TypeVar("Read")
app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")

Files = Annotated[list[Path], typer.Argument(help="Recordings.")]


@dataclass(frozen=True)
class Reading:
    """How recordings are read."""

    layout: Annotated[
        Path | None, typer.Option("--layout", metavar="STUDY", help="Columns as this study file says.")
    ] = None
    dbc: Annotated[
        Path | None, typer.Option("--dbc", metavar="FILE", help="Database of a CAN log: .dbc, .arxml, ...")
    ] = None
    signal: Annotated[list[str] | None, typer.Option("--signal", help="Only this one of the database; repeatable.")] = (
        None
    )
    channel: Annotated[
        int | None, typer.Option("--channel", min=0, help="Only frames of this channel of a CAN log.")
    ] = None

    def chosen(self) -> Layout:
        """The layout that a study file gives, with the database and the signals of the command."""
        from orchestrator.formats import Layout

        layout = Layout() if self.layout is None else _layout_of(self.layout)
        return replace(
            layout,
            database=layout.database if self.dbc is None else self.dbc,
            channel=layout.channel if self.channel is None else self.channel,
            signals=layout.signals if self.signal is None else self.signal,
        )


@command(app, "info")
def trace_info(terminal: Terminal, files: Files, reading: Reading) -> Answer:
    """What recordings hold: signals, units, time stamps; of a CAN log without --dbc its frames."""
    from orchestrator.info import about_trace

    layout = reading.chosen()
    documents = [_with_bar(terminal, file, lambda file, told: about_trace(file, layout, told)) for file in files]
    return Answer({"traces": documents}, [facts({**document, "found": []}) for document in documents])


@command(app, "convert")
def trace_convert(
    terminal: Terminal,
    source: Annotated[Path, typer.Argument(help="A recording.")],
    target: Annotated[Path, typer.Argument(help="The file to write; its suffix names the format.")],
    reading: Reading,
) -> Answer:
    """Write a recording in another format; a CAN log becomes a trace, or a trace a log, with --dbc."""
    from orchestrator.formats.can_conversion import convert

    layout = reading.chosen()
    done = _with_bar(terminal, source, lambda file, told: convert(file, target, layout, told))
    document = {
        "source": str(source),
        "target": str(target),
        done.what: done.count,
        "start": done.begin,
        "notes": list(done.notes),
        "found": done.found,
    }
    return Answer(document, done.lines(target))


@command(app, "plot")
def trace_plot(
    terminal: Terminal,
    files: Files,
    *,
    out: Annotated[Path, typer.Option("--out", help="The HTML file to write.")] = Path("out/traces.html"),
    reading: Reading,
) -> Answer:
    """Plot recordings into one HTML file."""
    from orchestrator import formats
    from orchestrator.report.plot import plot_traces

    layout = reading.chosen()
    recordings = [_with_bar(terminal, file, lambda file, told: formats.read(file, layout, told)) for file in files]
    plot_traces(recordings).write(out)
    return Answer({"report": str(out)}, [f"plotted into {out}"])


def _with_bar(terminal: Terminal, file: Path, work: Callable[[Path, Progress], Read]) -> Read:
    """What the work on a file gives, while a bar shows how much of it is read."""
    with terminal.bar(file.name) as move:
        return work(file, move)


def _layout_of(file: Path) -> Layout:
    from orchestrator.yaml_file import keys

    knows = next((LAYOUTS[key] for key in keys(file) if key in LAYOUTS), None)
    if knows is None:
        raise InputError(file, "tells no layout of recordings", f"give a file with {' or '.join(LAYOUTS)}")
    return knows(file)
