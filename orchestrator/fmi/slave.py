"""A co-simulation FMU, version 2.0 or 3.0, as a component in this process."""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from typing import NoReturn

from fmus.errors import FmuEnded, StepDiscarded, TangentsMissing
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.functions.base import DISCARD
from orchestrator.fmi.functions.co_simulation import CoSimulation, Fmi2, Fmi3
from orchestrator.fmi.functions.values import VariableGroup
from orchestrator.fmi.instance import FmuInstance
from orchestrator.fmi.interface import Port, tangent
from orchestrator.fmi.interface import along as names_along
from orchestrator.fmi.status import returned, stepping


class Slave(FmuInstance[CoSimulation]):
    """An instance of a co-simulation FMU, which steps by itself."""

    versions = (Fmi2, Fmi3)
    _asked = False  # to stop, at the end of the latest step
    _directions = 0  # of the tangents that it carries

    def __init__(self, fmu: FmuFile, name: str) -> None:
        self._seeds: dict[object, tuple[VariableGroup, list[float]]] = {}  # what tangents begin with
        super().__init__(fmu, name)

    @property
    def functions(self) -> CoSimulation:
        """The FMU's functions."""
        return self._fmi

    @property
    def bound(self) -> tuple[VariableGroup, VariableGroup]:
        """What `write` and `read` carry."""
        return self._inputs, self._outputs

    @property
    def tells(self) -> bool:
        """Whether there are texts among what `read` carries."""
        return bool(self._outputs.texts)

    @property
    def carries(self) -> bool:
        """Whether it can carry tangents."""
        return self._fmi.carries

    def carry(self, directions: int, along: Mapping[str, int]) -> None:
        """Carry tangents until the next reset.

        Args:
            along: variable -> number of the direction in which it moves by 1, from 0.

        Raises:
            TangentsMissing: a variable cannot have any.
        """
        self._directions = directions
        self._check(self._fmi.vendor("CarryTangents")(self._fmi.handle, ctypes.c_size_t(directions)), "carry tangents")
        key = directions, tuple(along.items())
        if key not in self._seeds:
            names = [name for variable in along for name in names_along(variable, directions)]
            seeds = [float(number == own) for own in along.values() for number in range(directions)]
            self._seeds[key] = self._group(*names), seeds
        group, seeds = self._seeds[key]
        if status := group.write(seeds):
            problem = self._failure("set tangents", returned(status)).problem
            raise TangentsMissing(self.name, problem, "take differences")

    def reset(self) -> bool:
        moved = super().reset()
        if moved:
            self._seeds.clear()
        return moved

    def begin(self, start: float, stop: float | None, tolerance: float | None = None) -> None:
        self._asked = False
        super().begin(start, stop, tolerance)

    def _port(self, name: str) -> Port:
        return tangent(self.interface, name, self._directions) or super()._port(name)

    def step(self, time: float, duration: float) -> None:
        if self._asked:
            self.over(time)
        self.stepped(self._fmi.step(time, duration), time, duration)

    def over(self, time: float) -> NoReturn:
        """Say that it asked to stop at a time [s]."""
        raise FmuEnded(self.name, f"asked to stop at t = {time:g} s")

    def stepped(self, status: int, time: float, duration: float) -> None:
        """Take note of how a step went. An FMU that asked to stop at its very end does so before the next one."""
        stop = self._fmi.stop(status, time)
        if stop is None:
            if status == DISCARD:
                what = self._failure(stepping(time, duration), returned(status))
                fix = "it did not get through the whole step: give the run a shorter `step`"
                raise StepDiscarded(what.place, what.problem, fix)
            if status:
                self._check(status, stepping(time, duration))
        elif stop.whole(time, duration):
            self._asked = stop.asked
        elif stop.asked and not self._complained:
            raise FmuEnded(self.name, str(stop))
        else:
            raise self._failure(stepping(time, duration), str(stop))
