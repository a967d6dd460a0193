"""Work that may take its time, such as writing to a disk, done in order by a thread while deadlines are kept."""

from __future__ import annotations

import threading
from collections.abc import Callable
from queue import Queue

MOST = 64  # jobs that may wait; with one more, who brings it waits too


class Background:
    """A thread that does jobs; at the end of the block all are done.

    Raises (on bringing a job and at the end of the block):
        Exception: what a job raised; those after it are not done.
    """

    def __init__(self) -> None:
        self._jobs: Queue[Callable[[], object] | None] = Queue(MOST)
        self._failure: Exception | None = None
        self._thread = threading.Thread(target=self._work, name="background", daemon=True)

    def do(self, job: Callable[[], object]) -> None:
        """Do this later."""
        self._raise()
        self._jobs.put(job)

    def __enter__(self) -> Background:
        self._thread.start()
        return self

    def __exit__(self, kind: type | None, *_: object) -> None:
        self._jobs.put(None)
        self._thread.join()
        if kind is None:
            self._raise()

    def _raise(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if self._failure is None:
                try:
                    job()
                except Exception as failure:  # raised again where the next job is brought
                    self._failure = failure
