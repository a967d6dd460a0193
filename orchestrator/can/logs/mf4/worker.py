"""The process in which an .mf4 log is read: asammdf may crash, hang or fill the memory on a damaged one.

What it says goes over its standard output: a kind, a size and a body, which is numbers or JSON.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from pathlib import Path
from typing import BinaryIO

import numpy as np

from fmus.errors import ServotwinError
from orchestrator.can.frames import Frames
from orchestrator.can.logs.findings import Damage, Findings
from orchestrator.can.logs.mf4 import records

FRAMES, DAMAGE, NOTE, REFUSAL, END = b"f", b"d", b"n", b"e", b"."
HEAD = struct.Struct("<cQ")  # kind, bytes of the body
SHAPE = struct.Struct("<dII")  # share of the file that is read, frames, bytes of data of each
MEMORY = 4 << 30  # bytes


def serve(path: Path) -> None:
    """Read the log and say what is in it."""
    if sys.platform != "win32":
        import resource  # noqa: PLC0415 (of Unix)

        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    pipe = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # what asammdf prints is no message
    findings = _Telling(pipe)
    try:
        for batch, share in records.read(path, findings):
            _send(pipe, FRAMES, packed(batch, share))
    except ServotwinError as error:
        _send(pipe, REFUSAL, json.dumps([error.problem, error.fix]).encode())
    except MemoryError:
        _send(pipe, REFUSAL, json.dumps(["asks for more memory than a log can need", "record it again"]).encode())
    _send(pipe, END, b"")


class _Telling(Findings):
    """Findings that are said at once."""

    def __init__(self, pipe: BinaryIO) -> None:
        super().__init__()
        self._pipe = pipe

    def add(self, offset: int | None, problem: str, line: int | None = None) -> None:
        _send(self._pipe, DAMAGE, json.dumps(vars(Damage(offset, problem, line))).encode())

    def note(self, text: str) -> None:
        _send(self._pipe, NOTE, json.dumps(text).encode())


def packed(frames: Frames, share: float) -> bytes:
    """The body of a message with frames."""
    head = SHAPE.pack(share, *frames.data.shape)
    columns = (frames.time, frames.id, frames.flags, frames.channel, frames.length, frames.data)
    return head + b"".join(column.tobytes() for column in columns)


def unpacked(body: bytes) -> tuple[Frames, float]:
    """The frames, and the share of the file that is read."""
    share, count, width = SHAPE.unpack_from(body)
    time = np.frombuffer(body, "<f8", count, SHAPE.size)
    identifier = np.frombuffer(body, "<u4", count, SHAPE.size + 8 * count)
    octets = np.frombuffer(body, np.uint8, (3 + width) * count, SHAPE.size + 12 * count)
    flags, channel, length = octets[: 3 * count].reshape(3, count)
    return Frames(time, identifier, flags, channel, length, octets[3 * count :].reshape(count, width)), share


def _send(pipe: BinaryIO, kind: bytes, body: bytes) -> None:
    pipe.write(HEAD.pack(kind, len(body)) + body)
    pipe.flush()


if __name__ == "__main__":
    serve(Path(sys.argv[1]))
