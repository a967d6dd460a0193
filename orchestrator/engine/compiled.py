"""Which loop steps a system: the compiled one where it knows all that is to be done, else the one in Python.

The compiled loop calls the functions of FMUs by address. Where it stops, the component is told what its FMU returned,
so that the error is the one that the Python loop would have raised.
"""

from __future__ import annotations

import ctypes
import functools
import logging
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, NoReturn

import numpy as np

from fmus.errors import WiringError
from orchestrator.engine.iterated import IteratedLoop
from orchestrator.engine.loop import Loop, Node, Stepper
from orchestrator.engine.recording import Recorder
from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.fmi.functions.co_simulation import Fmi3
from orchestrator.fmi.functions.values import VariableGroup
from orchestrator.fmi.instance import stepping
from orchestrator.fmi.slave import Slave
from orchestrator.trace import FloatArray

try:
    from orchestrator.engine import _compiled

    _compiled.Stage.VALUE  # noqa: B018 - not there in what was built from older sources
except (ImportError, AttributeError):  # no compiler at installation
    _compiled = None  # type: ignore[assignment]

LOG = logging.getLogger("servotwin.engine")
NOT_BUILT = "it was not built at installation, for want of a C compiler"
BUDGET = 0.05  # between two turns of Python [s]
_CLOCKS = 64  # of one component
Row = tuple[int, ...]  # a value or a call in the terms of the extension


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
    foreign = [node.component.name for node in loop.nodes if type(node.component) not in (Slave, ClockedSlave)]
    if foreign:
        return f"{foreign[0]} is no co-simulation FMU in this process"
    for node in loop.nodes:
        if reason := _obstacle_at(node):
            return reason
    if any(len(group) > 1 or group[0].feeds_itself for group in loop.groups):
        return "there is a cycle of direct feed-through to be iterated"
    return ""


def _obstacle_at(node: Node) -> str:
    """Why the compiled loop cannot step this FMU, nothing when it can."""
    component = node.component
    if isinstance(component, Slave) and component.tells:
        return f"{component.name} gives texts"
    if node.tells or node.hears:
        return f"texts of {component.name} are connected"
    if node.ticks:
        return f"{component.name} ticks the clocks of others"
    return _obstacle_of_clocks(component) if isinstance(component, ClockedSlave) else ""


def _obstacle_of_clocks(component: ClockedSlave) -> str:
    """Why the compiled loop cannot tick its clocks, nothing when it can."""
    if not hasattr(_compiled.Stage, "FLOODED"):
        return "it was built from older sources"
    if not component.steady:
        return f"{component.name} has clocks whose intervals change"
    many = len(component.schedule.references) > _CLOCKS
    return f"{component.name} has more than {_CLOCKS} clocks" if many else ""


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
        slots = _addresses(self._values)
        self._nodes = [_FmuNode(node, slots) for node in loop.nodes]
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
        self._clocked = [n for n, fmu in enumerate(self._nodes) if isinstance(fmu.slave, ClockedSlave)]
        for n in self._clocked:
            self._core.add_event(n, *self._nodes[n].events())

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
        for n in self._clocked:
            self._nodes[n].load(self._core, n)
        self._core.run(last, BUDGET, recorder.rows, recorder.every)
        for n in self._clocked:
            self._nodes[n].unload(self._core, n)
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
        fmu, status = self._nodes[self._core.failing], self._core.status
        if self._core.stage == _compiled.Stage.MISFIT:
            fmu.slave.write(fmu.held.tolist())
        elif self._core.stage == _compiled.Stage.WRITE:
            fmu.slave.written(status)
        elif self._core.stage == _compiled.Stage.STEP:
            clocked = isinstance(fmu.slave, ClockedSlave)
            at = (self._core.at, self._core.span) if clocked else (self._loop.time(self.tick), fmu.node.duration)
            fmu.slave.stepped(status, *at)
        elif self._core.stage == _compiled.Stage.VALUE:
            doing = stepping(self._loop.time(self.tick), fmu.node.duration)
            self._loop.require_finite(fmu.node, fmu.slave.read(), doing)
        elif isinstance(fmu.slave, ClockedSlave) and self._core.stage != _compiled.Stage.READ:
            self._fail_event(fmu.slave, status)
        else:
            fmu.slave.got(status)
        raise AssertionError(f"{fmu.slave.name}: the compiled loop stopped at status {status}, the slave did not")

    def _fail_event(self, slave: ClockedSlave, status: int) -> None:
        """Raise what went wrong in an event."""
        core, stage = self._core, _compiled.Stage
        if core.stage == stage.ENTER:
            slave.entered(status)
        elif core.stage == stage.TICK:
            references = slave.schedule.references
            slave.ticked(status, [one for bit, one in enumerate(references) if core.ticking >> bit & 1])
        elif core.stage == stage.UPDATE:
            slave.updated(status, core.at)
        elif core.stage == stage.LEAVE:
            slave.left(status)
        elif core.stage == stage.ENDING:
            slave.ends(core.at)
        elif core.stage == stage.TURNS:
            slave.unsettled(core.at)
        elif core.stage == stage.EVENTS:
            slave.crowded(core.at)
        elif core.stage == stage.FLOODED:
            slave.flooded(core.at)
        else:
            slave.stuck(core.at, core.span)


