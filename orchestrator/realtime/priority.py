"""Short turns on a processor: a thread that asks for little at a time need not wait until others have had their fill.

Linux from 6.12 on grants them to anybody; elsewhere nothing changes.
"""

from __future__ import annotations

import ctypes
import os
import platform
import struct
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_TURN = 100_000  # the shortest that there is [ns]
_SETTING = {"x86_64": 314, "aarch64": 274}  # numbers of the system call sched_setattr
_ATTRIBUTES = "=IIQiIQQQ"  # its struct sched_attr: size, policy, flags, nice, priority, runtime, deadline, period


@contextmanager
def short_turns() -> Iterator[None]:
    """This thread, and those that it starts within the block, take short turns."""
    _take(_TURN)
    try:
        yield
    finally:
        _take(0)


def _take(nanoseconds: int) -> None:
    """Take turns of this length, 0 of the usual one; a thread that was put before others stays so."""
    if sys.platform != "linux":
        return
    call = _SETTING.get(platform.machine())
    if call is None or os.sched_getscheduler(0) != os.SCHED_OTHER:
        return
    nice = os.getpriority(os.PRIO_PROCESS, 0)
    size = struct.calcsize(_ATTRIBUTES)
    attributes = struct.pack(_ATTRIBUTES, size, os.SCHED_OTHER, 0, nice, 0, nanoseconds, 0, 0)
    ctypes.CDLL(None).syscall(call, 0, attributes, 0)
