"""Operations of FMI-LS-BUS 1.0 for CAN as they lie, one after the other, in the binary variables of FMUs.

Each begins with its code and its whole length, 4 bytes each; numbers are little-endian.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import Any, NamedTuple

from orchestrator.can.frames import CLASSIC, LENGTHS

MIME_TYPE = "application/org.fmi-standard.fmi-ls-bus.can"
_HEADER = Struct("<II")
_FD_LENGTHS = frozenset(LENGTHS.tolist())
_LONGEST_XL = 2048
_TOP = {False: 0x7FF, True: 0x1FFF_FFFF}  # the highest identifier, standard or extended


class BusSetting(IntEnum):
    """What a node configures of its bus."""

    BITRATE = 1
    DATA_BITRATE = 2
    XL_BITRATE = 3
    ARBITRATION_LOST = 4


class WhenLost(IntEnum):
    """What becomes of a frame that loses arbitration: it waits in the bus, or it is given back."""

    BUFFER_AND_RETRANSMIT = 1
    DISCARD_AND_NOTIFY = 2


class NodeState(IntEnum):
    """State of a node by its error counters."""

    ERROR_ACTIVE = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3


class Transmit(NamedTuple):
    """A classic frame; `length` is that of the data, or what a remote frame asks for."""

    id: int
    extended: bool
    remote: bool
    length: int
    data: bytes


class TransmitFd(NamedTuple):
    """A CAN FD frame; `switched` to the data bit rate or not."""

    id: int
    extended: bool
    switched: bool
    error_state: bool
    data: bytes


class TransmitXl(NamedTuple):
    """A CAN XL frame."""

    id: int
    extended: bool
    simple_extended: bool
    sdu_type: int
    network: int
    acceptance: int
    data: bytes


class FormatError(NamedTuple):
    """That an operation could not be understood; `data` is that operation."""

    data: bytes


class Confirm(NamedTuple):
    """That somebody has received the sender's frame."""

    id: int


class ArbitrationLost(NamedTuple):
    """That the sender's frame lost arbitration and was given back."""

    id: int


class BusFault(NamedTuple):
    """That a frame was destroyed, `Bus Error` in the standard; `flag` is 1 for who saw it first, else 2."""

    id: int
    code: int
    flag: int
    is_sender: bool


class Configuration(NamedTuple):
    """What a node wants of its bus: a bit rate [bit/s], or a `WhenLost`."""

    setting: BusSetting
    value: int


class Status(NamedTuple):
    """What state a node is in."""

    state: NodeState


class Wakeup(NamedTuple):
    """That a node wakes the others."""


class Malformed(NamedTuple):
    """What is no operation, and why."""

    data: bytes
    why: str


Operation = (
    Transmit
    | TransmitFd
    | TransmitXl
    | FormatError
    | Confirm
    | ArbitrationLost
    | BusFault
    | Configuration
    | Status
    | Wakeup
)


@dataclass(frozen=True)
class _Layout:
    """Where the fields of an operation lie; those with data end with its length and the data."""

    kind: Any
    code: int
    fields: Struct
    has_data: bool


_LAYOUTS = [
    _Layout(FormatError, 0x01, Struct("<IIH"), True),
    _Layout(Transmit, 0x10, Struct("<IIIBBH"), True),
    _Layout(TransmitFd, 0x11, Struct("<IIIBBBH"), True),
    _Layout(TransmitXl, 0x12, Struct("<IIIBBBBIH"), True),
    _Layout(Confirm, 0x20, Struct("<III"), False),
    _Layout(ArbitrationLost, 0x30, Struct("<III"), False),
    _Layout(BusFault, 0x31, Struct("<IIIBBB"), False),
    _Layout(Configuration, 0x40, Struct("<IIBI"), False),
    _Layout(Status, 0x41, Struct("<IIB"), False),
    _Layout(Wakeup, 0x42, _HEADER, False),
]
_BY_KIND = {layout.kind: layout for layout in _LAYOUTS}
_BY_CODE = {layout.code: layout for layout in _LAYOUTS}
_CODE_OF_FRAME, _FRAME = 0x10, _BY_KIND[Transmit].fields
_SHORT_CONFIGURATION = Struct("<IIBB")
_BOOLEAN = {  # fields that are 0 or 1
    Transmit: ("extended", "remote"),
    TransmitFd: ("extended", "switched", "error_state"),
    TransmitXl: ("extended", "simple_extended"),
    BusFault: ("is_sender",),
}


def encoded(operations: Iterable[Operation]) -> bytes:
    """The operations one after the other."""
    return b"".join(map(_encoded, operations))


