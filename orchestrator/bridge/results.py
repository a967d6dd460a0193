"""The folder that a coupling leaves: the record, a manifest with bus, watchdog and deadlines, and a report."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from orchestrator.bridge.bridge import Coupled
from orchestrator.report import Report, Section, figures
from orchestrator.results import result_folder, write_json
from orchestrator.scenario import results

DIRECTIONS = ("received", "sent")
EVENTS = 50  # that the report shows


def write(coupled: Coupled, target: Path) -> None:
    """Write the folder: `<case>.parquet`, manifest.json, report.html."""
    with result_folder(target) as folder:
        for case in coupled.result.cases:
            if case.file is not None:
                shutil.move(case.file, folder / results.trace_file(coupled.result, case))
        write_json(folder / "manifest.json", document_of(coupled, target))
        report(coupled).write(folder / "report.html")


def document_of(coupled: Coupled, folder: Path) -> dict[str, Any]:
    """What ran on which bus and how it went, as plain values."""
    run = results.document_of(coupled.result, coupled.job.overrides, folder)
    return run | {"ended": how(coupled), "can": coupled.about}


def how(coupled: Coupled) -> str:
    """How it ended: "done", "stopped" or "failed"."""
    if coupled.ending.failure is not None:
        return "failed"
    return "stopped" if coupled.ending.stopped else "done"


def remarks(coupled: Coupled) -> list[str]:
    """What somebody should know about it, a line each; the deadlines first."""
    about, watched = coupled.about, coupled.about["watchdog"]["messages"]
    lines = [coupled.deadlines.sentence(), *about["notes"], *coupled.found]
    lines += [_silence(name, each) for name, each in watched.items() if each["silences"]]
    said = {
        f"{about['received']['dropped']:,} frames were dropped: they came faster than they could be taken": about[
            "received"
        ]["dropped"],
        f"{about['sent']['no_room']:,} frames were not sent: the adapter had no room": about["sent"]["no_room"],
        f"{about['malformed_lines']:,} lines from the adapter were no frames": about["malformed_lines"],
        f"the adapter refused {about['refused_lines']:,} commands": about["refused_lines"],
        f"the bus was lost: {about['trouble']}": about["trouble"],
    }
    return lines + [text for text, holds in said.items() if holds]


def _silence(name: str, watched: dict[str, Any]) -> str:
    if watched["first"] is None:
        return f"{name} never came; its inputs had their safe values"
    times = "once" if watched["silences"] == 1 else f"{watched['silences']:,} times"
    return f"{name} was silent {times}; its inputs had their safe values for {watched['at_safe_values']:.3g} s in all"


def messages(coupled: Coupled) -> list[tuple[str, str, int, float]]:
    """(direction, message, frames, frames a second) of every message on the bus."""
    seconds = max(coupled.about["seconds"], 1e-9)
    return [
        (direction, name, count, count / seconds)
        for direction in DIRECTIONS
        for name, count in sorted(coupled.about[direction]["messages"].items())
    ]


def report(coupled: Coupled) -> Report:
    """The report of the run, with what passed over the bus and how the deadlines were kept."""
    page = results.report(coupled.result)
    _bus(coupled, page.section("Bus"))
    _deadlines(coupled, page.section("Deadlines"))
    return page


def _bus(coupled: Coupled, section: Section) -> None:
    if coupled.ending.failure is not None:
        section.callout("error", str(coupled.ending.failure))
    for line in remarks(coupled)[1:]:
        section.callout("warning", line)
    section.table(["direction", "message", "frames", "frames/s"], messages(coupled))
    watchdog = coupled.about["watchdog"]
    if watchdog["events"]:
        rows = [(each["time"], each["message"], each["kind"]) for each in watchdog["events"][:EVENTS]]
        section.table(["time [s]", "message", "event"], rows, caption=f"{watchdog['event_count']} events in all.")
    about = coupled.about
    named = ("mode", "interface", "channel", "bitrate", "fd", "started", "seconds")
    section.provenance({name: _cell(about[name]) for name in named} | about["database"])


def _cell(value: Any) -> str | float | None:
    return value if isinstance(value, str | float | None) else str(value)


def _deadlines(coupled: Coupled, section: Section) -> None:
    deadlines = coupled.deadlines
    section.paragraph(deadlines.sentence())
    bins = [(1e6 * low, 1e6 * high, count) for low, high, count in deadlines.lateness.bins()]
    if bins:
        section.figure(figures.counts(bins, "from the deadline to the beginning", "µs"), "Steps by their lateness.")
