"""Messages of a CANopen device, out of the process data that its EDS or DCF maps (CiA 301, 7.5.2.35 to 7.5.2.38)."""

from __future__ import annotations

import io
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cantools.database.can import Message, Signal
from cantools.database.conversion import BaseConversion

from fmus.errors import DatabaseError
from fmus.words import complaint

COMMUNICATION = {"RPDO": 0x1400, "TPDO": 0x1800}  # the first object of each kind
MAPPED = 0x200  # from there to the object with its mapping
MOST = 512  # of a kind
NOT_USED, EXTENDED = 1 << 31, 1 << 29  # bits of a COB-ID
DUMMIES = 0x20  # lower indexes stand for bits that nobody uses
SIGNED, FLOATS = (2, 3, 4, 0x10, 0x12, 0x13, 0x14, 0x15), (8, 0x11)  # types
UNSIGNED = (1, 5, 6, 7, 0x16, 0x18, 0x19, 0x1A, 0x1B)


@dataclass(frozen=True)
class DeviceMessages:
    """The messages of a device.

    Attributes:
        messages: as cantools has them.
        of_any_node: names of those whose identifier is that of node 0, to which the number of the node is added.
        notes: what was assumed or left out, a line each.
    """

    messages: list[Message]
    of_any_node: frozenset[str]
    notes: list[str]


def read(path: Path, text: str) -> DeviceMessages:
    """The messages that the device sends (TPDO) and receives (RPDO).

    Raises:
        DatabaseError: python-canopen is not installed or cannot read it, or no process data are mapped.
    """
    try:
        from canopen.objectdictionary import eds  # noqa: PLC0415 - optional
    except ImportError:
        raise DatabaseError(path, "needs python-canopen", "pip install servotwin[canopen]") from None
    import_eds: Any = eds.import_eds
    notes: list[str] = []
    try:
        node = import_eds(io.StringIO(text), None).node_id
        dictionary = import_eds(io.StringIO(text), node or 0)  # without a number it cannot read `$NODEID+0x1C0`
        found = list(_messages(dictionary, node, notes))
    except Exception as error:  # it meets whatever the file holds
        raise DatabaseError(path, f"cannot be read: {complaint(error)}", "export it again") from error
    if not found:
        raise DatabaseError(path, "maps no process data (PDO)", "give the device's EDS or DCF with its mapping")
    return DeviceMessages(
        [message for message, _ in found], frozenset(message.name for message, any_node in found if any_node), notes
    )


def _messages(dictionary: Any, node: int | None, notes: list[str]) -> Iterator[tuple[Message, bool]]:
    """Each message, and whether its identifier is that of any node."""
    for kind, first in COMMUNICATION.items():
        for number in range(MOST):
            index = first + number
            if index not in dictionary or index + MAPPED not in dictionary:
                continue
            identifier, relative = _identifier(dictionary[index], kind, number, node)
            odd: list[str] = []
            signals = list(_signals(dictionary, dictionary[index + MAPPED], odd))
            if identifier & NOT_USED:
                continue
            notes += [f"{kind}{number + 1}: {what}" for what in odd]
            if not signals:
                continue
            bits = max(signal.start + signal.length for signal in signals)
            message = Message(
                identifier & (0x1FFFFFFF if identifier & EXTENDED else 0x7FF),
                f"{kind}{number + 1}",
                -(-bits // 8),
                signals,
                is_extended_frame=bool(identifier & EXTENDED),
                cycle_time=_value(dictionary[index], 5) or None,
                strict=False,
            )
            yield message, relative and node is None


def _identifier(record: Any, kind: str, number: int, node: int | None) -> tuple[int, bool]:
    """The COB-ID, and whether the number of the node is part of it; the first four have one that is agreed on."""
    entry = record.subindices.get(1)
    given = _value(record, 1)
    if given is not None:
        return given, bool(getattr(entry, "relative", False))
    if number >= 4:
        return NOT_USED, False
    return (0x200 if kind == "RPDO" else 0x180) + 0x100 * number + (node or 0), True


def _signals(dictionary: Any, mapping: Any, odd: list[str]) -> Iterator[Signal]:
    """The signals of a mapping, and what is odd about it."""
    count, start = _value(mapping, 0), 0
    taken: set[str] = set()
    for place in range(1, (64 if count is None else min(count, 64)) + 1):
        entry = _value(mapping, place)
        if entry is None and count is not None:
            odd.append(f"entry {place} of its mapping has no value; what lies from there on is left out")
            return
        if not entry:
            continue
        index, sub, length = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
        if index >= DUMMIES and length:
            yield _signal(dictionary, index, sub, start, length, taken, odd)
        start += length


def _signal(dictionary: Any, index: int, sub: int, start: int, length: int, taken: set[str], odd: list[str]) -> Signal:
    """The signal of an object, which is called by its name, or by its number where the file does not describe it."""
    entry: Any = dictionary.get(index)
    own = entry.subindices.get(sub) if hasattr(entry, "subindices") else entry
    title = f"x{index:04X}_{sub:02X}" if own is None else own.name if own is entry else f"{entry.name}_{own.name}"
    name = re.sub(r"\W+", "_", title, flags=re.ASCII).strip("_") or f"x{index:04X}"
    name = f"{name}_{index:04X}_{sub:02X}" if name in taken else name
    taken.add(name)
    kind = None if own is None else own.data_type
    if kind not in (*SIGNED, *UNSIGNED, *FLOATS):
        why = "the file does not describe it" if own is None else "its type is none of numbers"
        odd.append(f"{name} is taken for an unsigned number: {why}")
    return Signal(
        name,
        start,
        length,
        is_signed=kind in SIGNED,
        conversion=BaseConversion.factory(getattr(own, "factor", 1) or 1, 0, is_float=kind in FLOATS),
        unit=getattr(own, "unit", "") or None,
        comment=title,
    )


def _value(record: Any, sub: int) -> int | None:
    """The number in an entry: the one that the device is set to (DCF), else the default."""
    entry = record.subindices.get(sub)
    found = None if entry is None else entry.default if entry.value is None else entry.value
    return found if isinstance(found, int) else None
