"""The frames of a log, once or again and again, read before they are needed."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from queue import Full, Queue

from fmus.errors import InputError
from orchestrator.can.frames import Frames
from orchestrator.can.logs import LogReader

_AHEAD = 2  # batches


def passes(reader: LogReader, count: int | None, begin: Callable[[int], None]) -> Iterator[Frames]:
    """The batches of so many passes of a log, endless for None, with stamps that go on.

    From the last frame of a pass to the first of the next it takes as long as between two frames on average.

    Args:
        begin: told the number of the pass that begins.

    Raises (in the iteration):
        InputError: there is to be a second pass, and the first takes no time.
    """
    shift = 0.0
    for number in itertools.count() if count is None else range(count):
        begin(number)
        first, last, frames = None, 0.0, 0
        for batch in reader:
            if len(batch):
                first, last = float(batch.time[0]) if first is None else first, float(batch.time[-1])
            frames += len(batch)
            yield replace(batch, time=batch.time + shift) if shift else batch
        span = 0.0 if first is None else last - first
        if span <= 0 and count != 1:
            raise InputError(reader.path, "takes no time from its first frame to its last", "leave out --loop")
        shift += span + span / max(frames - 1, 1)


@contextmanager
def ahead(batches: Iterable[Frames]) -> Iterator[Iterator[Frames]]:
    """The same batches, read in a thread before they are needed.

    Raises (in the iteration):
        Exception: what the reading raised, in its place.
    """
    queue: Queue[Frames | Exception | None] = Queue(_AHEAD)
    over = threading.Event()

    def put(item: Frames | Exception | None) -> None:
        while not over.is_set():
            with suppress(Full):
                queue.put(item, timeout=0.1)
                return

    def read() -> None:
        try:
            for batch in batches:
                put(batch)
                if over.is_set():
                    return
            put(None)
        except Exception as error:
            put(error)

    def taken() -> Iterator[Frames]:
        while (item := queue.get()) is not None:
            if isinstance(item, Exception):
                raise item
            yield item

    thread = threading.Thread(target=read, name="log reader", daemon=True)
    thread.start()
    try:
        yield taken()
    finally:
        over.set()
        thread.join()
