"""What of the recordings of a study is left out: what is marked in them, and what the study excludes."""

from __future__ import annotations

import json
import logging
import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fmus.errors import ScenarioError, TraceError, within
from orchestrator.marks import Mark, listed, runs, union
from orchestrator.trace import BoolArray, FloatArray, Trace, require_finite

MOST = 4  # stretches that a message spells out
MUCH = 0.1  # of a recording left out, from which it is a warning

LOG = logging.getLogger("servotwin.recordings")


@dataclass(frozen=True)
class Exclusion:
    """A stretch that a study leaves out, or all stretches in which a signal is beyond a limit.

    Attributes:
        trace: name of the one that it is of; None of all.
        signal: left out are only samples at which it is above one limit or below the other; None leaves out all.
        start, stop: in the time of the recording, both included [s].
        above, below: [unit of the signal].
    """

    trace: str | None = None
    signal: str | None = None
    start: float = -math.inf
    stop: float = math.inf
    above: float = math.inf
    below: float = -math.inf

    def met(self, trace: Trace) -> BoolArray | bool:
        """(K,) at which samples its condition is met; True without one."""
        if self.signal is None:
            return True
        return np.asarray((trace[self.signal] > self.above) | (trace[self.signal] < self.below), np.bool_)


def excluded(exclusions: Sequence[Exclusion], traces: Sequence[Trace], foreign: bool = False) -> list[list[Mark]]:
    """What they leave out of each of the traces, to the next samples on either side.

    Args:
        foreign: whether the traces may be others than those that the exclusions were written for.

    Raises:
        ScenarioError: one names a trace that is not there, or a time that no trace has.
        TraceError: a trace lacks the signal of one.
    """
    found: list[list[Mark]] = [[] for _ in traces]
    for number, exclusion in enumerate(exclusions):
        place, names = f"traces.exclude[{number}]", [trace.name for trace in traces]
        if exclusion.trace is not None and exclusion.trace not in names and not foreign:
            raise ScenarioError(place, f"there is no trace '{exclusion.trace}'", f"there are {', '.join(names[:6])}")
        reached = False
        left_out: list[Mark] = []
        for trace, own in zip(traces, found, strict=True):
            if exclusion.trace in (None, trace.name):
                inside = (trace.time >= exclusion.start) & (trace.time <= exclusion.stop)
                reached |= bool(inside.any())
                with within(place):
                    stretches = _stretches(inside & exclusion.met(trace), trace.time)
                own.extend(stretches)
                left_out += stretches
        if not (reached or foreign):
            last = max(float(trace.time[-1]) for trace in traces)
            raise ScenarioError(place, "lies in no trace", f"the longest ends at {last:g} s")
        if reached and not left_out:
            LOG.warning("%s leaves nothing out: '%s' is nowhere beyond its limit there", place, exclusion.signal)
    return found


def _stretches(inside: BoolArray, time: FloatArray) -> list[Mark]:
    edges = np.concatenate(([np.nextafter(time[0], -np.inf)], time, [np.nextafter(time[-1], np.inf)]))
    return [Mark("excluded", float(edges[first]), float(edges[after + 1])) for first, after in runs(inside)]


def pieces(trace: Trace, marks: Sequence[Mark]) -> list[Trace]:
    """The parts of the trace between the marks; all of it without any."""
    if not marks:
        return [trace]
    stretches = union(np.array([(mark.start, mark.stop) for mark in marks]))
    begins, ends = np.append(trace.time[0], stretches[:, 1]), np.append(stretches[:, 0], trace.time[-1])
    found = (trace.between(begin, end) for begin, end in zip(begins, ends, strict=True) if begin <= end)
    return [piece for piece in found if len(piece) > 1]


def require_known(name: str, kept: Sequence[Trace], signals: Iterable[str]) -> None:
    """See that signals have a value at each sample of what is left of a trace.

    Args:
        name: of the trace in the study.

    Raises:
        TraceError: one has not; the message says what leaves those samples out.
    """
    for signal in signals:
        lost = [~np.isfinite(piece[signal]) for piece in kept]
        ends = [
            f"{{trace: {_as_yaml(name)}, from: {float(piece.time[first])!r}, to: {float(piece.time[after - 1])!r}}}"
            for piece, missing in zip(kept, lost, strict=True)
            for first, after in runs(missing)
        ]
        stretches = ", ".join(ends[:MOST]) + (", ..." if len(ends) > MOST else "")
        more = f", {len(ends)} stretches" if len(ends) > MOST else ""
        for piece in kept:
            fix = f"repair or cut the recording, or leave them out: `traces.exclude: [{stretches}]`{more}"
            require_finite(piece, signal, fix)


def _as_yaml(name: str) -> str:
    """A name as a list in a study file has it."""
    plain = re.fullmatch(r"[A-Za-z_][\w.-]*", name) and name.lower() not in ("true", "false", "null")
    return name if plain else json.dumps(name, ensure_ascii=False)


def sound(trace: Trace, marks: Sequence[Mark]) -> BoolArray:
    """(K,) the samples that no mark covers."""
    stretches = union(np.array([(mark.start, mark.stop) for mark in marks]).reshape(-1, 2))
    begun = np.searchsorted(stretches[:, 0], trace.time, side="left")
    ended = np.searchsorted(stretches[:, 1], trace.time, side="right")
    return np.asarray(begun == ended)


def covered(marks: Sequence[Mark], trace: Trace) -> float:
    """How much of the trace the marks cover together [s]."""
    if not marks or not len(trace):
        return 0.0
    stretches = np.clip([(mark.start, mark.stop) for mark in marks], trace.time[0], trace.time[-1])
    return float(np.sum(np.diff(union(np.asarray(stretches, np.float64)))))


def nothing_left(place: str, what: str, marks: Sequence[Mark]) -> TraceError:
    """The complaint that what is needed is not left beside the marks."""
    return TraceError(
        place,
        f"{what} left beside {listed(marks)}",
        "take shorter parts, exclude less, or take such stretches all the same (`traces.keep: [KIND]`)",
    )
