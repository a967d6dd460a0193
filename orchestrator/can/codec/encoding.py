"""Signals to frames: a trace as the bus would have carried it, each message at its own rate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fmus.errors import TraceError
from orchestrator.can.codec.message_writer import MessageWriter
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.frames import Frames, concatenated
from orchestrator.can.statistics import FrameStatistics
from orchestrator.trace import FloatArray, Trace

MOST_FRAMES = 1 << 28  # of a message in one trace


class Encoder:
    """Encodes traces, one after another; counters go on from one to the next.

    Attributes:
        statistics: what was sent, and what had to be limited.
    """

    def __init__(self, database: Database, signals: Sequence[str]) -> None:
        """Send these signals, which are columns of the traces by the same names.

        Raises:
            DatabaseError: a signal is not in the database, or its message cannot be sent.
        """
        self.statistics = FrameStatistics()
        sent: dict[MessageSpec, dict[str, str]] = {}
        for name in signals:
            message, signal = database.signal(name)
            sent.setdefault(message, {})[signal.name] = name
        by_priority = sorted(sent.items(), key=lambda sent: sent[0].id)
        self._writers = [MessageWriter(message, columns, self.statistics) for message, columns in by_priority]
        self._columns = list(dict.fromkeys(signals))

    def encode(self, trace: Trace, start: float = 0.0) -> Frames:
        """Frames of all messages, in time: one every cycle time, or at every row where a message has none.

        Args:
            start: is added to all stamps [s].

        Raises:
            TraceError: a signal is missing or has a value that is not finite.
        """
        for name in self._columns:
            bad = np.flatnonzero(~np.isfinite(trace[name]))
            if len(bad):
                raise TraceError(
                    f"{trace.name}.{name}",
                    f"is not finite at t = {trace.time[bad[0]]:g} s ({len(bad)} samples)",
                    "repair or cut the recording",
                )
        frames = concatenated([self._message(writer, trace, start) for writer in self._writers])
        return frames[np.argsort(frames.time, kind="stable")]

    def _message(self, writer: MessageWriter, trace: Trace, start: float) -> Frames:
        if writer.spec.cycle is None or not len(trace):
            return writer.write(trace.time + start, trace.signals)
        time = _instants(trace, writer.spec.cycle)
        rows = np.searchsorted(trace.time, time + _slack(trace), side="right") - 1
        return writer.write(time + start, {name: trace[name][rows] for name in self._columns})


def _instants(trace: Trace, cycle: float) -> FloatArray:
    """(K,) from the first stamp to the last in steps of a cycle [s]."""
    count = (trace.duration + _slack(trace)) / cycle + 1
    if count > MOST_FRAMES:
        raise TraceError(trace.name, f"takes {count:.0f} frames of {cycle:g} s", "cut it")
    return np.asarray(trace.time[0] + cycle * np.arange(int(count)))


def _slack(trace: Trace) -> float:
    """What stamps may lack of a whole number of cycles [s]."""
    return 1e-9 * max(1.0, trace.duration)
