"""A report of recordings as they are, for `servotwin trace plot`.

It shows where each is from, what its stamps and signals look like, and every signal over time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from orchestrator.display.table import Cell
from orchestrator.formats.recording import Recording
from orchestrator.report import figures
from orchestrator.report.document import Report, Section
from orchestrator.trace import Trace


def plot_traces(recordings: Sequence[Recording]) -> Report:
    """A report with a section a recording."""
    count = len(recordings)
    report = Report(
        recordings[0].trace.name if count == 1 else "Recordings",
        "One recording" if count == 1 else f"{count} recordings",
    )
    for recording in recordings:
        _describe(recording, report.section(recording.trace.name))
    return report


def _describe(recording: Recording, section: Section) -> None:
    trace, stamps = recording.trace.numbers, recording.stamps
    section.warnings(f"{name} is text and is not drawn" for name in recording.trace.texts)
    section.warnings([] if stamps.clean else [str(stamps)])
    section.warnings(recording.notes)
    section.warnings(f"{name} {problem}" for name in trace.names if (problem := _oddity(trace, name)))
    if trace.names:
        section.figure(figures.overlay(trace))
    section.table(
        ["signal", "unit", "lowest", "highest", "mean", "standard deviation"],
        [[name, trace.unit(name) or "–", *_statistics(trace, name)] for name in trace.names],
        numeric=(2, 3, 4, 5),
    )
    section.provenance(
        {
            "file": str(recording.path),
            "sha256": recording.sha256,
            "samples": len(trace),
            "from, to [s]": f"{trace.time[0]:g}, {trace.time[-1]:g}",
            "mean step [s]": stamps.mean_step,
            "largest gap [s]": stamps.largest_gap,
        }
    )


def _oddity(trace: Trace, name: str) -> str:
    values = trace[name]
    bad = int(np.count_nonzero(~np.isfinite(values)))
    if bad:
        return f"is not finite in {bad} of {len(values)} samples"
    return "never changes" if np.all(values == values[0]) else ""


def _statistics(trace: Trace, name: str) -> list[Cell]:
    values = trace[name][np.isfinite(trace[name])]
    if len(values) == 0:
        return [None] * 4
    return [float(value) for value in (values.min(), values.max(), values.mean(), values.std())]
