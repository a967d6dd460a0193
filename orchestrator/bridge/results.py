"""The folder that a coupling leaves: the record, a manifest with bus, watchdog and deadlines, and a report."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import cast

from fmus.errors import InputError
from orchestrator.bridge.account import BusAccount
from orchestrator.bridge.bridge import BridgeResult
from orchestrator.can.frames import moment
from orchestrator.report import Report, Section, figures
from orchestrator.results import result_folder, write_json
from orchestrator.scenario import results
from orchestrator.scenario.report import report as run_report
from orchestrator.scenario.run import CaseResult

LOG = logging.getLogger("servotwin.can")
EVENTS = 50  # that the report shows


def write(bridged: BridgeResult, target: Path) -> None:
    """Write the folder: `<case>.parquet`, manifest.json, report.html."""
    with result_folder(target) as folder:
        for case in bridged.result.cases:
            if case.file is not None:
                _take(case.file, folder / _trace_file(bridged, case))
        write_json(folder / "manifest.json", document_of(bridged, target))
        try:
            report(bridged).write(folder / "report.html")
        except (OSError, InputError) as error:  # what was measured is worth more
            LOG.warning("there is no report: %s", error)


def _take(record: Path, place: Path) -> None:
    """Have the record there as well: while the result is not whole, the command may be killed."""
    try:
        place.hardlink_to(record)
    except OSError:
        shutil.move(record, place)


class BridgeDocument(results.RunDocument):
    """What ran on which bus and how it went, as manifest.json holds it."""

    ended: str
    can: BusAccount


def document_of(bridged: BridgeResult, folder: Path) -> BridgeDocument:
    """What ran on which bus and how it went, as plain values."""
    run = results.document_of(bridged.result, {}, folder)
    for case, told in zip(bridged.result.cases, cast("list[results.RunCaseDocument]", run["cases"]), strict=True):
        if "trace" in told:
            told["trace"] = _trace_file(bridged, case)
    return {**run, "ended": how(bridged), "can": bridged.account}


def _trace_file(bridged: BridgeResult, case: CaseResult) -> str:
    """Name of the record: it is left as it grew where there was no room for another form."""
    name = Path(results.trace_file(bridged.result, case))
    return str(name if case.file is None else name.with_suffix(case.file.suffix))


def how(bridged: BridgeResult) -> str:
    """How it ended: "done", "stopped" or "failed"."""
    if bridged.ending.failure is not None:
        return "failed"
    return "stopped" if bridged.ending.stopped else "done"


def report(bridged: BridgeResult) -> Report:
    """The report of the run, with what passed over the bus and how the deadlines were kept."""
    can = bridged.result.scenario.can
    page = run_report(bridged.result, can.receive if can else ())
    _bus(bridged, page.section("Bus"))
    _deadlines(bridged, page.section("Deadlines"))
    return page


def _bus(bridged: BridgeResult, section: Section) -> None:
    account = bridged.account
    if bridged.ending.failure is not None:
        section.callout("error", str(bridged.ending.failure))
    section.warnings([*account.notes, *account.remarks()[1:]])
    traffic, seconds = account.traffic(), max(account.seconds, 1e-9)
    counts = [("received", account.received.frames), ("sent", account.frames)]
    section.highlights([(f"frames {way}", count, f"{count / seconds:.4g} a second") for way, count in counts])
    section.table(["direction", "message", "frames", "frames/s"], traffic)
    rates = {way: {name: rate for by, name, _, rate in traffic if by == way} for way, _ in counts}
    if any(rates.values()):
        section.figure(figures.bars({way: own for way, own in rates.items() if own}, quantity="Frames a second"))
    if account.losses:
        lost = [(moment(loss.stamp), loss.why, loss.seconds) for loss in account.losses]
        section.table(["bus lost at", "why", "back after [s]"], lost, caption=f"{account.loss_count} times in all.")
    watchdog = account.watchdog
    if watchdog.messages:
        peers = [
            (name, peer.frames, peer.first, peer.silence, peer.silences, peer.at_safe_values)
            for name, peer in watchdog.messages.items()
        ]
        headers = ["message of a peer", "frames", "first [s]", "silent after [s]", "silences", "at safe values [s]"]
        section.table(headers, peers)
    if watchdog.events:
        rows = [(event.time, event.name, event.kind) for event in watchdog.events[:EVENTS]]
        section.table(["time [s]", "of", "event"], rows, caption=f"{watchdog.event_count} events in all.")
    bus = account.bus
    entries: dict[str, str | float | None] = {"mode": account.mode, "interface": bus.interface, "channel": bus.channel}
    entries |= {"bitrate": bus.bitrate, "fd": str(bus.fd), "started": account.started.isoformat()}
    section.provenance({**entries, "seconds": account.seconds, **account.described})


def _deadlines(bridged: BridgeResult, section: Section) -> None:
    deadlines = bridged.account.deadlines
    section.paragraph(deadlines.sentence())
    bins = [(1e6 * low, 1e6 * high, count) for low, high, count in deadlines.lateness.bins()]
    if bins:
        section.figure(figures.counts(bins, "from the deadline to the beginning", "µs"), "Steps by their lateness.")