def decoded(data: bytes) -> list[Operation | Malformed]:
    """What lies in a binary variable; after an operation whose length is wrong nothing more can be made out."""
    return [operation for operation, _ in taken_apart(data)]


def taken_apart(data: bytes) -> list[tuple[Operation | Malformed, bytes]]:
    """What lies in a binary variable, each with its bytes."""
    found: list[tuple[Operation | Malformed, bytes]] = []
    place, end = 0, len(data)
    while place < end:
        if end - place < _HEADER.size:
            rest = data[place:]
            found.append((Malformed(rest, f"ends after {end - place} of {_HEADER.size} bytes of its head"), rest))
            break
        code, length = _HEADER.unpack_from(data, place)
        if not _HEADER.size <= length <= end - place:
            problem = f"says that it has {length} bytes where there are {end - place}"
            found.append((Malformed(data[place:], problem), data[place:]))
            break
        own = data[place : place + length]
        frame = _plain(own) if code == _CODE_OF_FRAME else None
        found.append((frame or _decoded(code, own), own))
        place += length
    return found


def _plain(data: bytes) -> Transmit | None:
    """The classic data frame that this is, None where it is something else; by far the most are."""
    head = _FRAME.size
    if len(data) < head:
        return None
    _, _, identifier, extended, remote, length = _FRAME.unpack_from(data)
    if extended > 1 or remote or length > CLASSIC or length != len(data) - head or identifier > _TOP[extended == 1]:
        return None
    return Transmit(identifier, extended == 1, False, length, data[head:])


def _encoded(operation: Operation) -> bytes:
    layout, fields = _BY_KIND[type(operation)], tuple[Any, ...](operation)
    if layout.has_data:
        *plain, data = fields
        plain += [] if isinstance(operation, Transmit) else [len(data)]
        return layout.fields.pack(layout.code, layout.fields.size + len(data), *plain) + bytes(data)
    if isinstance(operation, Configuration) and operation.setting is BusSetting.ARBITRATION_LOST:
        return _SHORT_CONFIGURATION.pack(layout.code, _SHORT_CONFIGURATION.size, *operation)
    return layout.fields.pack(layout.code, layout.fields.size, *operation)


def _decoded(code: int, data: bytes) -> Operation | Malformed:
    """The operation that all of the data is."""
    layout = _BY_CODE.get(code)
    if layout is None:
        return Malformed(data, f"has the code 0x{code:X}, which no operation for CAN has")
    fields = layout.fields
    if layout.kind is Configuration and len(data) == _SHORT_CONFIGURATION.size:
        fields = _SHORT_CONFIGURATION
    if len(data) < fields.size or (len(data) > fields.size and not layout.has_data):
        return Malformed(data, f"has {len(data)} bytes where a {layout.kind.__name__} has {fields.size}")
    _, _, *values = fields.unpack_from(data)
    if layout.has_data:
        content = data[fields.size :]
        length = values[-1] if layout.kind is Transmit else values.pop()
        if length != len(content) and not (layout.kind is Transmit and values[2] and not content):
            return Malformed(data, f"says that it has {length} data bytes and has {len(content)}")
        values.append(content)
    for name in _BOOLEAN.get(layout.kind, ()):
        place = layout.kind._fields.index(name)
        if values[place] > 1:
            return Malformed(data, f"has {name} = {values[place]}, which is neither 0 nor 1")
        values[place] = bool(values[place])
    try:
        problem = _misfit(made := _made(layout.kind, values))
    except ValueError as error:
        return Malformed(data, str(error))
    return Malformed(data, problem) if problem else made


def _made(kind: type[Any], values: list[Any]) -> Any:
    """The operation with these fields.

    Raises:
        ValueError: a setting or state that there is not.
    """
    if kind is Configuration:
        setting, value = BusSetting(values[0]), values[1]
        return kind(setting, WhenLost(value) if setting is BusSetting.ARBITRATION_LOST else value)
    return kind(NodeState(values[0])) if kind is Status else kind(*values)


def _misfit(operation: Operation) -> str:
    """Why there is no such frame, nothing where there is."""
    if not isinstance(operation, Transmit | TransmitFd | TransmitXl):
        return ""
    if operation.id > _TOP[operation.extended]:
        return f"has the identifier 0x{operation.id:X}, beyond 0x{_TOP[operation.extended]:X}"
    size = operation.length if isinstance(operation, Transmit) else len(operation.data)
    if isinstance(operation, Transmit):
        fits = size <= CLASSIC
    elif isinstance(operation, TransmitFd):
        fits = size in _FD_LENGTHS
    else:
        fits = 1 <= size <= _LONGEST_XL
    return "" if fits else f"has {size} data bytes, which no such frame has"
