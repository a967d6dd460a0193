"""What drives an input of a system over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fmus.errors import TraceError
from orchestrator.trace import FloatArray, Trace


@dataclass(frozen=True)
class Stimulus:
    """A constant, or a recording that is played back.

    Attributes:
        source: a value, or a trace with one signal [unit of the input].
        hold: whether the recording's last value is kept until its next, instead of a line between them.

    Raises:
        TraceError: the trace has no signal, or several.
    """

    source: float | Trace
    hold: bool = False

    def __post_init__(self) -> None:
        if isinstance(self.source, Trace) and len(self.source.names) != 1:
            names = ", ".join(self.source.names) or "none"
            raise TraceError(self.source.name, f"drives an input with {names}", "select one signal")

    @property
    def varies(self) -> bool:
        """Whether its value can change with time."""
        return isinstance(self.source, Trace)

    def values(self, time: FloatArray) -> FloatArray:
        """(K,) values at these times (K,) [s].

        Raises:
            TraceError: the recording does not cover them.
        """
        if not isinstance(self.source, Trace):
            return np.full(len(time), float(self.source))
        (name,) = self.source.names
        return self.source.resampled(time, hold=[name] if self.hold else [])[name]
