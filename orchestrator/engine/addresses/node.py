"""An FMU of a loop in the terms of the compiled one."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from typing import Any

import numpy as np

from orchestrator.engine._compiled import Storage
from orchestrator.engine.addresses.memory import addresses, entry, moved
from orchestrator.engine.loop import LoopNode
from orchestrator.fmi.functions.co_simulation import Fmi3
from orchestrator.fmi.slave import Slave


class FmuNode:
    """A node in the terms of the extension.

    Attributes:
        held: (n,) its inputs as floats.
        inputs: their addresses.
        outputs: kind and address in the FMU's type of each of its outputs.
        deferred: its outputs that are not instant, as (kind, address in the FMU's type, address as float).
    """

    def __init__(self, node: LoopNode, slots: Sequence[int]) -> None:
        assert isinstance(node.component, Slave)
        self.node, self.slave = node, node.component
        self.held = np.zeros(len(node.sources))
        self.inputs = addresses(self.held)
        self._sources = [slots[slot] for slot in node.sources]
        inputs, outputs = self.slave.bound
        self._packed, self._writing = moved(inputs, self.inputs, "set", True)
        own = slots[node.first : node.first + len(node.instant)]
        unpacked, self._reading = moved(outputs, own, "get", all(node.instant))
        typed = {address: (kind, memory) for kind, memory, address in unpacked}
        self.outputs = [typed.get(address, (int(Storage.FLOAT64), address)) for address in own]
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
            entry(fmi.do_step),
            flags,
            ctypes.addressof(fmi.reached),
            [] if modern or not all(map(fmi.has, asking)) else [entry(fmi.function(name)) for name in asking],
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
