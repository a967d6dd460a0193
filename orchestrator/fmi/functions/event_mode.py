"""Event mode of FMI 3.0, which model exchange always has and co-simulation where it is asked for."""

from __future__ import annotations

import ctypes
import math
from dataclasses import dataclass

from orchestrator.fmi.functions.version3 import Version3


@dataclass(frozen=True)
class EventTurn:
    """What one turn of an event iteration brought.

    Attributes:
        again: there has to be another turn.
        ending: the FMU asks to stop.
        next_event: time of the next event that is known in advance, infinity without one [s].
    """

    again: bool
    ending: bool
    next_event: float


class Events3(Version3):
    """What has event mode in FMI 3.0."""

    def update(self) -> tuple[int, EventTurn]:
        """One turn of an event iteration. The status and what it brought."""
        flags, time = [ctypes.c_bool() for _ in range(5)], ctypes.c_double()
        status = self.call("UpdateDiscreteStates", *map(ctypes.byref, flags), ctypes.byref(time))
        again, ending, _, _, known = (flag.value for flag in flags)
        return status, EventTurn(again, ending, time.value if known else math.inf)
