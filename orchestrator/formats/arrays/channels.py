"""Channels of their own lengths as a recording: those that share the stamps of one of them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fmus.errors import TraceError
from orchestrator.formats.headings import names_time
from orchestrator.formats.layout import MAX_VALUES, FileColumns, Layout, choose
from orchestrator.formats.recording import Recording
from orchestrator.formats.stamps import since_first


@dataclass(frozen=True)
class ArrayChannel:
    """Samples under a name.

    Attributes:
        unit: "" where it is not known.
        count: of samples.
        read: gives them (K,): numbers, or instants as datetime64 in UTC.
        clock: name of the channel with their stamps, "" where the file does not tell.
        stamped: whether the samples are instants.
        problem: what they are, where they are no numbers.
        start: of stamps, the POSIX time of their 0 [s], where the file knows it.
    """

    name: str
    unit: str
    count: int
    read: Callable[[], ArrayLike]
    clock: str = ""
    stamped: bool = False
    problem: str = ""
    start: float | None = None


def recording(path: Path, layout: Layout, channels: Sequence[ArrayChannel], notes: Sequence[str] = ()) -> Recording:
    """The recording of the channels that go with the time that the layout chooses.

    Raises:
        TraceError: no channel is surely the time, one that is asked for does not go with it, or all are too many.
    """
    names = tuple(channel.name for channel in channels)
    clock = _clock(layout, channels)
    count = clock.count if clock else Counter(c.count for c in channels if c.count > 1).most_common(1)[0][0]
    columns = FileColumns(
        len(channels),
        names,
        tuple(channel.unit for channel in channels),
        {number: why for number, channel in enumerate(channels) if (why := _useless(channel, clock, count))},
        [number for number, channel in enumerate(channels) if channel.stamped],
        lambda number: channels[number].read(),
    )
    choice = choose(layout, columns, path)
    if count * len(choice.wanted) > MAX_VALUES:
        raise TraceError(path, f"claims {count} samples", "name fewer `columns` in the layout, or cut the recording")
    stamps = None
    if channels[choice.time].stamped:
        stamps = since_first(_instants(np.asarray(channels[choice.time].read()), path), "UTC", path)
    found = choice.recording(lambda number: channels[number].read(), "", stamps, notes)
    return found if stamps else replace(found, start=channels[choice.time].start)


def _instants(stamps: NDArray[np.datetime64], path: Path) -> NDArray[np.int64]:
    """Nanoseconds since 1970.

    Raises:
        TraceError: some are missing, or so far away that 64 bits do not hold them.
    """
    fine = stamps.astype("datetime64[ns]")
    lost = np.count_nonzero(fine.astype("datetime64[D]") != stamps.astype("datetime64[D]"))
    if lost:
        raise TraceError(path, f"{lost} time stamps are missing, or before 1678 or after 2262", "drop those rows")
    return fine.astype(np.int64)


def _clock(layout: Layout, channels: Sequence[ArrayChannel]) -> ArrayChannel | None:
    """The channel with the stamps, as far as names tell."""
    if isinstance(layout.time, int):
        return channels[layout.time] if 0 <= layout.time < len(channels) else None
    if layout.time is not None:
        return next((channel for channel in channels if channel.name == layout.time), None)
    exact = [channel for channel in channels if channel.name == "time"]
    found = exact or [channel for channel in channels if names_time(channel.name) and channel.count > 1]
    return found[0] if len(found) == 1 else None


def _useless(channel: ArrayChannel, clock: ArrayChannel | None, count: int) -> str:
    if channel.problem:
        return channel.problem
    if clock and clock.clock and channel.clock not in ("", clock.name) and channel is not clock:
        own = f"{channel.count} samples at the stamps of '{channel.clock}' (`time: {channel.clock}` reads those)"
        return "other stamps" if channel.name == channel.clock else own
    return f"{channel.count} samples where the time has {count}" if channel.count != count else ""


def distinct(channels: Sequence[ArrayChannel]) -> list[ArrayChannel]:
    """The channels, each under a name of its own: those of one name get numbers."""
    counts = Counter(channel.name for channel in channels)
    seen = Counter[str]()
    named = []
    for channel in channels:
        seen[channel.name] += 1
        number = seen[channel.name]
        named.append(
            replace(channel, name=f"{channel.name}_{number}") if counts[channel.name] > 1 < number else channel
        )
    return named
