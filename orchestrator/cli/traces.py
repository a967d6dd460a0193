"""Commands on recordings: trace info, convert, plot."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fmus.errors import InputError
from orchestrator.cli.tables import LAYOUTS
from orchestrator.cli.terminal import Answer, Listing, Terminal, command, facts
from orchestrator.display.block import block

if TYPE_CHECKING:
    from orchestrator.formats import Layout
    from orchestrator.info import InfoDocument
    from orchestrator.progress import Progress

Read = TypeVar("Read")
app = typer.Typer(no_args_is_help=True, help="Look at recordings, convert and plot them.")

Files = Annotated[list[Path], typer.Argument(help="Recordings.")]


@dataclass(frozen=True)
class ReadingOptions:
    """How recordings are read."""

    layout: Annotated[
        Path | None,
        typer.Option("--layout", metavar="FILE", help="As this study says, or a file with `layout:` alone."),
    ] = None
    time: Annotated[
        str | None, typer.Option("--time", metavar="COLUMN", help="The time's column: its name, or its number from 0.")
    ] = None
    columns: Annotated[
        list[str] | None,
        typer.Option(
            "--columns", metavar="SIGNAL=COLUMN", help="Which column is a signal, by name or number; repeatable."
        ),
    ] = None
    dbc: Annotated[
        list[str] | None,
        typer.Option(
            "--dbc",
            metavar="[CHANNEL=]FILE",
            help="Database of a CAN log: .dbc, .arxml, ...; repeatable, also for one channel: 0=FILE, can1=FILE.",
        ),
    ] = None
    encoding: Annotated[
        str | None, typer.Option("--encoding", help="Of text, or of a database: utf-8, gbk, cp1252, ...")
    ] = None
    signal: Annotated[list[str] | None, typer.Option("--signal", help="Only this one of the database; repeatable.")] = (
        None
    )
    channel: Annotated[
        int | None, typer.Option("--channel", min=0, help="Only frames of this channel of a CAN log.")
    ] = None
    sender: Annotated[
        str | None,
        typer.Option(
            "--source", metavar="ADDRESS", help="Only this sender (J1939, CANopen), as 0x03, or `any` for J1939 by PGN."
        ),
    ] = None

    def chosen(self) -> Layout:
        """The layout that a file gives, with what the command says over it."""
        from orchestrator.can.database.sources import parsed
        from orchestrator.formats import Layout

        layout = replace(Layout() if self.layout is None else _layout_of(self.layout), texts=True)
        said = {
            "time": None if self.time is None else _column(self.time),
            "columns": None if self.columns is None else dict(map(_assignment, self.columns)),
            "database": parsed(self.dbc) if self.dbc else None,
            "encoding": self.encoding,
            "channel": self.channel,
            "signals": self.signal,
            "source": None if self.sender is None else _address(self.sender),
        }
        return replace(layout, **{key: value for key, value in said.items() if value is not None})  # type: ignore[arg-type]


@command(app, "info")
def trace_info(terminal: Terminal, files: Files, reading: ReadingOptions) -> Answer:
    """What recordings hold: signals, units, time stamps; of a CAN log without --dbc its frames."""
    from orchestrator.info import about_trace

    layout = reading.chosen()
    documents = [_with_bar(terminal, file, lambda file, told: about_trace(file, layout, told)) for file in files]
    return Answer({"traces": documents}, [shown for document in documents for shown in described(document)])


@command(app, "convert")
def trace_convert(
    terminal: Terminal,
    source: Annotated[Path, typer.Argument(help="A recording.")],
    target: Annotated[Path, typer.Argument(help="The file to write; its suffix names the format.")],
    reading: ReadingOptions,
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
    reading: ReadingOptions,
) -> Answer:
    """Plot recordings into one HTML file."""
    from orchestrator import formats
    from orchestrator.report.plot import plot_traces

    layout = reading.chosen()
    recordings = [_with_bar(terminal, file, lambda file, told: formats.read(file, layout, told)) for file in files]
    for recording in recordings:
        for note in recording.notes:
            terminal.say(f"{recording.path}: {note}")
    plot_traces(recordings).write(out)
    return Answer({"report": str(out)}, [f"plotted into {out}"])


def _address(text: str) -> int | str:
    """The address of a sender."""
    try:
        address = text if text == "any" else int(text, 0)
    except ValueError:
        address = -1
    if address != "any" and address not in range(256):
        raise InputError(f"--source {text}", "is no address", "give 0 to 255, as 0x03 or 3, or any")
    return address


def _with_bar(terminal: Terminal, file: Path, work: Callable[[Path, Progress], Read]) -> Read:
    """What the work on a file gives, while a bar shows how much of it is read."""
    with terminal.bar(file.name) as move:
        return work(file, move)


def described(document: InfoDocument) -> Iterator[Listing | str]:
    """What is known of a recording, its first rows as they were understood, and the block that has it read so."""
    apart = ("found", "rows", "layout", *(["signals"] if "rows" in document else []))
    yield facts({key: value for key, value in document.items() if key not in apart})
    if "rows" in document:
        yield _table("signals", document["signals"], ("name", "unit", "min", "max", "missing", "infinite", "texts"))
        yield _table("first rows", document["rows"])
    if "layout" in document:
        yield block({"layout": document["layout"]})


def _table(title: str, entries: object, headers: Sequence[str] = ()) -> Listing:
    rows = entries if isinstance(entries, list) else []
    names = headers or [name for row in rows[:1] for name in row]
    return Listing(names, [[_cell(row.get(name)) for name in names] for row in rows], title)


def _cell(value: object) -> str:
    return "" if value is None else f"{value:.9g}" if isinstance(value, float) else str(value)


def _column(text: str) -> int | str:
    return int(text) if text.isdecimal() else text


def _assignment(text: str) -> tuple[str, int | str]:
    name, _, column = text.partition("=")
    if not column and isinstance(_column(name), int):
        raise InputError(f"--columns {text}", "names no signal", f"write --columns SIGNAL={text}")
    return name, _column(column or name)


def _layout_of(file: Path) -> Layout:
    from orchestrator.yaml_file import keys, load

    if keys(file) == ["layout"]:
        from orchestrator.formats.schema import LayoutFileBlock

        return load(file, LayoutFileBlock).layout.layout(file.parent)
    knows = next((LAYOUTS[key] for key in keys(file) if key in LAYOUTS), None)
    if knows is None:
        raise InputError(file, "tells no layout of recordings", f"give a file with {' or '.join(('layout', *LAYOUTS))}")
    return knows(file)
