"""How a run in real time is steered and watched: what may be changed, where changes come from, and who is shown it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from orchestrator.engine import LiveRun
from orchestrator.live import watched_file
from orchestrator.live.requests import Requests
from orchestrator.progress import Progress, silent

Shown = Callable[[LiveRun[Any], Requests], None]


@dataclass(frozen=True)
class Steering:
    """What may be changed while a run goes on.

    Attributes:
        tuned: component.variable of what may be changed, None for all that can be.
        file: where values stand that are taken, at first and whenever they change.
        shown: is given each run that begins, and how to ask for changes of it.
        progress: is told ten times a second how it goes.
    """

    tuned: tuple[str, ...] | None = ()
    file: Path | None = None
    shown: Shown = lambda live, requests: None
    progress: Progress = silent

    @contextmanager
    def begun(self, live: LiveRun[Any], step: float) -> Iterator[Requests]:
        """The requests of a run whose steps begin every so many seconds.

        Raises:
            InputError: the file cannot be read, or a value in it does not fit.
        """
        requests = Requests(live, step)
        self.shown(live, requests)
        if self.file is None:
            yield requests
            return
        with watched_file.watched(self.file, requests):
            yield requests
