"""Commands that couple a scenario to a CAN bus in real time: can bridge, bench."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fmus.errors import InputError
from orchestrator.cli.can import Adapter, Channels, Interfaces
from orchestrator.cli.options import Fmus, LiveOptions, Overrides, files, overrides
from orchestrator.cli.scenarios import Running, run_and_write
from orchestrator.cli.terminal import Answer, Listing, Out, Terminal, command
from orchestrator.processes.interrupts import whole

if TYPE_CHECKING:
    from orchestrator.bridge.bridge import BridgeResult
    from orchestrator.bridge.preparation import BridgeJob
    from orchestrator.can.live.bus import BusSettings
    from orchestrator.scenario.scenario import Scenario

app = typer.Typer()

RESERVE = 1 << 19  # bytes

ScenarioFile = Annotated[Path, typer.Argument(help="A scenario file with a `can` block, or with `buses`.")]


@dataclass(frozen=True)
class CouplingOptions:
    """What of a scenario is coupled, and how long."""

    case: Annotated[str | None, typer.Option("--case", help="The case to take; the first by default.")] = None
    set_: Overrides = None
    fmu: Fmus = None
    duration: Annotated[
        float | None, typer.Option("--duration", min=0.0, metavar="SECONDS", help="How long to go on.")
    ] = None
    stride: Annotated[int, typer.Option(min=1, metavar="N", help="Record every N-th step only.")] = 1

    def job(self, scenario: Path, buses: Sequence[BusSettings], endless: bool) -> BridgeJob:
        """The scenario on these buses."""
        from orchestrator.bridge.preparation import BridgeJob
        from orchestrator.rational import seconds

        duration = None if self.duration is None else seconds(self.duration, "--duration")
        bus, *others = buses
        values, fmus = overrides(self.set_), files(self.fmu)
        return BridgeJob(scenario, bus, endless, self.case, values, duration, self.stride, fmus, tuple(others))

    def networked(self, scenario: Path) -> Scenario | None:
        """The scenario where network FMUs of its own are on the bus, with the case that is wanted; else None.

        Raises:
            InputError: there is no such case, or how long it goes on is not the scenario's.
        """
        from orchestrator.scenario.schema import load_scenario

        loaded = load_scenario(scenario, fmus=files(self.fmu))
        if loaded.can is not None or not loaded.system.buses:
            return None
        if self.duration is not None:
            raise InputError("--duration", "is the scenario's where network FMUs are on its buses", "leave it out")
        cases = tuple(case for case in loaded.cases if self.case in (None, case.name))[:1]
        if not cases:
            known = ", ".join(case.name for case in loaded.cases)
            raise InputError(f"--case {self.case}", "there is no such case", f"choose {known}")
        return replace(loaded, cases=cases)


@command(app)
def bridge(
    terminal: Terminal,
    scenario: ScenarioFile,
    interface: Interfaces,
    channel: Channels,
    adapter: Adapter,
    coupling: CouplingOptions,
    out: Out = None,
    *,
    live: LiveOptions,
) -> Answer:
    """Couple a scenario to buses in real time; exit code 1 when an expectation fails."""
    from orchestrator.results import default_folder

    live.check()
    folder = out or default_folder(scenario)
    if (networked := coupling.networked(scenario)) is not None:
        return _on_buses(terminal, networked, adapter.buses(interface, channel), folder, coupling, live)
    job = coupling.job(scenario, adapter.buses(interface, channel), endless=False)
    coupled, folder = _coupled(job, folder, terminal, live)
    return _answer(coupled, folder, coupled.ending.stopped)


def _on_buses(
    terminal: Terminal,
    scenario: Scenario,
    buses: Sequence[BusSettings],
    folder: Path,
    coupling: CouplingOptions,
    live: LiveOptions,
) -> Answer:
    """A scenario of network FMUs in real time, its buses coupled to these."""
    from orchestrator.bridge.coupled_bus import Coupled
    from orchestrator.live.paced import Paced
    from orchestrator.progress import silent
    from orchestrator.results import check_target

    check_target(folder)
    with live.steered(terminal, scenario.path.stem) as steering:
        execute = Coupled(Paced(steering), tuple(buses)).execute
        how = Running(overrides(coupling.set_), coupling.stride, execute=execute)
        answer, _ = run_and_write(terminal, scenario, folder, how, silent)
    return answer


@command(app)
def bench(
    terminal: Terminal,
    scenario: ScenarioFile,
    *,
    interface: Annotated[
        list[str] | None, typer.Option("--interface", help="As of `can record`; none with --serve.")
    ] = None,
    channel: Annotated[
        list[str] | None, typer.Option("--channel", help="What the interface calls the bus; repeatable.")
    ] = None,
    adapter: Adapter,
    serve: Annotated[
        list[Path] | None,
        typer.Option("--serve", metavar="DIR", help="Make a bus: serial adapters (slcan) DIR/0, 1, ...; repeatable."),
    ] = None,
    ports: Annotated[int, typer.Option(min=2, help="With --serve: how many; this bench is on DIR/0.")] = 3,
    coupling: CouplingOptions,
    out: Out = None,
) -> Answer:
    """Stand in for hardware behind a bus, until Ctrl-C or SIGTERM; silent peers and a lost bus do not end it."""
    from orchestrator.can.slcan.hub import hub_process
    from orchestrator.results import default_folder

    with ExitStack() as stack:
        if not serve:
            if not interface or not channel:
                raise InputError("bench", "has no bus", "give --interface and --channel, or --serve")
            buses = adapter.buses(interface, channel)
        elif interface or channel:
            raise InputError("--serve", "makes a bus of its own", "leave out --interface and --channel")
        else:
            data_rate = adapter.data_bitrate or 2_000_000
            own = replace(adapter, bitrate=adapter.bitrate or [500_000], data_bitrate=data_rate if adapter.fd else None)
            buses = own.buses(["slcan"], [str(folder / "0") for folder in serve])
            for folder, bus in zip(serve, buses, strict=True):
                assert bus.bitrate is not None
                stack.enter_context(hub_process(folder, ports, bus.bitrate, data_rate))
        job = coupling.job(scenario, buses, endless=True)
        coupled, results = _coupled(job, out or default_folder(scenario, "_bench"), terminal, LiveOptions())
    return _answer(coupled, results, coupled.interrupted)


def _coupled(job: BridgeJob, folder: Path, terminal: Terminal, live: LiveOptions) -> tuple[BridgeResult, Path]:
    """What came of the job, written to the folder.

    Raises:
        ServotwinError: what ended it before its time, when the result up to there was written.
    """
    from orchestrator.bridge.bridge import RECORDS, couple
    from orchestrator.bridge.results import write
    from orchestrator.results import aside, check_target, prepare, rescue

    check_target(folder)
    with live.coupling(terminal, job) as (steered, move), aside(folder) as near:
        reserve = near / "reserve"  # for what is to be said of a full disk
        reserve.write_bytes(bytes(RESERVE))

        def ready(_: object) -> None:
            prepare(near, RECORDS, folder, {"scenario": job.scenario.name})
            terminal.say(f"{job.scenario.stem} is on {job.places}")

        coupled = couple(steered, near, ready, move, lambda: rescue(near))
        reserve.unlink()
        with whole():
            write(coupled, folder)
    failure = coupled.ending.failure
    if failure is not None:
        raise type(failure)(failure.place, failure.problem, f"the result up to there is in {folder}") from failure
    return coupled, folder


def _answer(coupled: BridgeResult, folder: Path, interrupted: bool) -> Answer:
    from orchestrator.bridge.results import document_of
    from orchestrator.scenario.run import HEADERS

    result, document = coupled.result, document_of(coupled, folder)
    if interrupted:
        line = f"interrupted after {coupled.ending.elapsed:.3f} s; the result up to there is in {folder}"
        return Answer(document, held=False, interrupted=line)
    checks = Listing(HEADERS, result.rows(), result.scenario.title)
    counts = [(way, name, f"{count:,}", f"{rate:,.1f}") for way, name, count, rate in coupled.account.traffic()]
    passed = Listing(("direction", "message", "frames", "frames/s"), counts)
    return Answer(document, [checks, passed, *coupled.account.remarks(), f"results in {folder}"], result.passed)
