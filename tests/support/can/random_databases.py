"""Random databases for property tests: signals of all kinds that do not overlap, multiplexed ones among them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cantools
from cantools.database.can import Database, Message, Signal
from cantools.database.conversion import BaseConversion
from hypothesis import strategies as st

LENGTHS = (1, 2, 3, 5, 8, 12, 16, 24, 48, 64)
SCALES = st.sampled_from([1, -1, 2, 10, 0.5, 0.1, 0.001, -0.02, 1e-9, 3.7e5, 7])
OFFSETS = st.sampled_from([0, 1, -40, 0.5, -273.15, 1000000007])


@st.composite
def databases(draw: st.DrawFn, floats: bool = True) -> Database:
    """A few messages with distinct identifiers and distinct signal names."""
    count = draw(st.integers(1, 3))
    identifiers = draw(st.lists(st.integers(0, 0x7FF), min_size=count, max_size=count, unique=True))
    return Database([draw(messages(f"M{n}", identifier, floats)) for n, identifier in enumerate(identifiers)])


@st.composite
def messages(draw: st.DrawFn, name: str, identifier: int, floats: bool) -> Message:
    length = draw(st.sampled_from(LENGTHS))
    multiplexed = length >= 2 and draw(st.booleans())
    signals = []
    if multiplexed:
        signals.append(Signal(f"{name}_mux", 0, 8, is_multiplexer=True))
        for group in draw(st.lists(st.integers(0, 255), min_size=1, max_size=3, unique=True)):
            for signal in draw(filled(f"{name}_{group}", 1, length, floats)):
                signal.multiplexer_signal, signal.multiplexer_ids = f"{name}_mux", [group]
                signals.append(signal)
    else:
        signals = draw(filled(name, 0, length, floats))
    extended = draw(st.booleans())
    return Message(identifier, name, length, signals, is_extended_frame=extended, is_fd=length > 8, strict=True)


@st.composite
def filled(draw: st.DrawFn, name: str, first: int, end: int, floats: bool) -> list[Signal]:
    """Signals in the bytes from `first` to before `end`, which are cut into runs of either byte order."""
    signals: list[Signal] = []
    while first < end:
        size = draw(st.integers(1, end - first))
        big = draw(st.booleans())
        for bit, length in draw(places(8 * size)):
            start = bit + 8 * first
            where = 8 * (start // 8) + 7 - start % 8 if big else start
            signals.append(draw(signal(f"{name}_s{len(signals)}", where, length, big, floats)))
        first += size
    return signals or [Signal(f"{name}_s", 8 * (end - 1), 1)]


@st.composite
def places(draw: st.DrawFn, end: int) -> list[tuple[int, int]]:
    """First bit and length of signals that lie one behind the other."""
    found: list[tuple[int, int]] = []
    bit = draw(st.integers(0, 7))
    while bit < end and len(found) < 4:
        length = draw(st.integers(1, min(64, end - bit)) | st.sampled_from([8, 16, 32, 64]))
        if bit + length <= end:
            found.append((bit, length))
        bit += length + draw(st.integers(0, 5))
    return found


@st.composite
def signal(draw: st.DrawFn, name: str, start: int, length: int, big: bool, floats: bool) -> Signal:
    is_float = floats and length in (32, 64) and draw(st.booleans())
    conversion = BaseConversion.factory(draw(SCALES), draw(OFFSETS), is_float=is_float)
    order: Any = "big_endian" if big else "little_endian"
    return Signal(name, start, length, order, not is_float and draw(st.booleans()), conversion=conversion)


def written(database: Database, folder: Path) -> Path:
    """The database as a DBC file."""
    path = folder / "random.dbc"
    cantools.database.dump_file(database, str(path))
    return path
