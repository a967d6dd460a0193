"""MF4 bus logs (ASAM MDF 4) in columns, by asammdf in this very process.

asammdf trusts a file's contents: one that nobody vouches for is read in a process of its own, by `reading`.
"""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Iterable, Iterator
from contextlib import closing
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from fmus.errors import TraceError
from fmus.words import excerpt
from orchestrator.can.frames import CLASSIC, LENGTHS, LONGEST, Flag, Frames, concatenated, since
from orchestrator.can.logs.findings import Findings
from orchestrator.trace import Bytes, FloatArray

BATCH = 1 << 16
UNFINISHED = b"UnFinMF"
EXTENDED_ID = np.uint32(1 << 31)  # how Vector's tools mark one in a group without IDE
FIRST = 1  # number of the first channel
KINDS = {"CAN_DataFrame": Flag(0), "CAN_ErrorFrame": Flag.ERROR, "CAN_RemoteFrame": Flag.REMOTE}
DLC = np.repeat(np.arange(16, dtype=np.uint8), [1] * 9 + [4, 4, 4, 4, 8, 16, 16])  # length code of so many data bytes
BITS = {"IDE": Flag.EXTENDED, "EDL": Flag.FD, "BRS": Flag.BITRATE_SWITCH, "ESI": Flag.ERROR_STATE}


def read(path: Path, findings: Findings) -> Iterator[tuple[Frames, float]]:
    """The frames in batches, the groups of the file merged by time, and the share of it that is read by then.

    Raises:
        TraceError: asammdf is not there, or cannot open the file.
    """
    with closing(_opened(path, findings)) as mdf:
        groups = [
            (number, name)
            for number, group in enumerate(mdf.groups)
            for name in KINDS
            if group.channel_group.cycles_nr and any(channel.name == name for channel in group.channels)
        ]
        if not groups:
            _refuse_measurement(mdf, path)
        first = _first_channel(mdf, groups, findings)
        total = sum(mdf.groups[number].channel_group.cycles_nr for number, _ in groups)
        done = 0
        for batch in merged([_group(mdf, number, name, first, findings) for number, name in groups]):
            done += len(batch)
            yield batch, min(1.0, done / total)


def merged(streams: Iterable[Iterator[Frames]]) -> Iterator[Frames]:
    """Batches of several streams in the order of time; within a stream the order stays as it is."""
    held = [(stream, first) for stream in streams if (first := next(stream, None)) is not None]
    kept = [(stream, batch, _rising(batch.time, -np.inf)) for stream, batch in held]
    while kept:
        horizon = min(rising[-1] for _, _, rising in kept)
        counts = [int(np.searchsorted(rising, horizon, side="right")) for _, _, rising in kept]
        ready = concatenated([batch[:count] for (_, batch, _), count in zip(kept, counts, strict=True)])
        keys = np.concatenate([rising[:count] for (_, _, rising), count in zip(kept, counts, strict=True)])
        yield ready[np.argsort(keys, kind="stable")]
        remaining = []
        for (stream, batch, rising), count in zip(kept, counts, strict=True):
            rest, keys = batch[count:], rising[count:]
            if not len(rest):
                following = next(stream, None)
                if following is None:
                    continue
                rest, keys = following, _rising(following.time, float(rising[-1]))
            remaining.append((stream, rest, keys))
        kept = remaining


def fill(file: BinaryIO, batches: Iterable[Frames], database: Path | None = None) -> int:
    """Number of frames that were written into the file; the database is attached to it."""
    asammdf = library(file.name)
    mdf, start, count = asammdf.MDF(version="4.10"), None, 0
    with closing(mdf):
        for batch in batches:
            if start is None and len(batch):
                begin = datetime.fromtimestamp(max(0.0, float(batch.time[0])), UTC)
                mdf.header.start_time, start = begin, begin.timestamp()
                _append_groups(asammdf, mdf, database)
            count += len(batch)
            for group, (name, kind) in enumerate(KINDS.items()):
                chosen = batch[(batch.flags & np.uint8(Flag.ERROR | Flag.REMOTE)) == kind]
                if len(chosen):
                    mdf.extend(group, [(since(start or 0.0, chosen.time), None), (_records(chosen, name), None)])
        if start is None:
            _append_groups(asammdf, mdf, database)
        mdf.save(file, overwrite=True, compression=1)
    return count


