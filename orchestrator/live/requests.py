"""Changes on their way: asked for by any thread, checked there, and made between two steps in the order they came."""

from __future__ import annotations

import logging
from collections import deque
from time import perf_counter
from typing import Any

from fmus.errors import WiringError
from orchestrator.engine import LiveRun
from orchestrator.fmi.interface import Value, Written

LOG = logging.getLogger("servotwin.live")
SHARE = 0.1  # of a step that changes may take: where more are asked for at once, the others wait for the next


class Requests:
    """The changes that are asked for of a live run.

    Args:
        step: between two beginnings of steps [s].
    """

    def __init__(self, live: LiveRun[Any], step: float) -> None:
        self._live, self._budget = live, SHARE * step
        self._waiting: deque[tuple[str, Value, str]] = deque()

    def ask(self, line: str, by: str) -> None:
        """Ask for `component.variable=value`, the value with a unit of its own or in the variable's.

        Raises:
            ServotwinError: it is no such line, or the value does not fit; nothing is changed.
        """
        name, equals, value = (part.strip() for part in line.partition("="))
        if not (equals and value):
            raise WiringError(line.strip() or by, "has no value", "write component.variable=value")
        self._waiting.append((name, self._live.tuned.checked(name, Written(value)), by))

    def make(self) -> None:
        """Make those that wait, as the time of a step allows, at least one.

        Raises:
            FmuError: an FMU refuses one.
        """
        if not self._waiting:
            return
        until = perf_counter() + self._budget
        while self._waiting:
            change = self._live.change(*self._waiting.popleft())
            if not change.taken:
                LOG.warning("%s: was set to %s but is %s", change.name, change.asked, change.value)
            if perf_counter() >= until:
                return
