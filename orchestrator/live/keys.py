"""Keys of the terminal while a command works, without the key that ends a line.

A command is a child in the background of its terminal; while keys are read it is in the foreground.
"""

from __future__ import annotations

import os
import re
import select
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress

from orchestrator.live.beside import beside

with suppress(ImportError):  # where terminals are no files
    import termios

_LOOK = 0.1  # between two looks whether it is over [s]
_NAMES = {
    " ": "space",
    "\x1b[A": "up",
    "\x1b[B": "down",
    "\x1b[C": "right",
    "\x1b[D": "left",
    "\r": "enter",
    "\n": "enter",
    "\x03": "ctrl-c",
    "\x1c": "ctrl-\\",
}
_OTHER = re.compile(r"\x1b(\[[0-?]*[ -/]*[@-~]|O.|)", re.DOTALL)  # keys that say more than a letter


@contextmanager
def keys(press: Callable[[str], None]) -> Iterator[None]:
    """Each key that is pressed within the block goes to `press`, on a thread of its own: its letter, or up, down, left,
    right, enter, space, ctrl-c, ctrl-\\. Without effect where there is no terminal that can do that."""
    if sys.platform == "win32":
        yield
        return
    try:
        terminal = os.open("/dev/tty", os.O_RDWR | os.O_NOCTTY)
    except OSError:
        yield
        return
    with _foreground(terminal), beside(lambda over: _read(terminal, press, over), "keys"):
        yield
    os.close(terminal)


@contextmanager
def _foreground(terminal: int) -> Iterator[None]:
    """The terminal gives each key at once, to this process group; Ctrl-C, Ctrl-\\ and Ctrl-Z are keys: the
    signals would reach this process, which may hang, but not the one that guards it."""
    if sys.platform == "win32":
        raise OSError("Windows has no terminals that are files")
    former, group = termios.tcgetattr(terminal), os.tcgetpgrp(terminal)
    own = termios.tcgetattr(terminal)
    own[3] &= ~(termios.ICANON | termios.ECHO)
    for key in (termios.VINTR, termios.VQUIT, termios.VSUSP, termios.VMIN, termios.VTIME):
        own[6][key] = b"\0"
    os.tcsetpgrp(terminal, os.getpgrp())
    termios.tcsetattr(terminal, termios.TCSADRAIN, own)
    try:
        yield
    finally:
        with suppress(OSError, termios.error):  # the terminal is gone
            termios.tcsetattr(terminal, termios.TCSADRAIN, former)
            os.tcsetpgrp(terminal, group)


def _read(terminal: int, press: Callable[[str], None], over: threading.Event) -> None:
    while not over.is_set():
        if not select.select([terminal], [], [], _LOOK)[0]:
            continue
        try:
            text = os.read(terminal, 64).decode(errors="ignore")
        except OSError:
            return
        if not text:
            return
        for key in split(text):
            press(key)


def split(text: str) -> Iterator[str]:
    """The keys that a terminal means by this text."""
    while text:
        named = next((name for name in _NAMES if text.startswith(name)), "")
        if named:
            yield _NAMES[named]
        elif other := _OTHER.match(text):
            named = other[0]
        else:
            yield text[0]
        text = text[len(named) or 1 :]
