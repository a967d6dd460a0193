"""Which loop steps a system: the compiled one where it knows all that is to be done, else the one in Python.

The compiled loop calls the functions of FMUs by address. Where it stops, the component is told what its FMU returned,
so that the error is the one that the Python loop would have raised.
"""

from __future__ import annotations

import ctypes
import functools
import logging
from enum import StrEnum
from typing import Any, NoReturn

import numpy as np

from fmus.errors import WiringError
from orchestrator.engine.loop import Loop, Node, Stepper
from orchestrator.engine.recording import Recorder
from orchestrator.fmi import Channel, Fmi3
from orchestrator.slave import Slave
from orchestrator.trace import FloatArray

try:
    from orchestrator.engine import _compiled
except ImportError:  # no compiler at installation
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
    LOG.log(logging.WARNING if reason is NOT_BUILT else logging.INFO,
            "stepping in Python, not in the compiled loop: %s", reason)  # fmt: skip


class CompiledLoop:
    """A loop that is stepped by the extension; `finish` hands values and statistics back to it."""

    def __init__(self, loop: Loop) -> None:
        self._loop = loop
        self._nodes = [_FmuNode(node) for node in loop.nodes]
        self._values = np.array(loop.values, dtype=float)
        number = {id(each.node): n for n, each in enumerate(self._nodes)}
        recorded_inputs = [(number[id(node)], place) for node, place in loop.record_inputs]
        self._core = _compiled.Core(
            len(self._nodes),
            self._values,
            (np.ascontiguousarray(loop.stimuli), loop.first_stimulus, loop.hold),
            (loop.time.first, loop.time.each, loop.time.denominator),
            np.array(loop.record_slots, dtype=np.int32),
            np.array(recorded_inputs, dtype=np.int32).reshape(-1, 2),
        )
        for each in self._nodes:
            self._core.add(*each.described())

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
        loop.pending = {}
        for n, each in enumerate(self._nodes):
            statistics = each.node.statistics
            statistics.calls, statistics.seconds, warnings = core.statistics(n)
            each.slave.warnings = each.warnings + warnings
            each.node.held = each.held.tolist()
            arrival = core.arrival(n)
            if arrival is not None:
                loop.defer(each.node, each.staged.tolist(), arrival)

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
        held, staged: (n,) its inputs and outputs as floats; where all are of that type, the memory the FMU is given.
        warnings: those before the first step.
    """

    def __init__(self, node: Node) -> None:
        assert isinstance(node.component, Slave)
        self.node, self.slave, self.warnings = node, node.component, node.component.warnings
        inputs, outputs = self.slave.channels
        self.held, self._written = _memory(inputs, len(node.sources), "set")
        self.staged, self._read = _memory(outputs, len(node.instant), "get")

    def described(self) -> tuple[Any, ...]:
        """Arguments of `Core.add`."""
        node, fmi = self.node, self.slave.adapter
        flags = [*map(ctypes.addressof, fmi.flags), ctypes.addressof(fmi.reached)] if isinstance(fmi, Fmi3) else None
        return (
            3 if flags else 2,
            fmi.handle.value,
            _address(fmi.do_step),
            flags,
            node.every,
            node.duration,
            np.array(node.sources, dtype=np.int32),
            None if node.scale is None else np.ascontiguousarray(np.array(node.scale, dtype=float).T).ravel(),
            self.held.ctypes.data,
            node.first,
            np.array(node.instant, dtype=np.uint8),
            self.staged.ctypes.data,
            self._written,
            self._read,
        )


def _memory(channel: Channel, size: int, verb: str) -> tuple[FloatArray, list[tuple[Any, ...]]]:
    """Memory for the values of a channel as floats, and its groups as `Core.add` wants them."""
    shared = [_kind(group.kind, group.ctype) for group in channel.groups] == [_compiled.Kind.FLOAT64]
    memory = np.frombuffer(channel.groups[0].values) if shared else np.zeros(size)
    groups = []
    for group in channel.groups:
        kind = _kind(group.kind, group.ctype)
        low, beyond = _range(group.ctype)
        places = None if shared else np.array(group.places, dtype=np.int32)
        pointers = [ctypes.addressof(group.references), ctypes.addressof(group.values), _address(getattr(group, verb))]
        groups.append((kind, len(group.places), *pointers, places, low, beyond))
    return memory, groups


def _kind(kind: str, ctype: Any) -> int:
    """How the extension calls an FMI type kept as this C type."""
    size = ctypes.sizeof(ctype)
    if kind == "Boolean":
        return int(_compiled.Kind.BOOL if size == 1 else _compiled.Kind.FLAG)
    if ctype in (ctypes.c_double, ctypes.c_float):
        return int(_compiled.Kind.FLOAT64 if size == 8 else _compiled.Kind.FLOAT32)
    signed = ctype(-1).value == -1
    return int(getattr(_compiled.Kind, f"{'' if signed else 'U'}INT{8 * size}"))


def _range(ctype: Any) -> tuple[float, float]:
    """Least whole number of a C type, and the first beyond its greatest."""
    bits = 8 * ctypes.sizeof(ctype)
    return (-(2.0 ** (bits - 1)), 2.0 ** (bits - 1)) if ctype(-1).value == -1 else (0.0, 2.0**bits)


def _address(function: Any) -> int | None:
    return ctypes.cast(function, ctypes.c_void_p).value
