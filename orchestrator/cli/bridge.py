"""Commands that couple a scenario to a CAN bus in real time: can bridge, bench."""

from __future__ import annotations

import tempfile
from contextlib import ExitStack
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.table import Table

from fmus.errors import InputError
from orchestrator.cli.can import Bitrate, Channel, DataBitrate, Fd, Interface, Options, bus_settings
from orchestrator.cli.terminal import ERR, Answer, Json, Out, Quiet, Terminal, Verbose, answered
from orchestrator.interrupts import whole
from orchestrator.results import check_target

if TYPE_CHECKING:
    from orchestrator.bridge.bridge import Coupled
    from orchestrator.bridge.preparation import Job

app = typer.Typer()

Scenario = Annotated[Path, typer.Argument(help="A scenario file with a `can` block.")]
Case = Annotated[str | None, typer.Option("--case", help="The case to take; the first by default.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="COMP.PARAM=VALUE", help="Over the file's values.")
]
Duration = Annotated[float | None, typer.Option("--duration", min=0.0, metavar="SECONDS", help="How long to go on.")]
Stride = Annotated[int, typer.Option(min=1, metavar="N", help="Record every N-th step only.")]


@app.command()
def bridge(
    scenario: Scenario,
    interface: Interface,
    channel: Channel,
    bitrate: Bitrate = None,
    fd: Fd = False,
    data_bitrate: DataBitrate = None,
    option: Options = None,
    case: Case = None,
    set_: Settings = None,
    duration: Duration = None,
    stride: Stride = 1,
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Couple a scenario to a bus in real time; exit code 1 when an expectation fails."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.bridge.preparation import Job

        bus = bus_settings(interface, channel, bitrate, fd, data_bitrate, option)
        job = Job(scenario, bus, False, case, _overrides(set_), _seconds(duration), stride)
        coupled, folder = _coupled(job, out or Path("out") / scenario.stem, terminal)
        return _answer(coupled, folder, coupled.ending.stopped)

    answered(work, as_json, quiet, verbose)


@app.command()
def bench(
    scenario: Scenario,
    interface: Annotated[str | None, typer.Option("--interface", help="As of `can record`; none with --serve.")] = None,
    channel: Annotated[str | None, typer.Option("--channel", help="What the interface calls the bus.")] = None,
    bitrate: Bitrate = None,
    fd: Fd = False,
    data_bitrate: DataBitrate = None,
    option: Options = None,
    serve: Annotated[
        Path | None, typer.Option("--serve", metavar="DIR", help="Make a bus: serial adapters (slcan) DIR/0, 1, ...")
    ] = None,
    ports: Annotated[int, typer.Option(min=2, help="With --serve: how many; this bench is on DIR/0.")] = 3,
    case: Case = None,
    set_: Settings = None,
    duration: Duration = None,
    stride: Stride = 1,
    out: Out = None,
    as_json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = 0,
) -> None:
    """Stand in for hardware behind a bus, until Ctrl-C or SIGTERM; silent peers and a lost bus do not end it."""

    def work(terminal: Terminal) -> Answer:
        from orchestrator.bridge.preparation import Job
        from orchestrator.can.slcan.hub import hub_process

        with ExitStack() as stack:
            if serve is None:
                if interface is None or channel is None:
                    raise InputError("bench", "has no bus", "give --interface and --channel, or --serve")
                bus = bus_settings(interface, channel, bitrate, fd, data_bitrate, option)
            elif interface is not None or channel is not None:
                raise InputError("--serve", "makes a bus of its own", "leave out --interface and --channel")
            else:
                rate, data_rate = bitrate or 500_000, data_bitrate or 2_000_000
                bus = bus_settings("slcan", str(serve / "0"), rate, fd, data_rate if fd else None, option)
                stack.enter_context(hub_process(serve, ports, rate, data_rate))
            job = Job(scenario, bus, True, case, _overrides(set_), _seconds(duration), stride)
            coupled, folder = _coupled(job, out or Path("out") / f"{scenario.stem}_bench", terminal)
        return _answer(coupled, folder, coupled.interrupted)

    answered(work, as_json, quiet, verbose)


def _coupled(job: Job, folder: Path, terminal: Terminal) -> tuple[Coupled, Path]:
    """What came of the job, written to the folder.

    Raises:
        ServotwinError: what ended it before its time, when the result up to there was written.
    """
    from orchestrator.bridge.bridge import couple
    from orchestrator.bridge.results import write

    check_target(folder)
    near = next(each for each in folder.resolve().parents if each.is_dir())  # on the disk that the result goes to
    with (
        terminal.bar(job.scenario.stem) as move,
        tempfile.TemporaryDirectory(prefix=f".{folder.name}.", dir=near) as aside,
    ):

        def ready(*_: object) -> None:
            if not terminal.quiet:
                ERR.print(f"{job.scenario.stem} is on {job.bus.place}", soft_wrap=True)

        coupled = couple(job, Path(aside), ready, lambda share, elapsed: move(share, f"{elapsed:.0f} s"))
        with whole():
            write(coupled, folder)
    failure = coupled.ending.failure
    if failure is not None:
        raise type(failure)(failure.place, failure.problem, f"the result up to there is in {folder}") from failure
    return coupled, folder


def _answer(coupled: Coupled, folder: Path, interrupted: bool) -> Answer:
    from orchestrator.bridge.results import document_of, messages, remarks
    from orchestrator.scenario.results import rows_of

    result, document = coupled.result, document_of(coupled, folder)
    if interrupted:
        line = f"interrupted after {coupled.ending.elapsed:.3f} s; the result up to there is in {folder}"
        return Answer(document, held=False, interrupted=line)
    checks = Table("case", "expectation", "held", "found", title=result.block.title)
    for row in rows_of(result):
        checks.add_row(*row)
    passed = Table("direction", "message", "frames", "frames/s")
    for direction, name, count, rate in messages(coupled):
        passed.add_row(direction, name, f"{count:,}", f"{rate:,.1f}")
    return Answer(document, [checks, passed, *remarks(coupled), f"results in {folder}"], result.passed)


def _overrides(texts: list[str] | None) -> dict[str, Any]:
    from orchestrator.scenario.run import parse_override

    return dict(parse_override(each) for each in texts or [])


def _seconds(value: float | None) -> Fraction | None:
    from orchestrator.rational import seconds

    return None if value is None else seconds(value, "--duration")
