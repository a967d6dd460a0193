"""The process that an isolated component lives in: what it does, and the messages that it gets and gives.

It does what it is told over two pipes; a step, with its inputs and outputs, is one message there and one back. Orders
are pickled; answers are numbers and JSON, for the memory of a process with a broken FMU may be spoilt.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import logging
import os
import pickle
import select
import signal
import struct
import sys
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Any

from fmus.errors import ServotwinError
from orchestrator.fmi.component import Component
from orchestrator.fmi.file import FmuFile
from orchestrator.fmi.said import LOG, REPEATS

CALL, EXCHANGE = b"c", b"x"  # kinds of order: a method with its arguments; inputs and a step for outputs
RESULT, VALUES, ERROR, LOGGED = b"r", b"v", b"e", b"l"  # kinds of answer, and a log message in between
WRITE, STEP = 1, 2  # flags of an exchange: there are inputs; take a step
ORDER = struct.Struct("<Bdd")  # flags, time and duration of the step [s]; then the inputs
_HEAD = struct.Struct("<Ic")  # size of the body, kind
_LARGEST = 1 << 30  # message [bytes]
_OWN = (
    "prepare",
    "make",
    "bind",
    "ticked",
    "reset",
    "save",
    "restore",
    "drop",
)  # methods that are not simply the component's

Make = Callable[[FmuFile, str], Component]


def numbers(count: int) -> struct.Struct:
    """So many numbers."""
    return struct.Struct(f"<{count}d")


def answer(count: int) -> struct.Struct:
    """The count of warnings, then so many numbers."""
    return struct.Struct(f"<Q{count}d")


class MessagePipe:
    """Messages over a pair of pipes, each with its size and kind in front."""

    def __init__(self, reading: int, writing: int) -> None:
        self._reading, self._writing = reading, writing
        self._rest = b""
        self._sending = threading.Lock()  # an FMU may log from a thread of its own
        self._poll = _polled(reading)

    def send(self, kind: bytes, body: bytes) -> None:
        """Say something.

        Raises:
            EOFError: nobody listens any more.
        """
        message = _HEAD.pack(len(body), kind) + body
        with self._sending:
            while message:
                try:
                    message = message[os.write(self._writing, message) :]
                except OSError:
                    raise EOFError from None

    def receive(self, deadline: float | None = None) -> tuple[bytes, bytes]:
        """Kind and body of the next message.

        Raises:
            EOFError: there is none to come.
            TimeoutError: none came until the deadline [s, monotonic clock].
            ValueError: its size cannot be true.
        """
        while (message := self._next()) is None:
            if deadline is not None and not self._poll(1000 * max(0.0, deadline - monotonic())):
                raise TimeoutError
            received = os.read(self._reading, 1 << 16)
            if not received:
                raise EOFError
            self._rest += received
        return message

    def _next(self) -> tuple[bytes, bytes] | None:
        if len(self._rest) < _HEAD.size:
            return None
        size, kind = _HEAD.unpack_from(self._rest)
        if size > _LARGEST:
            raise ValueError(f"a message of {size} bytes")
        end = _HEAD.size + size
        if len(self._rest) < end:
            return None
        body, self._rest = self._rest[_HEAD.size : end], self._rest[end:]
        return kind, body


def _polled(reading: int) -> Callable[[float], object]:
    """What waits for something to read for so many milliseconds; it returns something true when there is."""
    if sys.platform == "win32":
        raise OSError("Windows does not poll pipes")
    poll = select.poll()
    poll.register(reading, select.POLLIN)
    return poll.poll


def serve(life: int) -> None:
    """A worker's life: it does what it is told on standard input and answers on standard output, until that closes.

    Args:
        life: file descriptor of a pipe that is closed when the main process is gone.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    _die_with(life)
    line = MessagePipe(os.dup(0), os.dup(1))
    with Path(os.devnull).open() as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(2, 1)  # what the FMU prints is no answer
    logging.basicConfig(level=logging.DEBUG, handlers=[_Forwarding(line)])
    LOG.removeFilter(REPEATS)  # who gets them counts
    host = _Host()
    with contextlib.suppress(EOFError):
        while True:
            line.send(*host.answer(*line.receive()))


def _die_with(life: int) -> None:
    """Have the kernel kill this process group when the pipe closes.

    No thread could watch for that: an FMU that hangs while it is loaded holds Python's lock.
    """
    os.set_inheritable(life, False)
    if sys.platform == "linux":
        import fcntl  # noqa: PLC0415 (of Unix)

        fcntl.fcntl(life, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(life, fcntl.F_SETOWN, -os.getpgrp())
        fcntl.fcntl(life, fcntl.F_SETFL, fcntl.fcntl(life, fcntl.F_GETFL) | os.O_ASYNC)


class _Host:
    """The component in a worker, and its snapshots by number."""

    _make: Callable[[], Component]

    def __init__(self) -> None:
        self._component: Any = None
        self._inputs, self._outputs = numbers(0), answer(0)
        self._texts: dict[str, int] = {}  # variable -> how many of its texts the other side knows
        self._states: dict[int, Any] = {}
        self._number = itertools.count()

    def answer(self, kind: bytes, body: bytes) -> tuple[bytes, bytes]:
        """Kind and body of what is to be said to an order."""
        try:
            if kind == EXCHANGE:
                return VALUES, self._exchange(body)
            method, arguments = pickle.loads(body)
            result = getattr(self if method in _OWN else self._component, method)(*arguments)
            return RESULT, json.dumps([result, self._warnings()]).encode()
        except ServotwinError as error:
            return ERROR, json.dumps([type(error).__name__, error.place, error.problem, error.fix]).encode()

    def _exchange(self, order: bytes) -> bytes:
        flags, time, duration = ORDER.unpack_from(order)
        if flags & WRITE:
            self._component.write(self._inputs.unpack_from(order, ORDER.size))
        if flags & STEP:
            self._component.step(time, duration)
        read = self._component.read()
        fresh = self._component.news(self._texts) if hasattr(self._component, "news") else []
        return self._outputs.pack(self._warnings(), *read) + (json.dumps(fresh).encode() if fresh else b"")

    def _warnings(self) -> int:
        return int(getattr(self._component, "warnings", 0))

    def prepare(self, make: Make, fmu: FmuFile, name: str) -> None:
        """Take note of what is to be made; to read this order has loaded the libraries that it takes."""
        self._make = partial(make, fmu, name)

    def make(self) -> None:
        self._component = self._make()

    def bind(self, inputs: Sequence[str], outputs: Sequence[str]) -> None:
        self._component.bind(inputs, outputs)
        self._inputs, self._outputs = numbers(len(inputs)), answer(len(outputs))

    def ticked(self) -> list[tuple[float, list[str], list[float]]]:
        return [(tick.time, sorted(tick.clocks), list(tick.outputs)) for tick in self._component.passed()]

    def reset(self) -> bool:
        self._texts.clear()
        return bool(self._component.reset())

    def save(self) -> int:
        number = next(self._number)
        self._states[number] = self._component.save()
        return number

    def restore(self, number: int) -> None:
        self._component.restore(self._states[number])

    def drop(self, number: int) -> None:
        self._component.drop(self._states.pop(number))


class _Forwarding(logging.Handler):
    """Passes log messages on to the main process at once: the last words before a crash count most."""

    def __init__(self, line: MessagePipe) -> None:
        super().__init__()
        self._line = line

    def emit(self, record: logging.LogRecord) -> None:
        said = json.dumps([record.name, record.levelno, record.getMessage()])
        self._line.send(LOGGED, said.encode())