def library(path: object) -> Any:
    """asammdf.

    Raises:
        TraceError: it is not installed.
    """
    try:
        import asammdf  # noqa: PLC0415
    except ImportError:
        raise TraceError(path, "an .mf4 log needs asammdf", "pip install servotwin[mf4]") from None
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    return asammdf


def _opened(path: Path, findings: Findings) -> Any:
    asammdf = library(path)
    with path.open("rb") as file:
        unfinished = file.read(len(UNFINISHED)) == UNFINISHED
    if unfinished:
        findings.note("the logger did not finalize the file; read as far as it was written")
    try:
        return asammdf.MDF(path)  # it finalizes a copy
    except Exception as problem:  # asammdf meets damage with whatever error comes first
        raise TraceError(path, f"is no readable .mf4 log ({excerpt(problem)})", "record or export it again") from None


def _refuse_measurement(mdf: Any, path: Path) -> None:
    """Say so where a file without groups of frames holds something else."""
    masters = mdf.masters_db
    measured = sum(len(group.channels) - (number in masters) for number, group in enumerate(mdf.groups))
    if measured and not any(channel.name in KINDS for group in mdf.groups for channel in group.channels):
        raise TraceError(path, f"holds no CAN frames but {measured} measured channels", "give a log of frames")


def _first_channel(mdf: Any, groups: list[tuple[int, str]], findings: Findings) -> int:
    """The number of the first channel: `FIRST` as Vector and CSS count, 0 where there is one, as python-can counts."""
    for number, name in groups:
        try:
            if np.any(mdf.get(f"{name}.BusChannel", number, record_count=BATCH).samples == 0):
                findings.note("channels are counted from 0 in this file")
                return 0
        except Exception:  # no such field, or damage that reading will come across, too
            continue
    return FIRST


def _rising(time: FloatArray, least: float) -> FloatArray:
    return np.maximum(np.maximum.accumulate(time), least)


def _group(mdf: Any, number: int, name: str, first_channel: int, findings: Findings) -> Iterator[Frames]:
    group = mdf.groups[number].channel_group
    start = mdf.header.start_time.timestamp()
    for first in range(0, group.cycles_nr, BATCH):
        try:
            signal = mdf.get(name, number, record_offset=first, record_count=BATCH)
            batch = _columns(signal, findings.dated(start, signal.timestamps), name, first_channel)
        except Exception as problem:  # see above
            findings.add(int(group.address), f"records of this group from {first} on: {excerpt(problem)}")
            return
        if not len(batch):
            findings.add(int(group.address), f"this group has {first} of its {group.cycles_nr} records")
            return
        _say_channel_0(signal.samples, name, first_channel, findings)
        sound = np.isfinite(batch.time)
        if not sound.all():
            findings.add(int(group.address), f"{np.count_nonzero(~sound)} time stamps of this group are no numbers")
        yield batch[sound]


def _say_channel_0(samples: NDArray[Any], name: str, first_channel: int, findings: Findings) -> None:
    field = f"{name}.BusChannel"
    if first_channel and field in (samples.dtype.names or ()) and np.any(samples[field] < first_channel):
        findings.note("frames name channel 0, and count as channel 0 like those of the first")


