"""Which loop steps a system: the compiled one where it knows all that is to be done, else the one in Python.

The compiled loop calls the functions of FMUs by address. Where it stops, the component is told what its FMU returned,
so that the error is the one that the Python loop would have raised.
"""

from __future__ import annotations

import functools
import logging
from collections.abc import Sequence
from enum import StrEnum
from typing import NoReturn

import numpy as np

from fmus.errors import WiringError
from orchestrator.engine.iterated import IteratedLoop
from orchestrator.engine.loop import Loop, LoopNode, Stepper
from orchestrator.engine.recording import Recorder
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.slave import Slave
from orchestrator.fmi.status import stepping

try:
    from orchestrator.engine import _compiled

    _compiled.Core.expect  # noqa: B018 - not there in what was built from older sources
    from orchestrator.engine.addresses.events import MOST, FmuEvents, inputs_of
    from orchestrator.engine.addresses.memory import Row, addresses
    from orchestrator.engine.addresses.node import FmuNode
except (ImportError, AttributeError):  # no compiler at installation
    _compiled = None  # type: ignore[assignment]

LOG = logging.getLogger("servotwin.engine")
NOT_BUILT = "it was not built at installation, for want of a C compiler"
BUDGET = 0.05  # between two turns of Python [s]


class Engine(StrEnum):
    """Which loop steps: the compiled one where it can, always Python's, or the compiled one or nothing."""

    AUTO = "auto"
    PYTHON = "python"
    COMPILED = "compiled"


def available() -> bool:
    """Whether the compiled loop was built."""
    return _compiled is not None


class Steppers:
    """What steps a loop, run after run.

    Raises:
        WiringError: the compiled loop is demanded and cannot.
    """

    def __init__(self, loop: Loop, engine: Engine) -> None:
        self._loop, self._engine = loop, engine
        self._obstacle = "it was asked for" if engine is Engine.PYTHON else _obstacle(loop)
        self._compiled = None if self._obstacle else CompiledLoop(loop)
        self._exact = functools.lru_cache(loop.time.exact)

    def chosen(self, ticks: int) -> tuple[Stepper, str]:
        """What steps the loop from where it is for so many ticks; where that is Python's loop, why."""
        reason = self._obstacle
        if not self._exact(ticks):
            reason = reason or "the times of its ticks have too many digits"
        if self._compiled is not None and not reason:
            self._compiled.begin()
            return self._compiled, ""
        if self._engine is Engine.COMPILED:
            raise WiringError("engine", f"cannot be the compiled one: {reason}", "leave it to `auto`")
        if self._engine is Engine.AUTO:
            _say(reason)
        return self._loop, reason


def _obstacle(loop: Loop) -> str:
    """Why the compiled loop cannot step this, nothing when it can."""
    if not available():
        return NOT_BUILT
    if isinstance(loop, IteratedLoop):
        return "steps are iterated"
    for node in loop.nodes:
        if reason := _obstacle_at(node):
            return reason
    if any(len(group) > 1 or group[0].feeds_itself for group in loop.groups):
        return "there is a cycle of direct feed-through to be iterated"
    return ""


def _obstacle_at(node: LoopNode) -> str:
    """Why the compiled loop cannot step this FMU, nothing when it can."""
    component = node.component
    if not isinstance(component, Slave):
        return f"{component.name} is no co-simulation FMU in this process"
    if type(component) not in (Slave, ClockedSlave):
        return f"what {component.name} gives within its steps is kept"
    if component.tells:
        return f"{component.name} gives texts"
    if node.tells or node.hears:
        return f"texts of {component.name} are connected"
    if isinstance(component, ClockedSlave) and len(inputs_of(component)) > MOST:
        return f"{component.name} has more than {MOST} clocks"
    return ""


@functools.cache
def _say(reason: str) -> None:
    """Say it once in a process."""
    LOG.log(
        logging.WARNING if reason is NOT_BUILT else logging.INFO,
        "stepping in Python, not in the compiled loop: %s",
        reason,
    )


