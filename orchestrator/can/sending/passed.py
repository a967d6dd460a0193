"""What a gateway has passed, what was lost, and what was not to pass."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field

from orchestrator.realtime.lateness import Lateness


@dataclass
class PassedFrames:
    """What went one way.

    Attributes:
        source, target: the buses.
        given: message, or identifier -> frames that the adapter of the target took.
        out: frames of these that got out, as far as the adapter tells.
        unsent: frames that it had no room for, or no bus; dropped: frames that came faster than they were passed,
            or in a pause of this process.
        left_out: why frames were not to be passed -> how many.
        lateness: from the stamp of a frame to when it was given on.
    """

    KEYS = (
        *("from=source", "to=target", "passed=out", "lost", "dropped", "messages=given", "left_out"),
        "lateness=lateness.figures",
    )

    source: str
    target: str
    given: Counter[str] = field(default_factory=Counter)
    out: int = 0
    unsent: int = 0
    dropped: int = 0
    left_out: Counter[str] = field(default_factory=Counter)
    lateness: Lateness = field(default_factory=Lateness)

    @property
    def lost(self) -> int:
        """Frames that were to be passed, and did not get out."""
        return self.given.total() - self.out + self.unsent + self.dropped


@dataclass
class Passed:
    """What a gateway has passed.

    Attributes:
        ways: from the first bus to the second, and back.
        errors: error frames that came; states: what adapters said of themselves.
        missing: names of what is chosen and has not come.
        last: frames that were sent last, as `123#00`.
        told: whether adapters say which frames got out.
    """

    KEYS = ("ways", "seconds", "error_frames=errors", "missing", "last", "confirmed=told")

    ways: tuple[PassedFrames, PassedFrames]
    seconds: float = 0.0
    errors: int = 0
    missing: list[str] = field(default_factory=list)
    last: list[str] = field(default_factory=list)
    told: bool = True

    def lines(self) -> list[str]:
        """For people."""
        told = {
            f"sent last: {', '.join(self.last)}": self.last,
            f"no frame came of {', '.join(self.missing)}": self.missing,
            f"{self.errors:,} error frames came, and were not passed": self.errors,
            "frames count as passed that an adapter took: one of them does not tell which got out": not self.told,
        }
        return [line for way in self.ways for line in _told(way)] + [line for line, holds in told.items() if holds]


def _told(way: PassedFrames) -> Iterator[str]:
    late = way.lateness.figures
    times = (
        f", after {1e3 * late['median']:.2f} ms (median), {1e3 * late['p99']:.2f} ms (99 %), "
        f"{1e3 * late['worst']:.2f} ms (most)"
    )
    yield f"{way.source} -> {way.target}: {way.out:,} frames{times if way.given else ''}"
    if way.lost:
        yield f"{way.source} -> {way.target}: {way.lost:,} frames were LOST: there was no room for them, or no bus"
    for why, count in sorted(way.left_out.items()):
        yield f"{way.source} -> {way.target}: {count:,} frames were not passed: {why}"
