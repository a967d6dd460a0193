"""Parts of recordings that are kept out of a fit, while the rest of the same recording is fitted."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from fmus.errors import ScenarioError
from orchestrator.marks import Mark
from orchestrator.trace import Trace


@dataclass(frozen=True)
class RecordingPart:
    """A time range of a trace.

    Attributes:
        trace: its name.
        start, stop: in the time of the recording, both included [s]; infinite ones reach to its ends.
    """

    trace: str
    start: float = -math.inf
    stop: float = math.inf

    @property
    def name(self) -> str:
        """What the part is called: rig from 10 to 20 s."""
        begin = f" from {self.start:g}" if math.isfinite(self.start) else ""
        return self.trace + begin + (f" to {self.stop:g}" if math.isfinite(self.stop) else "") + " s"


def parted(trace: Trace, parts: Sequence[RecordingPart]) -> Iterator[tuple[Trace, tuple[Mark, ...]]]:
    """What is left of a trace, with marks where a part lies within it; then each part, by its name.

    Raises:
        ScenarioError: nothing lies in a part, or nothing is left.
    """
    left, marks = trace, list[Mark]()
    for part in parts:
        own = trace.between(part.start, part.stop)
        if len(own) < 2:
            ends = f"it lasts from {trace.time[0]:g} to {trace.time[-1]:g} s"
            raise ScenarioError("traces.hold_out", f"{part.name} holds less than two samples", ends)
        if part.start > left.time[0] and part.stop < left.time[-1]:
            marks.append(Mark("excluded", part.start, part.stop))
        elif part.start <= left.time[0]:
            left = left.between(part.stop, math.inf)
        else:
            left = left.between(-math.inf, part.start)
        if len(left) < 2:
            raise ScenarioError("traces.hold_out", f"leaves nothing of {trace.name}", "hold out less of it")
    yield left, tuple(marks)
    for part in parts:
        own = trace.between(part.start, part.stop)
        yield Trace(own.time, own.signals, own.units, part.name, own.texts), ()