class CompiledLoop:
    """A loop that is stepped by the extension; `finish` hands back its statistics and the values that hold at its next
    tick."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._values = np.zeros(len(loop.values))
        slots = addresses(self._values)
        self._nodes = [FmuNode(node, slots) for node in loop.nodes]
        inputs = {id(fmu.node): fmu.inputs for fmu in self._nodes}
        self._core = _compiled.Core(
            len(self._nodes),
            slots[loop.first_stimulus :],
            loop.hold,
            (loop.time.first, loop.time.step, loop.time.denominator),
            [slots[slot] for slot in loop.record_slots],
            [inputs[id(node)][place] for node, place in loop.record_inputs],
            loop.finite,
        )
        rates: dict[int, list[Row]] = {}
        for fmu in self._nodes:
            rates.setdefault(fmu.node.every, []).extend(fmu.deferred)
        for every, deferred in rates.items():
            self._core.add_rate(every, deferred)
        number = {every: rate for rate, every in enumerate(rates)}
        for fmu in self._nodes:
            self._core.add_node(number[fmu.node.every], *fmu.described())
        clocked = {n: fmu for n, fmu in enumerate(self._nodes) if isinstance(fmu.slave, ClockedSlave)}
        self._events = {n: FmuEvents(self._core, n, fmu) for n, fmu in clocked.items()}
        self._targets = {id(fmu.node): self._events[n] for n, fmu in clocked.items()}
        self._ticks = [(self._events[n], ticks) for n, fmu in clocked.items() for ticks in fmu.node.ticks]
        self._core.add_routes([events.route(ticks, self._targets) for events, ticks in self._ticks])

    def begin(self) -> None:
        """Take the loop over at its first tick."""
        self._values[:] = self._loop.values
        self._core.begin(self._loop.stimuli)

    def pass_on(self, writing: bool) -> list[float]:
        if not self._core.pass_on(writing):
            self._fail()
        return list(self._values.tolist())

    @property
    def tick(self) -> int:
        return self._core.tick

    @property
    def recorded(self) -> int:
        return self._core.recorded

    def advance(self, last: int, recorder: Recorder) -> None:
        self._core.base = recorder.base
        for events in self._events.values():
            events.load()
        if self._core.tick == 0:
            for number, (events, ticks) in enumerate(self._ticks):
                events.send(number, ticks, self._targets)
        self._core.run(last, BUDGET, recorder.rows, recorder.every)
        for events in self._events.values():
            events.unload()
        if self._core.stage != _compiled.Stage.RUNNING:
            self._fail()

    def finish(self) -> None:
        loop, core = self._loop, self._core
        loop.tick, loop.recorded = core.tick, core.recorded
        loop.values[:] = self._values.tolist()
        for n, fmu in enumerate(self._nodes):
            node, statistics = fmu.node, fmu.node.statistics
            statistics.calls, statistics.seconds, warnings = core.statistics(n)
            fmu.slave.warnings += warnings
            node.held = fmu.held.tolist()

    def held(self, slots: Sequence[int]) -> list[float]:
        return [self._values.item(slot) for slot in slots]

    def _fail(self) -> NoReturn:
        """Raise the error of the Python loop."""
        fmu, status, stage = self._nodes[self._core.failing], self._core.status, self._core.stage
        events = self._events.get(self._core.failing)
        if stage == _compiled.Stage.MISFIT and self._core.part < 0:
            fmu.slave.write(fmu.held.tolist())
        elif stage == _compiled.Stage.WRITE:
            fmu.slave.written(status)
        elif stage == _compiled.Stage.STEP:
            at = (self._core.at, self._core.span) if events else (self._loop.time(self.tick), fmu.node.duration)
            fmu.slave.stepped(status, *at)
        elif stage == _compiled.Stage.ASKED:
            fmu.slave.over(self._loop.time(self.tick))
        elif stage == _compiled.Stage.VALUE:
            doing = stepping(self._loop.time(self.tick), fmu.node.duration)
            self._loop.require_finite(fmu.node, fmu.slave.read(), doing)
        elif stage == _compiled.Stage.READ:
            fmu.slave.got(status)
        elif events:
            events.fail()
        raise AssertionError(f"{fmu.slave.name}: the compiled loop stopped at status {status}, the slave did not")
