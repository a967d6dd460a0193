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
from orchestrator.engine.loop import Loop, Node, Stepper
from orchestrator.engine.recording import Recorder
from orchestrator.fmi.functions import Channel, Fmi3
from orchestrator.fmi.slave import Slave
from orchestrator.trace import FloatArray

try:
    from orchestrator.engine import _compiled
except ImportError:  # no compiler at installation
    _compiled = None  # type: ignore[assignment]

LOG = logging.getLogger("servotwin.engine")
NOT_BUILT = "it was not built at installation, for want of a C compiler"
BUDGET = 0.05  # between two turns of Python [s]
Row = tuple[int, ...]  # a value or a call in the terms of the extension


class Engine(StrEnum):
    """Which loop steps: the compiled one where it can, always Python's, or the compiled one or nothing."""

    AUTO = "auto"
    PYTHON = "python"
    COMPILED = "compiled"


def available() -> bool:
    """Whether the compiled loop was built."""
    return _compiled is not None


def stepper(loop: Loop, ticks: int, engine: Engine) -> tuple[Stepper, str]:
    """What steps this loop for so many ticks, and where that is Python's loop, why.

    Raises:
        WiringError: the compiled loop was demanded and cannot.
    """
    if engine is Engine.PYTHON:
        return loop, "it was asked for"
    reason = _obstacle(loop, ticks)
    if not reason:
        return CompiledLoop(loop), ""
    if engine is Engine.COMPILED:
        raise WiringError("engine", f"cannot be the compiled one: {reason}", "leave it to `auto`")
    _say(reason)
    return loop, reason


def _obstacle(loop: Loop, ticks: int) -> str:
    """Why the compiled loop cannot step this, nothing when it can."""
    if not available():
        return NOT_BUILT
    foreign = [node.component.name for node in loop.nodes if type(node.component) is not Slave]
    if foreign:
        return f"{foreign[0]} is no co-simulation FMU in this process"
    if any(len(group) > 1 or group[0].feeds_itself for group in loop.groups):
        return "there is a cycle of direct feed-through to be iterated"
    if not loop.time.exact(ticks):
        return "the times of its ticks have too many digits"
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
        self._values = np.array(loop.values, dtype=float)
        slots = _addresses(self._values)
        self._nodes = [_FmuNode(node, slots) for node in loop.nodes]
        inputs = {id(each.node): each.inputs for each in self._nodes}
        self._core = _compiled.Core(
            len(self._nodes),
            np.ascontiguousarray(loop.stimuli),
            slots[loop.first_stimulus :],
            loop.hold,
            (loop.time.first, loop.time.each, loop.time.denominator),
            [slots[slot] for slot in loop.record_slots],
            [inputs[id(node)][place] for node, place in loop.record_inputs],
        )
        rates: dict[int, list[Row]] = {}
        for each in self._nodes:
            rates.setdefault(each.node.every, []).extend(each.deferred)
        for every, deferred in rates.items():
            self._core.add_rate(every, deferred)
        number = {every: rate for rate, every in enumerate(rates)}
        for each in self._nodes:
            self._core.add_node(number[each.node.every], *each.described())

    @property
    def tick(self) -> int:
        return self._core.tick

    @property
    def recorded(self) -> int:
        return self._core.recorded

    def advance(self, last: int, recorder: Recorder) -> None:
        self._core.base = recorder.base
        self._core.run(last, BUDGET, recorder.rows, recorder.every)
        if self._core.stage != _compiled.Stage.RUNNING:
            self._fail()

    def finish(self) -> None:
        loop, core = self._loop, self._core
        loop.tick, loop.recorded = core.tick, core.recorded
        loop.values[:] = self._values.tolist()
        for n, each in enumerate(self._nodes):
            node, statistics = each.node, each.node.statistics
            statistics.calls, statistics.seconds, warnings = core.statistics(n)
            each.slave.warnings = each.warnings + warnings
            node.held = each.held.tolist()

    def held(self, slots: Sequence[int]) -> list[float]:
        return [self._values.item(slot) for slot in slots]

    def _fail(self) -> NoReturn:
        """Raise the error of the Python loop."""
        each, status = self._nodes[self._core.failing], self._core.status
        if self._core.stage == _compiled.Stage.MISFIT:
            each.slave.write(each.held.tolist())
        elif self._core.stage == _compiled.Stage.WRITE:
            each.slave.written(status)
        elif self._core.stage == _compiled.Stage.STEP:
            each.slave.stepped(status, self._loop.time(self.tick), each.node.duration)
        else:
            each.slave.got(status)
        raise AssertionError(f"{each.slave.name}: the compiled loop stopped at status {status}, the slave did not")


