"""Writes the CAN database of a system's declared signals, for those who have none: what can be said of a layout.

Signals with both bounds become whole numbers of 16 bits whose resolution is the next round one (1, 2 or 5 times a
power of ten, 1e-30 at least) that spans the bounds. Without both bounds, or where that resolution is coarser than a
thousandth of the nominal value, a signal is a float of 32 bits. Signals of one sender and one period share messages, in
the order of their declaration, until a message is full. Faster messages have lower identifiers, which win on the bus.
"""

from __future__ import annotations

import math
import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import Any

from cantools.database.can import Database, Message, Node, Signal
from cantools.database.can.formats.dbc.dbc_attribute_definition import DbcAttributeDefinition
from cantools.database.can.formats.dbc.dbc_specifics import DbcSpecifics
from cantools.database.conversion import BaseConversion

from fmus.errors import DatabaseError
from orchestrator.can.frames import CLASSIC, LONGEST

FIRST_ID, LAST_ID = 0x100, 0x7FF
LONGEST_NAME = 32
_LARGEST = 1e30  # of bounds and nominal values
_FINEST = 1e-30  # of resolutions, far from where numbers lose digits and end in 0
_FINE = 1000  # steps that a nominal value has at least
_SENDER, _RECEIVER = "Servotwin", "Any"


@dataclass(frozen=True)
class Declared:
    """A signal to be sent.

    Attributes:
        name: such as component.variable.
        minimum, maximum, nominal: of the value [unit]; None where not known.
        every: period [s]; None for a message without one.
        sender: the node that sends it; "" for the one all others have.
    """

    name: str
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    nominal: float | None = None
    every: float | None = None
    sender: str = ""


def generate(signals: Sequence[Declared], path: Path | None = None, fd: bool = False) -> str:
    """The DBC text of these signals, also written to `path`; `fd` fills messages up to 64 bytes instead of 8.

    Raises:
        DatabaseError: a declaration is wrong, or there are more messages than identifiers.
    """
    names = signal_names([signal.name for signal in signals])
    for signal in signals:
        _check(signal)
    loads = list(_loads(signals, LONGEST if fd else CLASSIC))
    if not loads or len(loads) > LAST_ID - FIRST_ID + 1:
        raise DatabaseError(
            "CAN database",
            f"{len(signals)} signals make {len(loads)} messages",
            "declare 1 or more signals, or split them over databases",
        )
    whole = all(_milliseconds(load.every).is_integer() for load in loads)
    messages = [
        _message(FIRST_ID + number, title, load, names, whole, fd)
        for number, (title, load) in enumerate(zip(_titles(loads), loads, strict=True))
    ]
    nodes = [Node(node) for node in dict.fromkeys([*(load.sender for load in loads), _RECEIVER])]
    definitions: Any = _definitions(loads, whole, fd)
    text = Database(messages, nodes, dbc_specifics=DbcSpecifics(attribute_definitions=definitions)).as_dbc_string()
    if path is not None:
        Path(path).write_text(text, encoding="utf-8", newline="")
    return str(text)


def signal_names(names: Sequence[str]) -> dict[str, str]:
    """Name -> the name that it has in the database: letters, digits and underscores, at most 32, all different.

    Raises:
        DatabaseError: a name is given twice.
    """
    found: dict[str, str] = {}
    for name in names:
        if name in found:
            raise DatabaseError(f"signal {name}", "is declared twice", "declare it once")
        found[name] = _distinct(_plain(name), found.values())
    return found


@dataclass(frozen=True)
class _Load:
    """What shares a message."""

    sender: str
    every: float | None
    signals: tuple[Declared, ...]


def _check(signal: Declared) -> None:
    given = [value for value in (signal.minimum, signal.maximum, signal.nominal, signal.every) if value is not None]
    if not all(abs(value) < _LARGEST for value in given):
        raise DatabaseError(f"signal {signal.name}", f"has a bound that is not below {_LARGEST:g}", "leave it out")
    if signal.minimum is not None and signal.maximum is not None and signal.minimum >= signal.maximum:
        raise DatabaseError(
            f"signal {signal.name}",
            f"ranges from {signal.minimum:g} to {signal.maximum:g}",
            "give a minimum below the maximum",
        )
    if signal.every is not None and not 1e-5 <= signal.every <= 65:
        raise DatabaseError(f"signal {signal.name}", f"has a period of {signal.every:g} s", "use 10 us to 65 s")


def _loads(signals: Sequence[Declared], size: int) -> Iterator[_Load]:
    """The messages, the fastest first."""

    def key(signal: Declared) -> tuple[float, str]:
        return math.inf if signal.every is None else signal.every, _plain(signal.sender or _SENDER)

    for (_, node), group in groupby(sorted(signals, key=key), key):
        waiting: list[Declared] = []
        for signal in group:
            if sum(map(_bytes, [*waiting, signal])) > size:
                yield _Load(node, waiting[0].every, tuple(waiting))
                waiting = []
            waiting.append(signal)
        yield _Load(node, waiting[0].every, tuple(waiting))


