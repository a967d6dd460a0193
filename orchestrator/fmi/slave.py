"""A co-simulation FMU, version 2.0 or 3.0, as a component in this process."""

from __future__ import annotations

from orchestrator.fmi.functions import CoSimulation, Fmi2, Fmi3, VariableGroup
from orchestrator.fmi.instance import FmuInstance, stepping


class Slave(FmuInstance[CoSimulation]):
    """An instance of a co-simulation FMU, which steps by itself."""

    versions = (Fmi2, Fmi3)

    @property
    def functions(self) -> CoSimulation:
        """The FMU's functions."""
        return self._fmi

    @property
    def bound(self) -> tuple[VariableGroup, VariableGroup]:
        """What `write` and `read` carry."""
        return self._inputs, self._outputs

    def step(self, time: float, duration: float) -> None:
        self.stepped(self._fmi.step(time, duration), time, duration)

    def stepped(self, status: int, time: float, duration: float) -> None:
        """Take note of how a step went."""
        status = self._fmi.judged(status)
        if status:
            self._check(status, stepping(time, duration), self._fmi.ending)
