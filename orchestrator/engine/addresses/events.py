"""The clocks and events of an FMU in the terms of the compiled loop, and how what went wrong with them is told."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from orchestrator.engine._compiled import Core, Interval, Stage
from orchestrator.engine.addresses.memory import addresses, entry, moved, side_by_side
from orchestrator.engine.addresses.node import FmuNode
from orchestrator.engine.loop import Ticks
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.clocks import declared

MOST = 64  # input clocks of one component
_KINDS = {
    declared.TickInterval.TUNABLE: Interval.TUNABLE,
    declared.TickInterval.CHANGING: Interval.CHANGING,
    declared.TickInterval.COUNTDOWN: Interval.COUNTDOWN,
}
_CALLED = ("EnterEventMode", "SetClock", "GetClock", "UpdateDiscreteStates", "GetIntervalDecimal", "EnterStepMode")


def inputs_of(slave: ClockedSlave) -> list[int]:
    """References of its input clocks, in rising order; the place of each is its bit."""
    return sorted(clock.reference for clock in slave.interface.clocks.values() if clock.causality == "input")


class FmuEvents:
    """The events of one FMU, which is the node of a number in the core."""

    def __init__(self, core: Core, number: int, fmu: FmuNode) -> None:
        assert isinstance(fmu.slave, ClockedSlave)
        self._core, self._number, self._fmu, self._slave = core, number, fmu, fmu.slave
        self._given = np.zeros(len(fmu.held))
        clocks, places = self._slave.interface.clocks, inputs_of(self._slave)
        self._bits = {name: 1 << places.index(one.reference) for name, one in clocks.items() if one.reference in places}
        self._outputs = [name for name, clock in clocks.items() if clock.causality == "output"]
        core.add_event(
            number,
            [entry(self._slave.functions.function(name)) for name in _CALLED],
            places,
            [
                (int(_KINDS.get(timed.clock.kind, Interval.STEADY)), places.index(reference), timed)
                for reference, timed in self._slave.schedule.timed.items()
            ],
            [clocks[name].reference for name in self._outputs],
            self._parts(),
            *addresses(self._given)[:1] or [0],
        )

    def _parts(self) -> list[tuple[Any, ...]]:
        """Its inputs by when they are set."""
        given, found = addresses(self._given), []
        for part in self._slave.parts:
            places = [given[place] for place in part.places]
            packed, calls = moved(part.group, places, "set", side_by_side(part.places))
            mask = sum(self._bits.get(name, 0) for name in part.clocks)
            found.append((packed, calls, part.places, part.discrete, bool(part.clocks), mask))
        return found

    def route(self, ticks: Ticks, others: Mapping[int, FmuEvents]) -> tuple[int, int, list[int], list[tuple[Any, ...]]]:
        """Ticks that go to another node, as an argument of `Core.add_routes`; `id` of a node -> its events."""
        target = others[id(ticks.target)]
        masks = [sum(target._bits[name] for name in ticks.clocks.get(clock, ())) for clock in self._outputs]
        along = [
            (*self._fmu.outputs[own], factor, offset, place) for place, (own, factor, offset) in ticks.inputs.items()
        ]
        return self._number, target._number, masks, along

    def send(self, number: int, ticks: Ticks, others: Mapping[int, FmuEvents]) -> None:
        """Have what ticked in the initialisation wait on the route of a number."""
        bits = others[id(ticks.target)]._bits
        for one in filter(None, map(ticks.arrival, self._slave.passed())):
            self._core.expect(number, one.time, sum(bits[name] for name in one.clocks), [*one.inputs.values()])

    def load(self) -> None:
        """Have the core begin where the slave is."""
        next_event, due, in_event = self._slave.where()
        self._core.load(self._number, next_event, due, in_event, [*self._slave.wanted])

    def unload(self) -> None:
        """Have the slave be where the core is."""
        self._slave.moved(*self._core.unload(self._number), self._fmu.held.tolist())

    def fail(self) -> None:
        """Raise what went wrong in an event."""
        core, slave, status, at = self._core, self._slave, self._core.status, self._core.at
        ticking = [one for bit, one in enumerate(inputs_of(slave)) if core.ticking >> bit & 1]
        raising: dict[int, Callable[[], object]] = {
            Stage.MISFIT: lambda: slave.put(slave.parts[core.part], self._given.tolist()),
            Stage.ENTER: lambda: slave.entered(status),
            Stage.TICK: lambda: slave.calls.ticked(status, ticking),
            Stage.TICKING: lambda: slave.calls.shown(status),
            Stage.UPDATE: lambda: slave.updated(status, at),
            Stage.INTERVALS: lambda: slave.calls.asked(status),
            Stage.INTERVAL: lambda: slave.told(at, [*slave.schedule.timed][core.clock], core.interval),
            Stage.LEAVE: lambda: slave.left(status),
            Stage.ENDING: lambda: slave.ends(at),
            Stage.TURNS: lambda: slave.unsettled(at),
            Stage.EVENTS: lambda: slave.crowded(at),
            Stage.FLOODED: lambda: slave.flooded(at),
            Stage.STUCK: lambda: slave.stuck(at, core.span),
        }
        raising[core.stage]()
