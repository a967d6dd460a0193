"""Instances of FMUs as nodes of a bus: what they send as operations, and operations as what they receive."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Sequence
from typing import Protocol

from orchestrator.fmi.clocked_slave import ClockedSlave
from orchestrator.network.low_cut import LowCut


class BusNode(Protocol):
    """Who is on a bus."""

    name: str

    @property
    def notified(self) -> bool:
        """Whether it is told what becomes of its frames."""

    def reset(self) -> None:
        """A run begins, which knows nothing of those before."""

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        """Times [s] and operations of what it has sent since the last call, for the step that begins at a time."""

    def deliver(self, operations: Sequence[bytes]) -> None:
        """Have it receive operations when its next step begins."""

    def remarks(self) -> list[str]:
        """What it could not send or receive as it is, a line each."""


class LowCutNode:
    """One that exchanges operations itself."""

    def __init__(self, name: str, slave: ClockedSlave, terminal: LowCut) -> None:
        self.name, self._slave, self._terminal = name, slave, terminal
        self.reset()

    @property
    def notified(self) -> bool:
        return bool(self._terminal.notifications and self._slave.begins_with(self._terminal.notifications))

    def reset(self) -> None:
        self._too_long = 0

    def sent(self, time: float) -> Iterable[tuple[float, bytes]]:
        posts = self._slave.fetched((self._terminal.tx_clock,))
        return [(post.time, bytes.fromhex(str(post.values[0]))) for post in posts if post.values[0]]

    def deliver(self, operations: Sequence[bytes]) -> None:
        most = self._terminal.most or sys.maxsize
        fitting = [one for one in operations if len(one) <= most]
        self._too_long += len(operations) - len(fitting)
        for whole in _packed(fitting, most):
            self._slave.deliver(self._terminal.rx_clock, [whole.hex()])

    def remarks(self) -> list[str]:
        most, count = self._terminal.most, self._too_long
        return [f"{count:,} operations that {self.name}, which takes {most} bytes at once, did not get"] * bool(count)


def _packed(operations: Sequence[bytes], most: int) -> Iterable[bytes]:
    """The operations side by side, as many as the FMU takes at once."""
    found: list[bytes] = []
    size = 0
    for one in operations:
        if found and size + len(one) > most:
            yield b"".join(found)
            found, size = [], 0
        found.append(one)
        size += len(one)
    if found:
        yield b"".join(found)
