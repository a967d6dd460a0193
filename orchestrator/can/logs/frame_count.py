"""What a log holds before anything is decoded: identifiers with counts and periods, duration, special frames."""

from __future__ import annotations

from dataclasses import dataclass, field
from datetime import UTC, datetime

import numpy as np

from fmus.words import listed
from orchestrator.can.frames import CALENDAR, Flag, Frames, since

MOST = 1 << 16  # different identifiers that are kept apart
SPECIAL = {
    "error frames": Flag.ERROR,
    "remote frames": Flag.REMOTE,
    "CAN FD frames": Flag.FD,
    "sent frames": Flag.SENT,
}


@dataclass
class Identifier:
    """Frames of one identifier: how many, and their first and last stamp [s]."""

    count: int
    first: float
    last: float

    @property
    def period(self) -> float | None:
        """Mean time between two frames [s]."""
        return round(_span(self.first, self.last) / (self.count - 1), 9) if self.count > 1 else None


@dataclass
class FrameCount:
    """Counts over a stream of frames.

    Attributes:
        identifiers: hexadecimal digits (three, or eight of an extended one) -> its frames, error frames left out.
        others: frames of further identifiers where there are very many.
        special: kind of frame -> how many.
        first, last: the least and the greatest stamp [s].
    """

    frames: int = 0
    identifiers: dict[str, Identifier] = field(default_factory=dict)
    others: int = 0
    special: dict[str, int] = field(default_factory=dict)
    channels: set[int] = field(default_factory=set)
    first: float = np.inf
    last: float = -np.inf

    def feed(self, frames: Frames) -> None:
        """Count these frames, too."""
        if not len(frames):
            return
        self.frames += len(frames)
        self.first = min(self.first, float(frames.time.min()))
        self.last = max(self.last, float(frames.time.max()))
        self.channels.update(np.unique(frames.channel).tolist())
        for name, flag in SPECIAL.items():
            if count := int(np.count_nonzero(frames.has(flag))):
                self.special[name] = self.special.get(name, 0) + count
        self._feed_identifiers(frames[~frames.has(Flag.ERROR)])

    def document(self) -> dict[str, object]:
        """All of it as plain values; times in seconds, the start as `moment` tells it."""
        document: dict[str, object] = {
            "frames": self.frames,
            "duration": round(_span(self.first, self.last), 9) if self.frames else 0.0,
            "start": moment(self.first) if self.frames else "",
            "channels": sorted(self.channels),
            "identifiers": [
                {"id": name, "frames": frames.count, "period": frames.period}
                for name, frames in sorted(self.identifiers.items())
            ],
        }
        document |= self.special
        if self.others:
            document["frames of more identifiers"] = self.others
        return document

    def listed(self, most: int = 10) -> str:
        """The identifiers, the most frequent first."""
        names = sorted(self.identifiers, key=lambda name: (-self.identifiers[name].count, name))
        return listed(names, most)

    def _feed_identifiers(self, frames: Frames) -> None:
        keys = frames.id.astype(np.int64) << 1 | frames.has(Flag.EXTENDED)
        order = np.argsort(keys, kind="stable")
        found, begins, counts = np.unique(keys[order], return_index=True, return_counts=True)
        first, last = frames.time[order[begins]], frames.time[order[begins + counts - 1]]
        for key, count, begin, end in zip(found.tolist(), counts.tolist(), first.tolist(), last.tolist(), strict=True):
            self._count(f"{key >> 1:08X}" if key & 1 else f"{key >> 1:03X}", count, begin, end)

    def _count(self, name: str, count: int, first: float, last: float) -> None:
        known = self.identifiers.get(name)
        if known is not None:
            known.count, known.last = known.count + count, last
        elif len(self.identifiers) < MOST:
            self.identifiers[name] = Identifier(count, first, last)
        else:
            self.others += count


def _span(first: float, last: float) -> float:
    return float(since(first, np.array([last]))[0])


def moment(stamp: float) -> str:
    """A stamp as date and time in UTC, or in seconds where it is none."""
    try:
        if stamp < CALENDAR:
            raise ValueError
        return datetime.fromtimestamp(stamp, UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")
    except (ValueError, OverflowError, OSError):
        return f"{stamp:g} s"
