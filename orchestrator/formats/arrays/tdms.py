"""TDMS files of LabVIEW, for which the extra `formats` installs npTDMS: channels in groups."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.formats.arrays.channels import ArrayChannel, distinct, recording
from orchestrator.formats.layout import Layout
from orchestrator.formats.recording import Recording

if TYPE_CHECKING:
    import nptdms

NUMBERS = "biuf"
Clocks = dict[tuple[int, float, float, float | None], str]
"""Samples, step, offset and start of a waveform -> the name of its time."""


def read(path: Path, layout: Layout) -> Recording:
    """The wanted channels of the group that the layout names, or of all.

    Raises:
        TraceError: npTDMS is not there, or the file is damaged or holds no channels that go together.
    """
    try:
        import nptdms  # noqa: PLC0415 (of an extra)
    except ImportError:
        raise TraceError(path, "a .tdms file needs npTDMS", "pip install servotwin[formats]") from None
    try:
        with nptdms.TdmsFile.open(path) as file:
            channels = _channels(_groups(file, layout, path))
            if not any(channel.count > 1 for channel in channels):
                raise TraceError(path, "holds no channels with samples", "record or export it again")
            return recording(path, layout, distinct(channels))
    except TraceError:
        raise
    except Exception as problem:  # whatever a library makes of damage
        raise TraceError(path, f"is damaged ({excerpt(problem)})", "record or export it again") from None


def _groups(file: nptdms.TdmsFile, layout: Layout, path: Path) -> Sequence[nptdms.TdmsGroup]:
    groups = {group.name: group for group in file.groups()}
    if layout.variable is None:
        return [group for group in groups.values() if group.channels()]
    if layout.variable not in groups:
        held = ", ".join(f"'{name}'" for name in list(groups)[:20])
        raise TraceError(path, f"has no group '{layout.variable}'", f"it holds {held}")
    return [groups[layout.variable]]


def _channels(groups: Sequence[nptdms.TdmsGroup]) -> list[ArrayChannel]:
    """The channels of groups, and the times that waveforms bring along, each once; groups tell equal names apart."""
    clocks: Clocks = {}
    found = {group.name: list(_of_group(group, clocks)) for group in groups}
    names = [channel.name for own in found.values() for channel in own]
    several = len(groups) > 1 and len(set(names)) < len(names)
    channels = [
        replace(channel, name=f"{group}/{channel.name}") if several else channel
        for group, own in found.items()
        for channel in own
    ]
    for (count, step, offset, start), name in clocks.items():
        channels.append(ArrayChannel(name, "s", count, _even(count, step, offset), clock=name, start=start))
    return channels


def _of_group(group: nptdms.TdmsGroup, clocks: Clocks) -> Iterator[ArrayChannel]:
    """The channels of a group; waveforms with a time of their own add it to the clocks."""
    for channel in group.channels():
        unit = str(channel.properties.get("unit_string", ""))
        step, offset = (float(channel.properties.get(f"wf_{key}", 0.0)) for key in ("increment", "start_offset"))
        clock = ""
        if step > 0 and len(channel) > 1:
            key = (len(channel), step, offset, _start(channel))
            clock = clocks.setdefault(key, "time" if not clocks else f"time_{len(clocks) + 1}")
        yield _channel(channel, unit, clock)


def _start(channel: nptdms.TdmsChannel) -> float | None:
    """POSIX time at which a waveform starts [s], where that is told; LabVIEW's zero, the year 1904, tells nothing."""
    told = channel.properties.get("wf_start_time")
    if not isinstance(told, np.datetime64) or np.isnat(told):
        return None
    start = float(told.astype("datetime64[us]").astype(np.int64)) / 1e6
    return start if start > 0 else None


def _even(count: int, step: float, offset: float) -> Any:
    return lambda: offset + step * np.arange(count)


def _channel(channel: nptdms.TdmsChannel, unit: str, clock: str) -> ArrayChannel:
    kind = np.dtype(channel.dtype).kind if channel.dtype is not None else "O"
    stamped = kind == "M"
    problem = "" if kind in NUMBERS or stamped else "text"
    return ArrayChannel(channel.name, unit, len(channel), lambda: channel[:], clock, stamped, problem)