class _FmuNode:
    """A node in the terms of the extension.

    Attributes:
        held: (n,) its inputs as floats.
        inputs: their addresses.
        deferred: its outputs that are not instant, as (kind, address in the FMU's type, address as float).
        warnings: those before the first step.
    """

    def __init__(self, node: Node, slots: Sequence[int]) -> None:
        assert isinstance(node.component, Slave)
        self.node, self.slave, self.warnings = node, node.component, node.component.warnings
        self.held = np.zeros(len(node.sources))
        self.inputs = _addresses(self.held)
        self._sources = [slots[slot] for slot in node.sources]
        inputs, outputs = self.slave.channels
        self._packed, self._writing = _moved(inputs, self.inputs, "set", True)
        own = slots[node.first : node.first + len(node.instant)]
        unpacked, self._reading = _moved(outputs, own, "get", all(node.instant))
        at_once = {address for address, instant in zip(own, node.instant, strict=True) if instant}
        self._instant = [value for value in unpacked if value[2] in at_once]
        self.deferred = [value for value in unpacked if value[2] not in at_once]

    def described(self) -> tuple[Any, ...]:
        """Arguments of `Core.add_node` after the rate."""
        node, fmi = self.node, self.slave.adapter
        flags = [*map(ctypes.addressof, fmi.flags), ctypes.addressof(fmi.reached)] if isinstance(fmi, Fmi3) else None
        scale = None if node.scale is None else np.ascontiguousarray(np.array(node.scale, dtype=float).T).ravel()
        return (
            3 if flags else 2,
            fmi.handle.value,
            _entry(fmi.do_step),
            flags,
            node.duration,
            self._sources,
            scale,
            self.inputs,
            self._packed,
            self._writing,
            self._reading,
            self._instant,
        )


def _moved(channel: Channel, floats: Sequence[int], verb: str, direct: bool) -> tuple[list[Row], list[Row]]:
    """The values of a channel that are converted between the FMU's types and floats, and the calls that get or set
    all; where it may be `direct`, floats that lie side by side are not converted: the FMU is given their place."""
    values: list[Row] = []
    calls: list[Row] = []
    for group in channel.groups:
        kind, size, places = _kind(group.kind, group.ctype), ctypes.sizeof(group.ctype), group.places
        typed, count = ctypes.addressof(group.values), len(places)
        if direct and kind == _compiled.Kind.FLOAT64 and places[-1] - places[0] == count - 1:
            typed = floats[places[0]]
        else:
            values += [(kind, typed + size * i, floats[place]) for i, place in enumerate(places)]
        calls.append((_entry(getattr(group, verb)), ctypes.addressof(group.references), count, typed))
    return values, calls


def _addresses(values: FloatArray) -> list[int]:
    first = int(values.__array_interface__["data"][0])
    return list(range(first, first + values.nbytes, values.itemsize))


@functools.cache
def _kind(kind: str, ctype: Any) -> int:
    """How the extension calls an FMI type kept as this C type."""
    size = ctypes.sizeof(ctype)
    if kind == "Boolean":
        return int(_compiled.Kind.BOOL if size == 1 else _compiled.Kind.FLAG)
    if ctype in (ctypes.c_double, ctypes.c_float):
        return int(_compiled.Kind.FLOAT64 if size == 8 else _compiled.Kind.FLOAT32)
    signed = ctype(-1).value == -1
    return int(getattr(_compiled.Kind, f"{'' if signed else 'U'}INT{8 * size}"))


def _entry(function: Any) -> int:
    """Its address."""
    return ctypes.c_size_t.from_buffer(function).value