class _FmuNode:
    """A node in the terms of the extension.

    Attributes:
        held: (n,) its inputs as floats.
        inputs: their addresses.
        deferred: its outputs that are not instant, as (kind, address in the FMU's type, address as float).
    """

    def __init__(self, node: Node, slots: Sequence[int]) -> None:
        assert isinstance(node.component, Slave)
        self.node, self.slave = node, node.component
        self.held = np.zeros(len(node.sources))
        self.inputs = _addresses(self.held)
        self._sources = [slots[slot] for slot in node.sources]
        inputs, outputs = self.slave.bound
        self._packed, self._writing = _moved(inputs, self.inputs, "set", True)
        self._parts: list[list[Row]] = []  # calls that set the inputs of each part
        for part in self.slave.parts if isinstance(self.slave, ClockedSlave) else ():
            places = [self.inputs[place] for place in part.places]
            packed, calls = _moved(part.group, places, "set", _side_by_side(part.places))
            self._packed += packed
            self._parts.append(calls)
        own = slots[node.first : node.first + len(node.instant)]
        unpacked, self._reading = _moved(outputs, own, "get", all(node.instant))
        at_once = {address for address, instant in zip(own, node.instant, strict=True) if instant}
        self._instant = [value for value in unpacked if value[2] in at_once]
        self.deferred = [value for value in unpacked if value[2] not in at_once]

    def described(self) -> tuple[Any, ...]:
        """Arguments of `Core.add_node` after the rate."""
        node, fmi = self.node, self.slave.functions
        modern = isinstance(fmi, Fmi3)
        flags = [*map(ctypes.addressof, fmi.flags)] if isinstance(fmi, Fmi3) else []
        asking = ("GetBooleanStatus", "GetRealStatus")
        scale = None if node.scale is None else np.ascontiguousarray(np.array(node.scale, dtype=float).T).ravel()
        return (
            3 if modern else 2,
            ctypes.addressof(fmi.handle),
            _entry(fmi.do_step),
            flags,
            ctypes.addressof(fmi.reached),
            [] if modern or not all(map(fmi.has, asking)) else [_entry(fmi.function(name)) for name in asking],
            node.duration,
            self._sources,
            scale,
            self.inputs,
            self._packed,
            self._writing,
            self._reading,
            self._instant,
            self.deferred,
        )

    def events(self) -> tuple[Any, ...]:
        """Arguments of `Core.add_event` after the number."""
        slave, fmi = self.slave, self.slave.functions
        assert isinstance(slave, ClockedSlave)
        names = ("EnterEventMode", "SetClock", "UpdateDiscreteStates", "EnterStepMode")
        plain: list[Row] = []
        discrete: list[Row] = []
        clocked: list[Row] = []
        masks: list[int] = []
        watched: list[int] = []
        bits = {reference: 1 << bit for bit, reference in enumerate(slave.schedule.references)}
        clocks = self.slave.interface.clocks
        for part, calls in zip(slave.parts, self._parts, strict=True):
            if part.clocks:
                clocked += calls
                masks += [sum(bits.get(clocks[name].reference, 0) for name in part.clocks)] * len(calls)
            elif part.discrete:
                discrete += calls
                watched += [*part.places]
            else:
                plain += calls
        self._flags, self._time = (ctypes.c_bool * 5)(), ctypes.c_double()
        memory = [ctypes.addressof(self._flags), ctypes.addressof(self._time)]
        functions = [_entry(fmi.function(name)) for name in names]
        return functions, [*bits], plain, discrete, clocked, masks, watched, memory

    def load(self, core: Any, number: int) -> None:
        """Have the core begin where the slave is."""
        assert isinstance(self.slave, ClockedSlave)
        next_event, due, in_event = self.slave.where()
        core.load(number, self.slave.schedule.positions, next_event, due, in_event, [*self.slave.wanted])

    def unload(self, core: Any, number: int) -> None:
        """Have the slave be where the core is."""
        assert isinstance(self.slave, ClockedSlave)
        numbers, next_event, due, in_event = core.unload(number)
        self.slave.schedule.put(numbers)
        self.slave.moved(next_event, due, in_event, self.held.tolist())