def _columns(signal: Any, time: FloatArray, name: str, first_channel: int) -> Frames:
    samples = signal.samples
    there = {field.removeprefix(name + "."): samples[field] for field in samples.dtype.names}
    count = len(samples)
    nothing = np.zeros(count, np.uint8)
    flags = np.full(count, KINDS[name], np.uint8)
    for bit, flag in BITS.items():
        flags |= np.where(there.get(bit, nothing) != 0, np.uint8(flag), np.uint8(0))
    identifier = there.get("ID", nothing).astype(np.uint32)
    if "IDE" not in there:
        flags |= np.where(identifier & EXTENDED_ID, np.uint8(Flag.EXTENDED), np.uint8(0))
    sent = there.get("Dir", nothing)
    flags |= np.where(sent == b"Tx" if sent.dtype.kind == "S" else sent != 0, np.uint8(Flag.SENT), np.uint8(0))
    told = np.atleast_2d(there.get("DataBytes", np.zeros((count, 0), np.uint8)))[:, :LONGEST].astype(np.uint8)
    length = _lengths(there, name, flags)
    filled = np.where(flags & Flag.REMOTE, 0, np.minimum(length, told.shape[1]))
    width = LONGEST if np.any(filled > CLASSIC) else CLASSIC
    data = np.zeros((count, width), np.uint8)
    data[:, : told.shape[1]] = told[:, :width]
    data *= np.arange(width) < filled[:, None]
    length = np.where(flags & Flag.REMOTE, length, filled).astype(np.uint8)
    return Frames(
        time,
        identifier & np.uint32(0x1FFFFFFF),
        flags,
        np.clip(there.get("BusChannel", nothing).astype(np.int64) - first_channel, 0, 255).astype(np.uint8),
        length,
        data,
    )


def _lengths(there: dict[str, NDArray[Any]], name: str, flags: Bytes) -> Bytes:
    """Data bytes of each frame; where nothing but the length code tells, what it stands for."""
    fd = (flags & np.uint8(Flag.FD)) != 0
    codes = there.get("DLC", np.zeros(len(flags), np.uint8))
    told = np.where(fd, LENGTHS[np.minimum(codes, 15)], np.minimum(codes, CLASSIC))
    if name == "CAN_RemoteFrame":
        told = codes
    elif "DataLength" in there:
        told = there["DataLength"]
    return np.asarray(np.minimum(told, LONGEST), np.uint8)


def _fields(name: str) -> np.dtype[Any]:
    numbers = ["BusChannel", "ID", "IDE", "DLC", "DataLength", "DataBytes", "Dir", "EDL", "BRS", "ESI"]
    if name == "CAN_RemoteFrame":
        numbers = ["BusChannel", "ID", "IDE", "DLC", "DataLength", "Dir"]
    kinds = {"ID": "<u4", "BusChannel": "<u2", "DataBytes": f"({LONGEST},)u1"}
    return np.dtype([(f"{name}.{field}", kinds.get(field, "<u1")) for field in numbers])


def _records(frames: Frames, name: str) -> NDArray[Any]:
    records = np.zeros(len(frames), _fields(name))
    values = {
        "BusChannel": frames.channel.astype(np.uint16) + FIRST,
        "ID": frames.id,
        "DLC": DLC[np.minimum(frames.length, LONGEST)],
        "DataLength": frames.length,
        "Dir": frames.has(Flag.SENT),
        **{bit: frames.has(flag) for bit, flag in BITS.items()},
    }
    for field, value in values.items():
        if f"{name}.{field}" in (records.dtype.names or ()):
            records[f"{name}.{field}"] = value
    if name != "CAN_RemoteFrame":
        records[f"{name}.DataBytes"][:, : frames.data.shape[1]] = frames.data
    return records


def _append_groups(asammdf: Any, mdf: Any, database: Path | None) -> None:
    """The three empty groups of a bus log."""
    from asammdf.blocks.source_utils import Source  # noqa: PLC0415

    attachment = None
    if database is not None:
        content = database.read_bytes()
        attachment = content, database.name, hashlib.md5(content, usedforsecurity=False).digest()
    source = Source("", "", "", Source.BUS_TYPE_CAN, Source.SOURCE_BUS)
    for name in KINDS:
        mdf.append(
            asammdf.Signal(
                name=name,
                samples=np.array([], _fields(name)),
                timestamps=np.array([], "<f8"),
                attachment=attachment,
                source=source,
            )
        )
