"""A bus of serial adapters for tests, and the command line as a process on it."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import can

from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.slcan.bus import SlcanBus
from tests.support.commands import process

BITRATE = 500_000
HANG = 300.0  # far more than anything here takes on a busy computer [s]


def settings(port: Path, **others: Any) -> BusSettings:
    """An adapter at the bit rate of the bus."""
    return BusSettings("slcan", str(port), **{"bitrate": BITRATE} | others)


def frame(number: int, identifier: int = 0x100) -> can.Message:
    """A frame that carries a number."""
    return can.Message(arbitration_id=identifier, is_extended_id=False, data=number.to_bytes(8, "big"))


def number(message: can.Message) -> int:
    return int.from_bytes(message.data, "big")


def heard(bus: can.BusABC, count: int) -> list[can.Message]:
    """The next frames, however long so many take to come, and any that come right behind them."""
    messages: list[can.Message] = []
    while (message := bus.recv(HANG if len(messages) < count else 0.05)) is not None:
        messages.append(message)
    return messages


def wait_for(condition: Callable[[], Any], patience: float = HANG) -> None:
    """Wait until something is so; fail when it never is."""
    until = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        time.sleep(0.01)


@contextmanager
def command(*arguments: object) -> Iterator[subprocess.Popen[str]]:
    """`servotwin` as a process of its own, which is gone at the end."""
    running = process(*arguments)
    try:
        yield running
    finally:
        running.kill()
        running.communicate()


def until_said(process: subprocess.Popen[str], words: str) -> None:
    """Wait until the process says these words on stderr; fail when it ends without them."""
    assert process.stderr is not None
    lines = []
    for line in process.stderr:
        lines.append(line)
        if words in line:
            return
    raise AssertionError(f"never said '{words}': {''.join(lines)}")


@contextmanager
def joined(port: Path, **others: Any) -> Iterator[SlcanBus]:
    """An adapter that is on the bus by now: it has answered when it was opened."""
    with opened(settings(port, **others)) as bus:
        assert isinstance(bus, SlcanBus)
        yield bus
