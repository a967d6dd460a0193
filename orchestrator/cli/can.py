"""Commands on a CAN bus: can record, replay, gateway, database."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from fmus.errors import InputError
from fmus.json_document import document_of
from orchestrator.cli.terminal import Answer, Listing, Terminal, command

if TYPE_CHECKING:
    from orchestrator.can.live.bus import BusSettings
    from orchestrator.can.live.manifest import RecordingManifest

T = TypeVar("T")

app = typer.Typer(no_args_is_help=True, help="Record a CAN bus, play back onto it, couple systems to it.")

Interfaces = Annotated[
    list[str], typer.Option("--interface", help="python-can's name: socketcan, slcan, ...; one, or for each channel.")
]
Channels = Annotated[
    list[str], typer.Option("--channel", help="What the interface calls the bus: can0, ...; repeatable.")
]
Names = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Message of --dbc, or identifier as 123, 0x123; repeatable.")
]
Dbc = Annotated[
    list[str] | None,
    typer.Option("--dbc", metavar="[CHANNEL=]FILE", help="Database of the bus: .dbc, .arxml, ...; repeatable."),
]
Condition = Annotated[
    str | None, typer.Option(metavar="'SIGNAL > X'", help="Of a signal of --dbc, in its unit; or <, <=, >=, ==, !=.")
]
Safe = Annotated[list[str] | None, typer.Option(metavar="SIGNAL=X", help="Sent last, however it ends; repeatable.")]
EndWith = Annotated[
    list[str] | None, typer.Option(metavar="ID#DATA", help="A frame that is sent last, as 123#00FF; repeatable.")
]
Encoding = Annotated[str | None, typer.Option("--encoding", help="Of the databases' text: utf-8, gbk, cp1252, ...")]


@dataclass(frozen=True)
class Adapter:
    """How the adapter of a bus is set."""

    bitrate: Annotated[
        list[int] | None, typer.Option("--bitrate", min=1, metavar="BIT/S", help="As the adapter is set by default.")
    ] = None
    fd: Annotated[bool, typer.Option("--fd", help="The bus has CAN FD frames.")] = False
    data_bitrate: Annotated[
        int | None, typer.Option("--data-bitrate", min=1, metavar="BIT/S", help="Of CAN FD frames that switch.")
    ] = None
    option: Annotated[
        list[str] | None, typer.Option("--option", metavar="NAME=VALUE", help="For this interface only; repeatable.")
    ] = None

    def buses(self, interfaces: Sequence[str], channels: Sequence[str]) -> tuple[BusSettings, ...]:
        """The bus behind each channel.

        Raises:
            InputError: interfaces or bit rates are neither one nor as many as channels, or not possible.
        """
        from orchestrator.can.live.bus import BusSettings, parse_option

        options, count = dict(map(parse_option, self.option or [])), len(channels)
        rates: Sequence[int | None] = self.bitrate or [None]
        interfaces, rates = for_each("--interface", interfaces, count), for_each("--bitrate", rates, count)
        return tuple(
            BusSettings(interface, channel, rate, self.fd, self.data_bitrate, options)
            for interface, channel, rate in zip(interfaces, channels, rates, strict=True)
        )


def for_each(option: str, values: Sequence[T], count: int) -> Sequence[T]:
    """A value for each channel."""
    if len(values) not in (1, count):
        raise InputError(option, f"is given {len(values)} times for {count} of --channel", "give it once, or for each")
    return values if len(values) == count else [*values] * count


@command(app)
def record(
    terminal: Terminal,
    interface: Interfaces,
    channel: Channels,
    adapter: Adapter,
    dbc: Dbc = None,
    encoding: Encoding = None,
    out: Annotated[Path | None, typer.Option("--out", help="Folder of the recording; a new one by default.")] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, metavar="SECONDS", help="Until Ctrl-C by default.")] = None,
    rotate_size: Annotated[float | None, typer.Option(min=0.0, metavar="MB", help="New files at this size.")] = None,
    rotate_after: Annotated[float | None, typer.Option(min=0.0, metavar="SECONDS", help="... at this age.")] = None,
    format_: Annotated[str, typer.Option("--format", help="blf, asc or log.")] = "blf",
    start_when: Condition = None,
    stop_when: Condition = None,
    pre: Annotated[float, typer.Option(metavar="SECONDS", help="What came so long before --start-when, too.")] = 0.0,
) -> Answer:
    """Write all frames of buses to log files, with a manifest; Ctrl-C, SIGTERM or a condition ends it."""
    from orchestrator.can.database.sources import parsed
    from orchestrator.can.live.manifest import BusRecording
    from orchestrator.can.live.recorder import record as record_bus
    from orchestrator.can.live.trigger import RecordingLimits

    folder = out or Path("out") / f"recording_{datetime.now():%Y-%m-%d_%H%M%S}"
    bus, *others = adapter.buses(interface, channel)
    size = None if rotate_size is None else rotate_size * 1e6
    recording = BusRecording(
        bus,
        folder,
        parsed(dbc) if dbc else None,
        duration,
        size,
        rotate_after,
        f".{format_.lower()}",
        encoding=encoding,
        others=tuple(others),
        limits=RecordingLimits(start_when, stop_when, pre),
    )
    said = f"waiting for {start_when} on" if start_when else "recording"
    with terminal.live(bus.place) as move:
        manifest = record_bus(recording, move, lambda: terminal.say(f"{said} {recording.places}"))
    return Answer(document_of(manifest), [_counts(manifest), *manifest.remarks, f"recorded into {folder}"])


@command(app)
def replay(
    terminal: Terminal,
    log: Annotated[Path, typer.Argument(help="A log file of frames.")],
    interface: Interfaces,
    channel: Channels,
    adapter: Adapter,
    speed: Annotated[float, typer.Option(metavar="FACTOR", help="How many times faster than recorded.")] = 1.0,
    loop: Annotated[str, typer.Option(metavar="N", help="How often; 'endless' until Ctrl-C.")] = "1",
    only: Names = None,
    without: Names = None,
    safe: Safe = None,
    end_with: EndWith = None,
    dbc: Dbc = None,
    encoding: Encoding = None,
) -> Answer:
    """Send the frames of a log with their original timing; several channels of it onto as many buses."""
    from orchestrator.can.database.sources import parsed
    from orchestrator.can.sending.replay import Replay
    from orchestrator.can.sending.replay import replay as replay_log
    from orchestrator.can.sending.safe_end import Last
    from orchestrator.can.sending.selection import MessageSelection

    plan = Replay(
        log,
        adapter.buses(interface, channel),
        speed,
        _passes(loop),
        parsed(dbc) if dbc else None,
        encoding,
        MessageSelection(only or (), without or ()),
        Last(safe or (), end_with or ()),
    )
    with terminal.bar(log.name) as move:
        done = replay_log(plan, move)
    document = {"log": str(log), "speed": speed, **document_of(done)}
    stopped = f"interrupted after {done.sent:,} frames" if done.stopped else ""
    return Answer(document, done.lines(), interrupted=stopped)


def _passes(loop: str) -> int | None:
    if loop == "endless":
        return None
    if not loop.isdecimal():
        raise InputError(f"--loop {loop}", "is no number", "give how often, or endless")
    return int(loop)


@command(app)
def gateway(
    terminal: Terminal,
    interface: Interfaces,
    channel: Channels,
    adapter: Adapter,
    only: Names = None,
    without: Names = None,
    map_: Annotated[
        list[str] | None,
        typer.Option("--map", metavar="OLD=NEW", help="Identifier on the first bus and on the second; repeatable."),
    ] = None,
    one_way: Annotated[bool, typer.Option("--one-way", help="From the first --channel to the second only.")] = False,
    duration: Annotated[float | None, typer.Option(min=0.0, metavar="SECONDS", help="Until Ctrl-C by default.")] = None,
    reconnect: Annotated[bool, typer.Option("--reconnect", help="Open a lost bus again, every second.")] = False,
    safe: Safe = None,
    end_with: EndWith = None,
    dbc: Dbc = None,
    encoding: Encoding = None,
) -> Answer:
    """Pass frames between two buses, at once or not at all; Ctrl-C or SIGTERM ends it."""
    from orchestrator.can.database.sources import parsed
    from orchestrator.can.sending.gateway import Gateway
    from orchestrator.can.sending.gateway import gateway as pass_frames
    from orchestrator.can.sending.safe_end import Last
    from orchestrator.can.sending.selection import MessageSelection

    plan = Gateway(
        tuple(replace(bus, reopens=reconnect) for bus in adapter.buses(interface, channel)),
        parsed(dbc) if dbc else None,
        encoding,
        MessageSelection(only or (), without or ()),
        map_ or (),
        one_way,
        duration,
        Last(safe or (), end_with or ()),
    )
    with terminal.live("gateway") as move:
        done = pass_frames(plan, move, lambda: terminal.say(f"passing frames between {plan.places}"))
    rows = [
        (f"{way.source} -> {way.target}", name, f"{count:,}") for way in done.ways for name, count in way.given.items()
    ]
    return Answer(document_of(done), [Listing(("way", "message", "frames"), sorted(rows)), *done.lines()])


@command(app)
def database(
    terminal: Terminal,
    scenario: Annotated[Path, typer.Argument(help="A scenario file.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE.dbc", help="The database to write.")],
    every: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Period of all messages; by default the components' steps.")
    ] = None,
    fd: Annotated[bool, typer.Option("--fd", help="The bus has CAN FD frames.")] = False,
) -> Answer:
    """Lay out CAN messages for a scenario's recorded outputs and driven inputs, and write them as a DBC."""
    from orchestrator.bridge.declared_signals import declared
    from orchestrator.can.database.database import load
    from orchestrator.can.database.writing import generate

    if out.suffix.lower() != ".dbc":
        raise InputError(out, "is no DBC by its name", "give a name that ends in .dbc")
    if out.exists():
        raise InputError(out, "is there already", "give another --out, or remove it")
    signals = declared(scenario, every)
    out.parent.mkdir(parents=True, exist_ok=True)
    generate(signals, out, fd)
    document, rows = {}, []
    for one in load(out).messages:
        names = [signal.name for signal in one.signals]
        document[one.name] = {"identifier": one.id, "length": one.length, "period": one.cycle, "signals": names}
        rows.append((one.name, f"{one.id:03X}", f"{one.length}", f"{one.cycle:g}", ", ".join(names)))
    table = Listing(("message", "identifier", "bytes", "period [s]", "signals"), rows)
    return Answer({"database": str(out), "messages": document}, [table, f"written to {out}"])


def _counts(manifest: RecordingManifest) -> Listing:
    """Frames by message, or by identifier without a database."""
    statistics = manifest.statistics
    counts = statistics.unknown if manifest.recording.database is None else statistics.messages
    rows = [(name, f"{count:,}") for name, count in sorted(counts.items())]
    return Listing(("message", "frames"), rows, f"{manifest.frames:,} frames")
