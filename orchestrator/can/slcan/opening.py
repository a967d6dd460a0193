"""Taking over a serial adapter from whoever had it before: it closes, takes its settings, and opens.

What it still says to the one before is dropped, up to its answer to the last command.
"""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Sequence
from select import select

import can

from orchestrator.can.slcan import protocol

VERSION = re.compile(rb"V[0-9A-Fa-f]{4}")
_PATIENCE = 0.3  # with an adapter that has not answered yet; some never do [s]
_SHORT = 0.05  # with one that has answered nothing so far [s]
_TAKING = 1.0  # with a port that takes nothing [s]


def take_over(port: int, commands: Sequence[str]) -> tuple[bool, list[bytes]]:
    """Close the adapter, and give it these commands; whether it tells its version, and the lines after its last answer.

    Raises:
        CanInitializationError: it refuses a command, takes nothing, or is gone.
    """
    try:
        # a line that the one before has left unfinished is ended first, and the version marks the end of old answers
        answers, rest = _exchange(port, "\rC\rV", lambda known: len(known) == 3 or bool(VERSION.match(known[-1])))
        answering, tells = bool(answers), any(map(VERSION.fullmatch, answers))
        for command in commands:
            answers, rest = _exchange(port, command, bool, _PATIENCE if answering else _SHORT)
            answering = answering or bool(answers)
            if protocol.BELL in answers:
                raise can.CanInitializationError(f"the adapter refuses {_meant(command)}")
    except OSError as error:
        raise can.CanInitializationError(f"the adapter is gone ({error.strerror})") from error
    return tells, rest


def _exchange(
    port: int, text: str, enough: Callable[[list[bytes]], bool], patience: float = _PATIENCE
) -> tuple[list[bytes], list[bytes]]:
    """Say something; the answers until they are enough or time is over, and the lines after them, the last open."""
    _put(port, text.encode("ascii") + protocol.END)
    until = time.monotonic() + patience
    answers: list[bytes] = []
    partial = b""
    while (left := until - time.monotonic()) > 0 and select([port], [], [], left)[0]:
        if not (data := os.read(port, 65536)):
            raise can.CanInitializationError("the adapter is gone (hung up)")
        lines = (partial + protocol.marked(data)).split(protocol.END)
        partial = lines[-1][-protocol.LONGEST :]
        for place, line in enumerate(lines[:-1]):
            if line in (b"", protocol.BELL) or VERSION.fullmatch(line):
                answers.append(line)
                if enough(answers):
                    return answers, lines[place + 1 :]
    return answers, [partial]


def _put(port: int, data: bytes) -> None:
    while data:
        if not select([], [port], [], _TAKING)[1]:
            raise can.CanInitializationError("the adapter takes nothing")
        data = data[os.write(port, data) :]


def _meant(command: str) -> str:
    rate = protocol.BITRATES.get(command) or protocol.DATA_BITRATES.get(command)
    return f"{command} ({rate} bit/s)" if rate else f"{command}" + (" (to open)" if command in ("O", "L") else "")
