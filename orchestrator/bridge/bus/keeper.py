"""Who has the bus: takes output values and heartbeats from the steps, and gives them input values.

Here on a thread beside them, for buses that exist in one process only: it guards against steps that hang, but ends with
its process. `keeper_process` is what guards against all.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Protocol

from orchestrator.bridge.bus.traffic import BusTraffic, on_buses
from orchestrator.bridge.bus.traffic_report import TrafficReport
from orchestrator.bridge.mapping import Coupling
from orchestrator.can.live.bus import BusSettings
from orchestrator.progress import Figures
from orchestrator.trace import FloatArray

IN_PROCESS = ("virtual",)  # interfaces whose buses exist in one process only


class Keeper(Protocol):
    """Has the bus; times are since the beginning [s]."""

    def begin(self, start: float) -> None:
        """The first step is to begin at that instant of `time.monotonic`."""

    def inputs(self, now: float) -> FloatArray:
        """(coupling.width,) received and safe values."""

    def send(self, number: int, outputs: Sequence[float], now: float, deadline: float) -> None:
        """A step has ended that was to begin at `deadline`; these are its outputs."""

    def ends(self, endures: bool) -> bool:
        """Whether the bus ends the coupling, by its failure only of one that does not endure it."""

    def status(self, now: float) -> Figures:
        """How it goes."""

    def end(self) -> TrafficReport:
        """Send the safe values, and say what has passed."""


class _ThreadKeeper:
    def __init__(self, traffic: BusTraffic, step: float) -> None:
        self._traffic, self._step, self._start = traffic, step, 0.0  # of the beginning, which is still to be known
        self._lock, self._over = threading.Lock(), threading.Event()
        self._thread = threading.Thread(target=self._watch, name="guard of the bus", daemon=True)
        self._thread.start()

    def begin(self, start: float) -> None:
        with self._lock:
            self._start = start
            self._traffic.begin(start)

    def inputs(self, now: float) -> FloatArray:
        with self._lock:
            self._traffic.receive(now)
            return self._traffic.inputs

    def send(self, number: int, outputs: Sequence[float], now: float, deadline: float) -> None:
        with self._lock:
            self._traffic.send(number, outputs, now, time.monotonic() - self._start - deadline)

    def ends(self, endures: bool) -> bool:
        return bool(self._traffic.over or (self._traffic.trouble and not endures))

    def status(self, now: float) -> Figures:
        with self._lock:
            return self._traffic.status(now)

    def end(self) -> TrafficReport:
        self._over.set()
        self._thread.join()
        now = max(time.monotonic() - self._start, 0.0)
        self._traffic.end(now)
        return self._traffic.report(now)

    def _watch(self) -> None:
        while not self._over.wait(max(self._step, 0.002)):
            with self._lock:
                if self._start:
                    self._traffic.watch(time.monotonic() - self._start)
                else:
                    self._traffic.listen(time.monotonic())


@contextmanager
def beside(
    buses: Sequence[BusSettings], coupling: Coupling, step: float, say: Callable[[str], None]
) -> Iterator[Keeper]:
    """Have the buses in this process."""
    with on_buses(buses, coupling, step, say) as traffic:
        keeper = _ThreadKeeper(traffic, step)
        try:
            yield keeper
        except BaseException:
            keeper.end()
            raise