def _bytes(signal: Declared) -> int:
    return 4 if _scaling(signal) is None else 2


def _scaling(signal: Declared) -> tuple[float, float, bool] | None:
    """Resolution, offset and signedness of 16 bits; None for a float."""
    if signal.minimum is None or signal.maximum is None:
        return None
    low, high = signal.minimum, signal.maximum
    signed = low < 0
    plain = _round_up(max(-low / 32768, high / 32767) if signed else high / 65535)
    moved = _round_up((high - low) / 65534)  # one step less, for the offset is rounded down to a step
    scale, offset, signed = (plain, 0.0, signed) if plain <= 5 * moved else (moved, _floor(low, moved), False)
    if signal.nominal and abs(signal.nominal) < _FINE * scale:
        return None
    return scale, offset, signed


def _round_up(value: float) -> float:
    """The next of 1, 2 and 5 times powers of ten, the finest resolution at least."""
    value = max(value, _FINEST)
    power = math.floor(math.log10(value))
    rounded = (float(f"{digit}e{power}") for digit in (1, 2, 5, 10))
    return next(number for number in rounded if number >= value * (1 - 1e-12))


def _floor(value: float, step: float) -> float:
    return float(f"{math.floor(value / step) * step:.12g}")


def _message(identifier: int, title: str, load: _Load, names: dict[str, str], whole: bool, fd: bool) -> Message:
    placed, start = [], 0
    for signal in load.signals:
        placed.append(_signal(signal, names[signal.name], start))
        start += 8 * _bytes(signal)
    size = next(size for size in (*range(9), 12, 16, 20, 24, 32, 48, 64) if 8 * size >= start)
    milliseconds: Any = _milliseconds(load.every)
    cycle = None if load.every is None else int(milliseconds) if whole else milliseconds
    return Message(
        identifier,
        title,
        size,
        placed,
        cycle_time=cycle,
        senders=[load.sender],
        is_fd=fd,
        comment=f"sent by {load.sender}",
        strict=True,
    )


def _signal(declared: Declared, name: str, start: int) -> Signal:
    scaling = _scaling(declared)
    scale, offset, signed = scaling or (1, 0, False)
    return Signal(
        name=name,
        start=start,
        length=32 if scaling is None else 16,
        is_signed=signed,
        conversion=BaseConversion.factory(_whole(scale), _whole(offset), is_float=scaling is None),
        minimum=declared.minimum if scaling else None,
        maximum=declared.maximum if scaling else None,
        unit=declared.unit.replace('"', "'") or None,
        comment=declared.name.replace('"', "'"),
        receivers=[_RECEIVER],
    )


def _whole(value: float) -> float:
    """An int where the value is whole, which cantools writes without a point."""
    return int(value) if float(value).is_integer() else value


def _milliseconds(every: float | None) -> float:
    """The period as a cycle time, which is 0 where there is none."""
    return float(f"{1000 * (every or 0.0):.9g}")


def _titles(loads: Sequence[_Load]) -> list[str]:
    """Names of the messages: sender and period."""
    titles: list[str] = []
    for load in loads:
        rate = "" if load.every is None else f"_{_period(load.every)}"
        titles.append(_distinct(load.sender[: LONGEST_NAME - len(rate)] + rate, titles))
    return titles


def _period(every: float) -> str:
    for factor, unit in ((1, "s"), (1e3, "ms"), (1e6, "us")):
        count = every * factor
        if abs(count - round(count)) < 1e-6 * count:
            return f"{round(count)}{unit}"
    return f"{round(every * 1e9)}ns"


def _plain(name: str) -> str:
    plain = re.sub(r"[^A-Za-z0-9_]", "_", name)[:LONGEST_NAME]
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"[:LONGEST_NAME]


def _distinct(name: str, taken: Container[str]) -> str:
    """The name, with a number behind it where it is taken."""
    found, number = name, 1
    while found in taken:
        number += 1
        found = f"{name[: LONGEST_NAME - len(str(number)) - 1]}_{number}"
    return found


def _definitions(loads: Sequence[_Load], whole: bool, fd: bool) -> dict[str, DbcAttributeDefinition[Any]]:
    """Attributes of messages: the cycle time [ms], with a fraction where one needs it; the kind of frame."""
    found: dict[str, DbcAttributeDefinition[Any]] = {}
    if any(load.every is not None for load in loads):
        kind, least, most = ("INT", 0, 65535) if whole else ("FLOAT", 0.0, 65535.0)
        found["GenMsgCycleTime"] = DbcAttributeDefinition("GenMsgCycleTime", least, "BO_", kind, least, most)
    if fd:
        kinds = ["StandardCAN", "ExtendedCAN", *["reserved"] * 12, "StandardCAN_FD", "ExtendedCAN_FD"]
        found["VFrameFormat"] = DbcAttributeDefinition("VFrameFormat", "StandardCAN", "BO_", "ENUM", choices=kinds)
    return found
