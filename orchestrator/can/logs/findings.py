"""What reading a log came across besides frames: places that could not be read, and events that are no frames.

Readers report here instead of stopping, so that one bad byte costs one line or one object and not the log.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from orchestrator.can.frames import coarsened, stamps
from orchestrator.trace import FloatArray

NO_ZONE = "the log's start names no time zone and counts as UTC"
COARSE = "stamps finer than a microsecond are kept to a quarter of one beside their date"
KEPT = 1000  # places that are remembered; those beyond are only counted


@dataclass(frozen=True)
class Damage:
    """A place of a log that could not be read.

    Attributes:
        offset: of its first byte in the file; None inside a database.
        line: its number from 1 in a text file, the row's in a database.
    """

    offset: int | None
    problem: str
    line: int | None = None

    def __str__(self) -> str:
        if self.offset is None:
            return f"row {self.line}: {self.problem}"
        return f"byte {self.offset}{'' if self.line is None else f', line {self.line}'}: {self.problem}"


@dataclass
class Findings:
    """What was found so far.

    Attributes:
        damage: the first `KEPT` places that could not be read.
        damaged: how many there are.
        skipped: events that are no CAN frames: markers, statistics, other buses.
        notes: what was assumed or worked out to read the log, each said once.
        channels: names of interfaces by the number of their channel, where the log has names.
        zoneless: whether the log has a date without a time zone, which counts as UTC.
    """

    KEYS = ("skipped?", "notes?", "damaged?", "damage?")

    damage: list[Damage] = field(default_factory=list)
    damaged: int = 0
    skipped: int = 0
    notes: list[str] = field(default_factory=list)
    zoneless: bool = False
    channels: dict[int, str] = field(default_factory=dict)

    def add(self, offset: int | None, problem: str, line: int | None = None) -> None:
        """Note a place."""
        self.damaged += 1
        if len(self.damage) < KEPT:
            self.damage.append(Damage(offset, problem, line))

    def note(self, text: str) -> None:
        """Say what was assumed."""
        if text not in self.notes and len(self.notes) < KEPT:
            self.notes.append(text)

    def dated(self, start: float, offset: FloatArray) -> FloatArray:
        """(K,) POSIX times of what comes after a start [s]; what they cannot tell is noted."""
        time = stamps(start, offset)
        if coarsened(start, offset, time):
            self.note(COARSE)
        return time

    def lines(self, most: int = 5) -> list[str]:
        """For people: nothing where nothing was found, else what was assumed, the first places and the counts."""
        told = [*self.notes]
        told += [f"could not be read: {damage}" for damage in self.damage[:most]]
        if self.damaged > most:
            told.append(f"could not be read: {self.damaged - most} more places")
        if self.skipped:
            told.append(f"{self.skipped} events that are no CAN frames passed over")
        return told
