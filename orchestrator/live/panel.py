"""What a terminal shows of a run in real time, and the keys that change its values."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from fmus.errors import ServotwinError
from orchestrator.display.plain import plain
from orchestrator.live.keys import keys
from orchestrator.processes import interrupts
from orchestrator.progress import Progress, silent

if TYPE_CHECKING:
    from orchestrator.engine import LiveRun
    from orchestrator.fmi.interface import Value
    from orchestrator.live.requests import Requests

BARS = "▁▂▃▄▅▆▇█"
WIDTH = 60  # samples that are drawn of a signal
SHOWN = 12  # values that are listed
PERCENT = 0.01  # by how much the arrows change a value
REFRESH = 5  # pictures a second
ENDS = "space ends it"
ENDING = "space", "ctrl-c", "ctrl-\\"
HELP = f"↑ ↓ choose, ← → change by 1 %, or type a value and Enter; {ENDS}"


class LivePanel:
    """How a run goes, the latest of its signals, and its values, one of them chosen.

    Attributes:
        also: is told, too.
    """

    def __init__(self, label: str) -> None:
        self._label, self._fraction, self._doing = label, 0.0, ""
        self._live: LiveRun[Any] | None = None
        self._requests: Requests | None = None
        self._curves: list[deque[float]] = []
        self._chosen, self._typed, self._said = 0, "", HELP
        self.also: Progress = silent

    def begin(self, live: LiveRun[Any], requests: Requests) -> None:
        """Show this run from now on."""
        self._curves = [deque(maxlen=WIDTH) for _ in live.names]
        self._live, self._requests, self._chosen = live, requests, 0

    def move(self, fraction: float, doing: str) -> None:
        """Take note of how far it is."""
        self._fraction, self._doing = fraction, doing
        self.also(fraction, doing)
        for curve, value in zip(self._curves, self._live.outputs if self._live else (), strict=True):
            curve.append(value)

    @contextmanager
    def shown(self, console: Console) -> Iterator[None]:
        """On the terminal, with its keys, within the block."""
        with (
            Live(get_renderable=self.picture, console=console, refresh_per_second=REFRESH, transient=True),
            keys(self.press),
        ):
            yield

    def press(self, key: str) -> None:
        """Do what a key is for; space ends the run as Ctrl-C does, whatever has been typed."""
        if key in ENDING:
            interrupts.ask()
            return
        names = self._names()
        if not names:
            return
        if key in ("up", "down"):
            self._chosen = (self._chosen + (1 if key == "down" else -1)) % len(names)
        elif key in ("left", "right"):
            self._nudge(names[self._chosen], PERCENT if key == "right" else -PERCENT)
        elif key == "enter" and self._typed:
            self._ask(names[self._chosen], self._typed)
            self._typed = ""
        elif key in ("\x7f", "\b"):
            self._typed = self._typed[:-1]
        elif key.isprintable():
            self._typed += key

    def picture(self) -> Group:
        """What is shown now."""
        table = Table.grid(padding=(0, 2))
        live = self._live
        for name, curve in zip(live.names if live else (), self._curves, strict=False):
            table.add_row(plain(name), sparkline(list(curve)), f"{curve[-1]:.6g}" if curve else "")
        names = self._names()
        first = max(0, min(self._chosen - SHOWN // 2, len(names) - SHOWN))
        for number, name in enumerate(names[first : first + SHOWN], start=first):
            mark = "▸" if number == self._chosen else " "
            typed = f"→ {self._typed}" if number == self._chosen and self._typed else ""
            table.add_row(f"{mark} {plain(name)}", self._value(name), plain(typed))
        head = Text(f"{plain(self._label)}  {100 * self._fraction:.0f} %  {plain(self._doing)}")
        return Group(head, table, Text(plain(self._said) if names else ENDS, style="dim"))

    def _names(self) -> list[str]:
        return [] if self._live is None else list(self._live.tuned.ports)

    def _value(self, name: str) -> str:
        assert self._live is not None
        value, unit = self._live.tuned.values.get(name, ""), self._live.tuned.ports[name].unit
        shown = f"{value:.6g}" if isinstance(value, float) else str(value)
        return plain(f"{shown} {unit or ''}".strip())

    def _nudge(self, name: str, share: float) -> None:
        assert self._live is not None
        value = self._live.tuned.values[name]
        self._ask(name, str(nudged(value, share)))

    def _ask(self, name: str, value: str) -> None:
        assert self._requests is not None
        try:
            self._requests.ask(f"{name}={value}", "keys")
            self._said = HELP
        except ServotwinError as error:
            self._said = str(error)


def nudged(value: Value, share: float) -> Value:
    """A value changed by a share of itself, what is zero by the share, what is whole by one, and a truth value over."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return value + (1 if share > 0 else -1)
    return float(f"{value + share * (abs(value) or 1.0):.12g}") if isinstance(value, float) else value


def sparkline(values: Sequence[float]) -> str:
    """The values as a row of bars between their lowest and their highest; a space where one is not finite."""
    finite = [value for value in values if abs(value) < float("inf")]
    low, span = min(finite, default=0.0), max(finite, default=0.0) - min(finite, default=0.0)
    top = len(BARS) - 1
    return "".join(
        BARS[round(top * ((value - low) / span)) if span else 0] if abs(value) < float("inf") else " "
        for value in values
    )
