"""MF4 bus logs (ASAM MDF 4), for which the extra `mf4` installs asammdf; they are read in a process of their own."""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from time import monotonic

from fmus.errors import TraceError
from orchestrator.can.frames import Frames
from orchestrator.can.logs.findings import Findings
from orchestrator.can.logs.mf4 import worker as messages

PATIENCE = 60.0  # with a process that owes an answer [s]
MOST = 1 << 28  # bytes of a message
_BOOT = "import sys; sys.path[:] = {path!r}; from orchestrator.can.logs.mf4.worker import *; serve(Path(sys.argv[1]))"


def frames(path: Path, findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches, the groups of the file merged by time, and the share of it that is read by then.

    Raises:
        TraceError: asammdf is not there, or cannot open the file.
    """
    if find_spec("asammdf") is None:
        raise TraceError(path, "an .mf4 log needs asammdf", "pip install servotwin[mf4]")
    share = 0.0
    with _worker(path) as pipe:
        while True:
            kind, body = _message(pipe)
            if kind == messages.FRAMES:
                batch, share = messages.unpacked(body)
                yield batch, share
            elif kind == messages.DAMAGE:
                findings.add(**json.loads(body))
            elif kind == messages.NOTE:
                findings.note(json.loads(body))
            elif kind == messages.REFUSAL:
                raise TraceError(path, *json.loads(body))
            else:
                break
    if kind != messages.END:
        place = int(share * path.stat().st_size)
        findings.add(place, f"asammdf {'gave no answer' if kind == b't' else 'broke down'} on what is about here")


@contextmanager
def _worker(path: Path) -> Iterator[int]:
    """The pipe from a process that reads the log."""
    command = [sys.executable, "-c", _BOOT.format(path=sys.path), str(path.resolve())]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    with (
        tempfile.TemporaryDirectory() as folder,  # for asammdf's copy of what is not finalized
        subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**environment, "TMPDIR": folder},
        ) as process,
    ):
        try:
            assert process.stdout is not None
            yield process.stdout.fileno()
        finally:
            process.kill()


def _message(pipe: int) -> tuple[bytes, bytes]:
    """Kind and body of the next message; the kinds b"t" and b"" say that it took too long, or that there is none."""
    head = _exactly(pipe, messages.HEAD.size)
    if not isinstance(head, bytearray):
        return head, b""
    kind, size = messages.HEAD.unpack(head)
    body = _exactly(pipe, size) if size <= MOST else b""
    return (kind, bytes(body)) if isinstance(body, bytearray) else (body, b"")


def _exactly(pipe: int, size: int) -> bytearray | bytes:
    """So many bytes; b"t" or b"" where they do not come."""
    got, until = bytearray(), monotonic() + PATIENCE
    while len(got) < size:
        if not select.select([pipe], [], [], max(0.0, until - monotonic()))[0]:
            return b"t"
        part = os.read(pipe, min(size - len(got), 1 << 20))
        if not part:
            return b""
        got += part
    return got
