"""A wish to end (Ctrl-C, SIGTERM, SIGHUP) ends a command where it can: not in the middle of a Python FMU, and once.

A Python FMU runs in this very process; an exception in its code would come back as a fatal error of the FMU.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic
from types import FrameType
from typing import Any, NoReturn

from orchestrator.processes import last_words

UNPACKED = "servotwin-fmu-"  # how the names of folders of unpacked FMUs begin
PATIENCE = 0.4  # with an FMU that is to come back [s]
SAME = 1.0  # signals that come within this time are one wish: service managers and `timeout` send several [s]
_SOON = 0.01  # until an interrupt is raised again that came where nothing can be raised [s]

Handler = Callable[[int, FrameType | None], Any]

_active: list[Interrupts] = []
_guard = 0  # the process that passes signals on to this one, 0 where none does


def endings() -> list[signal.Signals]:
    """The signals that ask to end; SIGHUP is none where `nohup` or the like has taken it away, nor SIGQUIT."""
    others = [signal.Signals[name] for name in ("SIGHUP", "SIGQUIT") if hasattr(signal, name)]
    left = [number for number in others if signal.getsignal(number) is not signal.SIG_IGN]
    return [signal.SIGINT, signal.SIGTERM, *left]


def guarded_by(process: int) -> None:
    """Signals to this process come from another one, which sees to it that it ends."""
    global _guard  # noqa: PLW0603 (a process has one)
    _guard = process


def ask() -> None:
    """Ask this command to end as Ctrl-C does, from any thread, whatever the main one waits for or hangs in."""
    if sys.platform == "win32":
        signal.raise_signal(signal.SIGINT)
    elif _guard and os.getppid() == _guard:
        os.kill(_guard, signal.SIGINT)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def ignore() -> None:
    """From now on they are too late."""
    for number in endings():
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def handling(handler: Handler, numbers: list[signal.Signals]) -> Iterator[None]:
    """These signals go to this handler, and afterwards to those before; without effect outside the main thread."""
    former: dict[signal.Signals, Any] = {}
    try:
        if threading.current_thread() is threading.main_thread():
            for number in numbers:
                former[number] = signal.getsignal(number)  # noted first: a handler may raise between two lines
                signal.signal(number, handler)
        yield
    finally:
        for number, known in former.items():
            signal.signal(number, signal.SIG_DFL if known is None else known)


class Wishes:
    """Counts wishes to end: signals that follow the first of a wish soon are the same one."""

    def __init__(self) -> None:
        self.count = 0
        self._latest = -SAME

    def again(self) -> bool:
        """Take note of a signal; whether it is a wish, and not one that was known already."""
        last_words.own().hear()
        now = monotonic()
        if self.count and now - self._latest < SAME:
            return False
        self._latest = now
        self.count += 1
        return True


class Interrupts:
    """Makes a signal to end a KeyboardInterrupt; one that comes inside an FMU is raised when the FMU returns, or soon.

    A context manager that puts the former handlers back; without effect outside the main thread.

    Args:
        numbers: the signals, all that ask to end by default.

    Attributes:
        requested: whether an interrupt has come, also one that an FMU answered with an error.
        broken_off: whether it broke off an FMU that had not come back, which is not to be called any more.
    """

    def __init__(self, *numbers: signal.Signals) -> None:
        self.requested = self.broken_off = False
        self._numbers = [*numbers] or endings()
        self._wishes = Wishes()
        self._handling = handling(self._handle, self._numbers)
        self._hook = sys.unraisablehook
        self._last_resort: threading.Timer | None = None
        self._given_up = False

    def __enter__(self) -> Interrupts:
        self._handling.__enter__()
        self._hook, sys.unraisablehook = sys.unraisablehook, self._swallowed
        _active.append(self)
        return self

    def __exit__(self, *_: object) -> None:
        _active.remove(self)
        self._stop_waiting()
        sys.unraisablehook = self._hook
        self._handling.__exit__(None, None, None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        if self._given_up:
            self._given_up = False
            if self._last_resort is None:
                return  # the FMU has come back meanwhile: what is being cleaned up now must not be torn
            self.broken_off = True
            raise KeyboardInterrupt
        if not self._wishes.again():
            return
        caller = None if self.requested else _caller_of_fmu(frame)
        self.requested = True
        if caller is None:
            raise KeyboardInterrupt
        caller.f_trace = self._interrupt
        sys.settrace(lambda frame, event, argument: None)  # without one the caller's own is not called
        self._raise_after(PATIENCE)

    def _raise_after(self, seconds: float) -> None:
        self._last_resort = threading.Timer(seconds, self._give_up)
        self._last_resort.daemon = True
        self._last_resort.start()

    def _give_up(self) -> None:
        """The FMU has not come back: the interrupt breaks it off."""
        self._given_up = True
        main_thread = threading.main_thread().ident
        if hasattr(signal, "pthread_kill") and main_thread is not None:
            signal.pthread_kill(main_thread, self._numbers[0])  # what it waits for ends, too
        else:
            signal.raise_signal(self._numbers[0])

    def _interrupt(self, frame: FrameType, event: str, argument: Any) -> NoReturn:
        """The trace function of the frame that called an FMU: it is back there."""
        self._stop_waiting()
        raise KeyboardInterrupt

    def _swallowed(self, raised: sys.UnraisableHookArgs) -> None:
        """An interrupt that came in a finaliser or a callback, where nothing can be raised, is raised again soon."""
        if self.requested and issubclass(raised.exc_type, KeyboardInterrupt):
            self._raise_after(_SOON)
        else:
            self._hook(raised)

    def _stop_waiting(self) -> None:
        if self._last_resort is not None:
            self._last_resort.cancel()
            self._last_resort = None
            sys.settrace(None)


def broken_off() -> bool:
    """Whether an interrupt has broken off a call of an FMU."""
    return bool(_active) and any(interrupts.broken_off for interrupts in _active)  # asked after every run


def requested() -> bool:
    """Whether an interrupt has come to a command that runs, also one that an FMU answered with an error."""
    return any(interrupts.requested for interrupts in _active)


@contextmanager
def whole() -> Iterator[None]:
    """What is done within is not torn: an interrupt takes effect at its end, only a second one at once."""
    wishes = Wishes()
    waiting: list[int] = []

    def wait(number: int, frame: FrameType | None) -> None:
        if wishes.again():
            waiting.append(number)
            if wishes.count > 1:
                raise KeyboardInterrupt

    try:
        with handling(wait, endings()):
            yield
    finally:
        if waiting:
            signal.raise_signal(waiting[0])


def _caller_of_fmu(frame: FrameType | None) -> FrameType | None:
    """The frame that called into the FMU whose code runs; None where no code of an FMU runs."""
    caller = None
    while frame is not None:
        if UNPACKED in frame.f_code.co_filename:
            caller = frame.f_back
        frame = frame.f_back
    return caller