def _side_by_side(places: Sequence[int]) -> bool:
    return [*places] == list(range(places[0], places[0] + len(places)))


def _moved(group: VariableGroup, floats: Sequence[int], verb: str, direct: bool) -> tuple[list[Row], list[Row]]:
    """The values of a group that are converted between the FMU's types and floats, and the calls that get or set
    all; where it may be `direct`, floats that lie side by side are not converted: the FMU is given their place."""
    values: list[Row] = []
    calls: list[Row] = []
    for typed in group.typed:
        kind, size, places = _storage(typed.kind, typed.ctype), ctypes.sizeof(typed.ctype), typed.places
        memory, total = ctypes.addressof(typed.values), len(typed.values)
        side_by_side = typed.in_order and places[-1] - places[0] == total - 1
        if direct and kind == _compiled.Storage.FLOAT64 and side_by_side:
            memory = floats[places[0]]
        else:
            values += [
                (kind, memory + size * slot, floats[place]) for slot, place in zip(typed.slots, places, strict=True)
            ]
        width = size if kind in (_compiled.Storage.FLOAT64, _compiled.Storage.FLOAT32) else 0
        references = ctypes.addressof(typed.references), len(typed.references)
        calls.append((_entry(getattr(typed, verb)), *references, memory, total, width))
    return values, calls


def _addresses(values: FloatArray) -> list[int]:
    first = int(values.__array_interface__["data"][0])
    return list(range(first, first + values.nbytes, values.itemsize))


@functools.cache
def _storage(kind: str, ctype: Any) -> int:
    """How the extension calls an FMI type kept as this C type."""
    size = ctypes.sizeof(ctype)
    if kind == "Boolean":
        return int(_compiled.Storage.BOOL if size == 1 else _compiled.Storage.FLAG)
    if ctype in (ctypes.c_double, ctypes.c_float):
        return int(_compiled.Storage.FLOAT64 if size == 8 else _compiled.Storage.FLOAT32)
    signed = ctype(-1).value == -1
    return int(getattr(_compiled.Storage, f"{'' if signed else 'U'}INT{8 * size}"))


def _entry(function: Any) -> int:
    """Its address."""
    return ctypes.c_size_t.from_buffer(function).value
