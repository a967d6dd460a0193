"""A co-simulation FMU, version 2.0 or 3.0, as a component in this process."""

from __future__ import annotations

from fmus.errors import FmuEnded
from orchestrator.fmi.functions import CoSimulation, Fmi2, Fmi3, VariableGroup
from orchestrator.fmi.instance import FmuInstance, stepping


class Slave(FmuInstance[CoSimulation]):
    """An instance of a co-simulation FMU, which steps by itself."""

    versions = (Fmi2, Fmi3)
    _asked = False  # to stop, at the end of the latest step

    @property
    def functions(self) -> CoSimulation:
        """The FMU's functions."""
        return self._fmi

    @property
    def bound(self) -> tuple[VariableGroup, VariableGroup]:
        """What `write` and `read` carry."""
        return self._inputs, self._outputs

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._asked = False
        super().begin(start, stop, tolerance)

    def step(self, time: float, duration: float) -> None:
        if self._asked:
            raise FmuEnded(self.name, f"asked to stop at t = {time:g} s")
        self.stepped(self._fmi.step(time, duration), time, duration)

    def stepped(self, status: int, time: float, duration: float) -> None:
        """Take note of how a step went. An FMU that asked to stop at its very end does so before the next one."""
        stop = self._fmi.stop(status, time)
        if stop is None:
            if status:
                self._check(status, stepping(time, duration))
        elif stop.whole(time, duration):
            self._asked = True
        elif stop.asked and not self._complained:
            raise FmuEnded(self.name, str(stop))
        else:
            raise self._failure(stepping(time, duration), str(stop))
