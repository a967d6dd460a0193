"""Real time: absolute deadlines on a clock that never jumps, and the quiet that it takes to keep them."""

from __future__ import annotations

import gc
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction

from orchestrator.realtime.priority import short_time_slices
from orchestrator.realtime.stopping import Stop

SPIN = 1e-4  # before a deadline, in which the processor is left to other threads instead of sleeping [s]
SWITCHING = 2e-4  # for which another thread may keep the one that has deadlines waiting [s]


class Pace:
    """Deadlines at equal distances, computed from their number and never added up.

    Sleeping ends some 0.1 ms late where many timers share a wake-up; the last 0.1 ms before a deadline are therefore
    spent awake, which takes that share of a step of one processor: a tenth at 1 kHz.
    """

    def __init__(self, start: float, step: Fraction) -> None:
        self._start, self._step = round(1e9 * start), step * 10**9  # [ns]

    def deadline(self, number: int) -> float:
        """When step `number` is to begin, on the clock of `time.monotonic` [s]."""
        return (self._start + number * self._step.numerator // self._step.denominator) / 1e9

    def wait(self, deadline: float, stop: Stop) -> float:
        """Wait for the deadline, or for the wish to end; the time at the end of waiting [s]."""
        stop.sleep_until(deadline - SPIN)
        while (now := time.monotonic()) < deadline and not stop.requested:
            time.sleep(0)
        return now


@contextmanager
def quiet() -> Iterator[None]:
    """Threads have short time slices within the block, and what there is already is not searched for garbage."""
    former = sys.getswitchinterval()
    sys.setswitchinterval(SWITCHING)
    gc.collect()
    gc.freeze()
    try:
        with short_time_slices():
            yield
    finally:
        gc.unfreeze()
        sys.setswitchinterval(former)
