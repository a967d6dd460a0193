"""A serial adapter on a pseudo-terminal that answers as a test wants: refuses, stops to read, says nothing."""

from __future__ import annotations

import os
import threading
import tty
from collections.abc import Callable
from select import select

Answer = Callable[[bytes], bytes]


def willing(line: bytes) -> bytes:
    """The answer of an adapter that takes everything."""
    return {b"t": b"z\r", b"T": b"Z\r", b"V": b"V1013\r"}.get(line[:1], b"\r")


class ScriptedAdapter:
    """Answers line by line, in a thread, from the start of the block to its end.

    Attributes:
        answer: to a line; may be changed at any time.
        reads: cleared, it takes nothing from its port.
        lines: that came so far.
    """

    def __init__(self, answer: Answer = willing) -> None:
        self.answer = answer
        self.reads = threading.Event()
        self.reads.set()
        self.lines: list[bytes] = []
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)
        self._ending = False
        self._thread = threading.Thread(target=self._run, daemon=True)

    @property
    def frames(self) -> list[bytes]:
        """The lines that are frames."""
        return [line for line in self.lines if line[:1] in (b"t", b"T")]

    def say(self, data: bytes) -> None:
        """Say something unasked."""
        os.write(self._master, data)

    def __enter__(self) -> ScriptedAdapter:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ending = True
        self.reads.set()
        self._thread.join()
        os.close(self._slave)
        os.close(self._master)

    def _run(self) -> None:
        partial = b""
        while not self._ending:
            if not self.reads.wait(0.05) or not select([self._master], [], [], 0.01)[0] or not self.reads.is_set():
                continue
            *lines, partial = (partial + os.read(self._master, 65536)).split(b"\r")
            for line in lines:
                self.lines.append(line)
                self.say(self.answer(line))
