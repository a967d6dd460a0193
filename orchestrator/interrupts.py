"""An interrupt (Ctrl-C) ends a command at a place where it can: not in the middle of a Python FMU.

A Python FMU runs in this very process; an exception in its code would come back as a fatal error of the FMU.
"""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType, TracebackType
from typing import Any, NoReturn

UNPACKED = "servotwin-fmu-"  # how the names of folders of unpacked FMUs begin
PATIENCE = 0.4  # [s]

_active: list[Interrupts] = []


class Interrupts:
    """Makes SIGINT a KeyboardInterrupt; one that comes inside an FMU is raised when the FMU returns, or soon anyway.

    A context manager that puts the former handler back; without effect outside the main thread.

    Attributes:
        requested: whether an interrupt has come, also one that an FMU answered with an error.
    """

    def __init__(self) -> None:
        self.requested = False
        self._former: Any = None
        self._last_resort: threading.Timer | None = None
        self._given_up = False

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            self._former = signal.signal(signal.SIGINT, self._handle)
        _active.append(self)
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        _active.remove(self)
        self._stop_waiting()
        if self._former is not None:
            signal.signal(signal.SIGINT, self._former)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        given_up, self._given_up = self._given_up, False
        if given_up and self._last_resort is None:
            return  # the FMU has come back meanwhile: what is being cleaned up now must not be torn
        caller = _caller_of_fmu(frame)
        if self.requested or caller is None:
            self.requested = True
            raise KeyboardInterrupt
        self.requested = True
        caller.f_trace = self._interrupt
        sys.settrace(lambda frame, event, argument: None)  # without one the caller's own is not called
        self._last_resort = threading.Timer(PATIENCE, self._give_up)
        self._last_resort.daemon = True
        self._last_resort.start()

    def _give_up(self) -> None:
        """The FMU has not come back: the interrupt breaks it off."""
        self._given_up = True
        signal.raise_signal(signal.SIGINT)

    def _interrupt(self, frame: FrameType, event: str, argument: Any) -> NoReturn:
        """The trace function of the frame that called an FMU: it is back there."""
        self._stop_waiting()
        raise KeyboardInterrupt

    def _stop_waiting(self) -> None:
        if self._last_resort is not None:
            self._last_resort.cancel()
            self._last_resort = None
            sys.settrace(None)


def requested() -> bool:
    """Whether an interrupt has come to a command that runs, also one that an FMU answered with an error."""
    return any(interrupts.requested for interrupts in _active)


@contextmanager
def whole() -> Iterator[None]:
    """What is done within is not torn: an interrupt takes effect at its end, only a second one at once."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting = False

    def wait(number: int, frame: FrameType | None) -> None:
        nonlocal waiting
        if waiting:
            raise KeyboardInterrupt
        waiting = True

    former = signal.signal(signal.SIGINT, wait)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.SIG_DFL if former is None else former)
        if waiting:
            signal.raise_signal(signal.SIGINT)


def _caller_of_fmu(frame: FrameType | None) -> FrameType | None:
    """The frame that called into the FMU whose code runs; None where no code of an FMU runs."""
    caller = None
    while frame is not None:
        if UNPACKED in frame.f_code.co_filename:
            caller = frame.f_back
        frame = frame.f_back
    return caller
