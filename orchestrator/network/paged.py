"""Where signals lie in the frames of a network FMU: in all of them, or in those that a multiplexer selects."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from fmus.errors import DatabaseError
from fmus.packaging.native.network import FrameSignal, SelectedBy
from orchestrator.can.codec.fields import field_of, longest, raw_limits, resting
from orchestrator.can.codec.message_writer import MessageWriter
from orchestrator.can.codec.multiplexing import pages
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.can.statistics import FrameStatistics

_FLOATS = (32, 64)
_EXACT = 0x1FFFFFFF


def place_of(place: str, signal: SignalSpec) -> tuple[int, int, bool, bool, bool]:
    """Where a signal lies in its frame, and what its bits stand for."""
    if signal.is_float and signal.length not in _FLOATS:
        raise DatabaseError(place, f"is a float of {signal.length} bits", "have it of 32 or 64 bits")
    return signal.lowest, signal.length, signal.big_endian, signal.is_signed, signal.is_float


def presence_of(place: str, message: MessageSpec, signal: SignalSpec) -> SelectedBy | None:
    """In which frames of a message a signal is; None for all.

    Raises:
        DatabaseError: its multiplexer is a float, or a value that selects it is none that it can have.
    """
    if not signal.multiplexer:
        return None
    selector = message.signal(signal.multiplexer)
    raws = [(value - selector.offset) / selector.scale if selector.scale else 0.5 for value in signal.selected_by]
    if selector.is_float or not all(float(raw).is_integer() for raw in raws):
        problem = f"is selected by {selector.name}, which cannot have its values exactly"
        raise DatabaseError(f"{place}.{signal.name}", problem, "have its multiplexer a whole number")
    above = presence_of(place, message, selector)
    lies = FrameSignal("", *place_of(place, selector), 1.0, 0.0, 0.0, 0.0, above)
    return SelectedBy(lies, tuple(map(int, raws)))


def in_order(place: str, message: MessageSpec, signals: Iterable[FrameSignal]) -> tuple[FrameSignal, ...]:
    """Signals that a model gives, and what rests in frames that it selects: what selects before what is selected.

    Raises:
        DatabaseError: a multiplexer that nobody sets is in some frames only that the model selects.
    """
    ours = {signal.variable: signal for signal in signals}
    for signal in _dependent(message, ours.keys()):
        if signal.name in ours:
            continue
        if signal.is_multiplexer:
            problem = f"is in frames that {signal.multiplexer} selects, which the model gives, and nobody sets it"
            raise DatabaseError(f"{place}.{signal.name}", problem, "give the model an output of its name")
        raw = _resting_raw(signal)
        presence = presence_of(place, message, signal)
        lies = place_of(f"{place}.{signal.name}", signal)
        ours[signal.name] = FrameSignal("", *lies, 1.0, 0.0, raw, raw, presence)
    return tuple(sorted(ours.values(), key=_depth))


def pages_of(place: str, message: MessageSpec, given: Collection[str]) -> tuple[bytes, ...]:
    """Data of frames in which all that the model does not give rests: a frame for each value that multiplexers have in
    turn, so that every signal of the model is in one."""
    cleared = [field_of(signal) for signal in _dependent(message, given)]
    found = []
    for page in pages(message, given):
        writer = MessageWriter(message, {name: name for name in page}, FrameStatistics())
        data = writer.write(np.zeros(1), {name: np.array([float(value)]) for name, value in page.items()}).data
        bits = np.unpackbits(data[0, : longest(message)], bitorder="little")
        for field in cleared:
            bits[list(_bits(field.lowest, field.length, field.big_endian))] = 0
        found.append(np.packbits(bits, bitorder="little").tobytes())
    return tuple(found)


def received_by(database: Database, message: MessageSpec) -> int:
    """The bits by which frames are told to be a message's: of a J1939 group with one sender, or any, its group's."""
    addressing = message.addressing
    if addressing is None:
        return _EXACT
    group = message.id & addressing.mask
    alike = [one for one in database.messages if one.addressing == addressing and one.id & addressing.mask == group]
    alone = message.of_any_sender or len(alike) == 1
    return addressing.mask if alone else addressing.mask | addressing.sender


def _dependent(message: MessageSpec, given: Collection[str]) -> Iterator[SignalSpec]:
    """Signals that are in some frames only, which the model selects."""
    for signal in message.signals:
        above = signal
        while above.multiplexer and above.multiplexer not in given:
            above = message.signal(above.multiplexer)
        if above.multiplexer:
            yield signal


def _resting_raw(signal: SignalSpec) -> float:
    if signal.is_float:
        low, high = raw_limits(signal)
        return min(max((resting(signal) - signal.offset) / signal.scale, low), high)
    raw, _ = field_of(signal).encoded(np.array([resting(signal)]), *raw_limits(signal))
    bits = int(raw[0])
    return float(bits - (1 << signal.length) if signal.is_signed and bits >> signal.length - 1 else bits)


def _depth(signal: FrameSignal) -> int:
    depth, at = 0, signal.presence
    while at is not None:
        depth, at = depth + 1, at.selector.presence
    return depth


def _bits(lowest: int, length: int, big_endian: bool) -> Iterator[int]:
    """Numbers of the bits of a field, each byte's lowest first."""
    for bit in range(length):
        at = lowest - bit
        yield at // 8 * 8 + 7 - at % 8 if big_endian else lowest + bit
