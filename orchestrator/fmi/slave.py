"""A co-simulation FMU, version 2.0 or 3.0, as a component in this process."""

from __future__ import annotations

from orchestrator.fmi.functions import Channel, CoSimulation, Fmi2, Fmi3
from orchestrator.fmi.instance import Instance, stepping


class Slave(Instance[CoSimulation]):
    """An instance of a co-simulation FMU, which steps by itself."""

    adapters = (Fmi2, Fmi3)

    @property
    def adapter(self) -> CoSimulation:
        """The FMU's functions."""
        return self._fmi

    @property
    def channels(self) -> tuple[Channel, Channel]:
        """What `write` and `read` carry."""
        return self._inputs, self._outputs

    def step(self, time: float, duration: float) -> None:
        self.stepped(self._fmi.step(time, duration), time, duration)

    def stepped(self, status: int, time: float, duration: float) -> None:
        """Take note of how a step went."""
        status = self._fmi.judged(status)
        if status:
            self._check(status, stepping(time, duration), self._fmi.ending)
