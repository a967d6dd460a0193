"""What was found in a stream of CAN frames: how many of what, and everything that was not as it should be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field

from fmus import words

MOST = 1000  # different unknown identifiers, or places, that are kept; beyond it they are only counted
OTHERS = "others"
StatisticsDocument = dict[str, int | dict[str, int] | list[dict[str, float]]]
"""Count, or name -> count, or setbacks, by what is counted."""


@dataclass(frozen=True)
class Setback:
    """A clock that jumped backwards, or frames that did not come for long.

    Attributes:
        frame: number of the first frame after it, from 0.
        before, after: stamps on either side [s].
    """

    frame: int
    before: float
    after: float

    def __str__(self) -> str:
        return f"at frame {self.frame} from {self.before:.6f} s to {self.after:.6f} s"


@dataclass
class FrameStatistics:
    """Counts over a stream of frames; all but the first two are of things that are not as they should be.

    Attributes:
        frames: all frames, whatever they are.
        messages: message -> its frames, those of a wrong length included.
        unknown: identifier as hexadecimal digits (three, or eight of an extended one) -> frames; when there are
            more than `MOST` the rest is under "others".
        errors, remotes: error frames, remote frames.
        short: message -> frames with too few bytes, which are not decoded; long: with too many, which are.
        other_sources: message -> frames from other senders than the one that is wanted; they are not decoded.
        transported: messages that came in parts by J1939's transport protocol; broken: those that lack a part so far.
        multiplexers: message -> frames whose multiplexer has a value that no signal belongs to.
        duplicates: message -> frames that repeat the one before in stamp and data; they are dropped.
        crowded: message -> frames that shared a stamp with another of it; they are spread over the log's smallest step.
        missing: message -> lost frames, estimated from its counter; without one, or where it may have gone round, from
            its cycle time.
        counters: message -> steps of its counter that are not one.
        checksums: message -> frames with a wrong checksum; their values are dropped.
        not_finite: signal -> received values that are NaN or infinite (the last finite one is held).
        out_of_range: signal -> received values outside its range.
        saturated: signal -> sent values that did not fit and were limited; limited: that were limited as asked.
        unfit: signal that nobody sets -> frames with the nearest to its initial value, which is outside its range.
        disordered: frames with a stamp before that of a frame before them (sorted).
        late: rows with a stamp before what had been passed on (dropped).
        covered: samples with the very stamp of a later one of their message (dropped).
        strays: frames whose stamp alone is off, or not a time; they take the stamp before.
        setbacks: clocks that jumped backwards, the first `MOST`; setback_count counts all.
        silences: where no frame at all came for long, the first `MOST`.
    """

    frames: int = 0
    messages: Counter[str] = field(default_factory=Counter)
    unknown: Counter[str] = field(default_factory=Counter)
    errors: int = 0
    remotes: int = 0
    short: Counter[str] = field(default_factory=Counter)
    long: Counter[str] = field(default_factory=Counter)
    other_sources: Counter[str] = field(default_factory=Counter)
    transported: int = 0
    broken: int = 0
    multiplexers: Counter[str] = field(default_factory=Counter)
    duplicates: Counter[str] = field(default_factory=Counter)
    crowded: Counter[str] = field(default_factory=Counter)
    missing: Counter[str] = field(default_factory=Counter)
    counters: Counter[str] = field(default_factory=Counter)
    checksums: Counter[str] = field(default_factory=Counter)
    not_finite: Counter[str] = field(default_factory=Counter)
    out_of_range: Counter[str] = field(default_factory=Counter)
    saturated: Counter[str] = field(default_factory=Counter)
    limited: Counter[str] = field(default_factory=Counter)
    unfit: Counter[str] = field(default_factory=Counter)
    disordered: int = 0
    late: int = 0
    covered: int = 0
    strays: int = 0
    setbacks: list[Setback] = field(default_factory=list)
    setback_count: int = 0
    silences: list[Setback] = field(default_factory=list)

    @property
    def clean(self) -> bool:
        """Whether everything was as it should be."""
        return not self.lines()

    def add_unknown(self, identifier: int, extended: bool, count: int = 1) -> None:
        """Count frames of an identifier that is not in the database."""
        name = identifier_text(identifier, extended)
        self.unknown[name if name in self.unknown or len(self.unknown) < MOST else OTHERS] += count

    def add_missing(self, name: str, count: int) -> None:
        """Count lost frames; a negative count takes back those that turn out to have been late."""
        self.missing[name] += count
        if not self.missing[name]:
            del self.missing[name]

    def add_setback(self, frame: int, before: float, after: float) -> None:
        """Count a clock that jumped backwards."""
        self.setback_count += 1
        if len(self.setbacks) < MOST:
            self.setbacks.append(Setback(frame, before, after))

    def add_silence(self, frame: int, before: float, after: float) -> None:
        """Note that no frame came between two stamps."""
        if len(self.silences) < MOST:
            self.silences.append(Setback(frame, before, after))

    def lines(self) -> list[str]:
        """A line for each kind of trouble, for people; none when there was none."""
        found = [f"{text}: {_listed(counts)}" for text, counts in self._by_name().items() if counts]
        found += [f"{text}: {count}" for text, count in self._in_all().items() if count]
        if self.setback_count:
            places = ", ".join(map(str, self.setbacks[:3])) + (", ..." if self.setback_count > 3 else "")
            found.append(f"clock jumped backwards {places}; later stamps were moved to follow on")
        if self.silences:
            places = words.listed([*map(str, self.silences)], 3)
            found.append(f"no frame came, or the clock was put forward, {places}")
        return found

    def document(self) -> StatisticsDocument:
        """All counts by name, for JSON; what did not occur is left out."""
        kept: StatisticsDocument = {"frames": self.frames, "messages": dict(self.messages)}
        for name, value in vars(self).items():
            if name not in (*kept, "setbacks", "silences") and value:
                kept[name] = dict(value) if isinstance(value, Counter) else value
        if self.setbacks:
            kept["setbacks"] = [vars(setback) for setback in self.setbacks]
        if self.silences:
            kept["silences"] = [vars(silence) for silence in self.silences]
        return kept

    def _by_name(self) -> dict[str, Counter[str]]:
        return {
            "frames of unknown identifiers": self.unknown,
            "frames too short, not decoded": self.short,
            "frames of another source address, not decoded": self.other_sources,
            "frames longer than their message": self.long,
            "frames with an unknown multiplexer value": self.multiplexers,
            "repeated frames, dropped": self.duplicates,
            "frames of one message with equal stamps, spread over the log's smallest step": self.crowded,
            "frames missing (estimated)": self.missing,
            "wrong steps of the message counter": self.counters,
            "frames with wrong checksums, dropped": self.checksums,
            "values not finite": self.not_finite,
            "values outside their range": self.out_of_range,
            "values limited to fit": self.saturated,
            "values limited by `limit`": self.limited,
            "initial values outside their range, limited": self.unfit,
        }

    def _in_all(self) -> dict[str, int]:
        return {
            "messages in parts of which one is missing, dropped": self.broken,
            "error frames": self.errors,
            "remote frames": self.remotes,
            "frames out of order, sorted": self.disordered,
            "frames too late to be sorted in, dropped": self.late,
            "samples with the stamp of a later one of their message, dropped": self.covered,
            "frames with a stray stamp, given the one before": self.strays,
        }


def joined(parts: Mapping[str, FrameStatistics]) -> FrameStatistics:
    """What was found in several streams together; each one's names begin with its own prefix."""
    whole = FrameStatistics()
    for prefix, part in parts.items():
        for name, value in vars(part).items():
            if isinstance(value, Counter):
                getattr(whole, name).update({prefix + key: count for key, count in value.items()})
            else:
                setattr(whole, name, getattr(whole, name) + value)
    del whole.setbacks[MOST:], whole.silences[MOST:]
    return whole


def identifier_text(identifier: int, extended: bool) -> str:
    """An identifier as hexadecimal digits: three, or eight of an extended one."""
    return f"{identifier:08X}" if extended else f"{identifier:03X}"


def add(counts: Counter[str], name: str, count: int) -> None:
    """Count so many under the name; names without any do not appear."""
    if count:
        counts[name] += count


def _listed(counts: Mapping[str, int], most: int = 5) -> str:
    """The total and the largest shares."""
    largest = sorted(counts.items(), key=lambda share: -share[1])
    shown = ", ".join(f"{name} {count}" for name, count in largest[:most]) + (", ..." if len(largest) > most else "")
    return shown if len(largest) == 1 else f"{sum(counts.values())} ({shown})"
