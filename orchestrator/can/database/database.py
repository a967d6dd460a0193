"""A CAN database: which messages there are, and what signals lie in their bytes.

Any file that cantools reads. J1939's masked identifiers and AUTOSAR's container messages are not taken apart: frames
are looked up by their whole identifier, and a container has no signals of its own.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from fmus.errors import DatabaseError
from orchestrator.can.database import reading
from orchestrator.can.database.protection import ALGORITHMS, Protection

# Message attributes of a DBC that name what protects the message.
COUNTER, CHECKSUM, ALGORITHM, DATA_ID = "CounterSignal", "ChecksumSignal", "ChecksumAlgorithm", "ChecksumDataId"

_COUNTER_NAME = re.compile(r"(^|.*_)(alive|rolling|msg|message|sequence)_?(counter|count|cnt|ctr)$", re.IGNORECASE)
_LARGEST = 1e200  # of scales, offsets and ranges: what is scaled stays finite
_FLOAT_LENGTHS = (16, 32, 64)
_SPELLINGS = {"Nm": "N.m", "°": "deg", "°/s": "deg/s", "ohm": "Ohm", "1/min": "rpm", "U/min": "rpm"}


@dataclass(frozen=True)
class SignalSpec:
    """A signal of a message.

    Attributes:
        unit: spelt as in `fmus.units` where the database's spelling is a common one; "" when it is not known.
        minimum, maximum: range of the value [unit], None where it is open; an empty range counts as open.
        scale, offset: value = scale * raw + offset; whole numbers stay int, which cantools computes exactly.
        length: bits.
        lowest: position of the lowest bit: counted from the first byte's lowest bit upwards, or, `big_endian`, from
            the first byte's highest bit downwards.
        choices: names of raw values; None where there is no table.
        initial: value before anything else is known [unit].
        is_multiplexer: whether its value says which other signals the frame holds.
        multiplexer: the signal that says whether this one is there, and `selected_by` its values; "" when it always is.
    """

    name: str
    unit: str
    minimum: float | None
    maximum: float | None
    scale: float
    offset: float
    is_float: bool
    is_signed: bool
    length: int
    lowest: int
    big_endian: bool
    choices: Mapping[int, str] | None
    initial: float | None
    is_multiplexer: bool
    multiplexer: str
    selected_by: tuple[int, ...]
    comment: str


@dataclass(frozen=True, eq=False)
class MessageSpec:
    """A message.

    Attributes:
        length: bytes.
        cycle: period [s], None where it is not known.
        signals: those that are numbers of at most 64 bits; `left_out` names the others.
        raw: cantools' message.
        protection: its counter and checksum, None without either.
    """

    name: str
    id: int
    extended: bool
    fd: bool
    length: int
    cycle: float | None
    signals: tuple[SignalSpec, ...]
    left_out: tuple[str, ...]
    raw: Any
    protection: Protection | None = None

    def signal(self, name: str) -> SignalSpec:
        """The signal of that name."""
        found = next((signal for signal in self.signals if signal.name == name), None)
        if found is None:
            known = [signal.name for signal in self.signals]
            raise DatabaseError(f"message {self.name}", f"has no signal '{name}'", _instead(name, known))
        return found


class Database:
    """Messages by name and identifier, signals by name.

    Raises:
        DatabaseError: two messages have one name or one identifier, or a message has a signal twice.
    """

    def __init__(self, path: Path, messages: Iterable[MessageSpec]) -> None:
        self.path = path
        self.messages = tuple(messages)
        self._by_name: dict[str, MessageSpec] = {}
        self._by_id: dict[tuple[int, bool], MessageSpec] = {}
        self._owners: dict[str, list[MessageSpec]] = {}
        for message in self.messages:
            self._add(message)

    def message(self, name: str) -> MessageSpec:
        """The message of that name.

        Raises:
            DatabaseError: there is none; close names are listed.
        """
        if name not in self._by_name:
            raise DatabaseError(self.path, f"has no message '{name}'", _instead(name, self._by_name))
        return self._by_name[name]

    def signal(self, name: str) -> tuple[MessageSpec, SignalSpec]:
        """A signal by its own name where that is unique, or as Message.signal.

        Raises:
            DatabaseError: there is none, or the name alone is that of signals in several messages.
        """
        owner, dot, own = name.rpartition(".")
        if dot and owner in self._by_name:
            return self._by_name[owner], _own(self.path, self._by_name[owner], own)
        owners = self._owners.get(name, [])
        if len(owners) > 1:
            full = " or ".join(f"'{owner.name}.{name}'" for owner in owners[:5])
            raise DatabaseError(self.path, f"signal '{name}' is in {len(owners)} messages", f"write {full}")
        if not owners:
            known = [*self._owners, *(f"{m.name}.{s.name}" for m in self.messages for s in m.signals)]
            raise DatabaseError(self.path, f"has no signal '{name}'", _instead(name, known))
        return owners[0], owners[0].signal(name)

    def public_name(self, message: MessageSpec, signal: SignalSpec) -> str:
        """The signal's own name where no other message has it, else Message.signal."""
        return signal.name if len(self._owners[signal.name]) == 1 else f"{message.name}.{signal.name}"

    def protected(self, protections: Mapping[str, Protection]) -> Database:
        """The same database where these messages (by name) have these counters and checksums.

        Raises:
            DatabaseError: a message lacks the signal, or it cannot serve.
        """
        known = {name: _checked(self.path, self.message(name), protection) for name, protection in protections.items()}
        changed = (
            replace(message, protection=known.get(message.name, message.protection)) for message in self.messages
        )
        return Database(self.path, changed)

    def _add(self, message: MessageSpec) -> None:
        identity = (message.id, message.extended)
        if message.name in self._by_name:
            raise DatabaseError(self.path, f"has two messages '{message.name}'", "rename or remove one")
        if identity in self._by_id:
            others = f"'{self._by_id[identity].name}' and '{message.name}'"
            raise DatabaseError(self.path, f"messages {others} have the same identifier 0x{message.id:X}", "remove one")
        self._by_name[message.name] = self._by_id[identity] = message
        for signal in message.signals:
            owners = self._owners.setdefault(signal.name, [])
            if owners and owners[-1] is message:
                raise DatabaseError(f"{self.path}: {message.name}.{signal.name}", "is there twice", "rename one")
            owners.append(message)


def load(path: Path, *, encoding: str | None = None) -> Database:
    """The database of a .dbc, .arxml, .kcd or .sym file; UTF-8 or Windows' Western text unless `encoding` is given.

    Raises:
        DatabaseError: it cannot be read, or contradicts itself; file and line are named.
    """
    path = Path(path)
    raw = reading.read(path, encoding)
    if not getattr(raw, "messages", None):
        raise DatabaseError(path, "defines no messages", "export it again")
    return Database(path, [_message(path, message) for message in raw.messages])


def _message(path: Path, raw: Any) -> MessageSpec:
    usable = {signal.name for signal in raw.signals if _is_number(signal)}
    message = MessageSpec(
        name=raw.name,
        id=raw.frame_id,
        extended=raw.is_extended_frame,
        fd=bool(raw.is_fd or raw.length > 8),
        length=raw.length,
        cycle=_seconds(raw.cycle_time),
        signals=tuple(_signal(path, raw.name, signal) for signal in raw.signals if signal.name in usable),
        left_out=tuple(signal.name for signal in raw.signals if signal.name not in usable),
        raw=raw,
    )
    protection = _declared(path, message) or _by_convention(message)
    return message if protection is None else replace(message, protection=_checked(path, message, protection))


def _is_number(raw: Any) -> bool:
    return raw.length in _FLOAT_LENGTHS if raw.is_float else raw.length <= 64


def _seconds(cycle: float | None) -> float | None:
    """A cycle time [ms] as a period [s]."""
    return cycle / 1000 if cycle and math.isfinite(cycle) and cycle > 0 else None


def _signal(path: Path, message: str, raw: Any) -> SignalSpec:
    if not (abs(raw.scale) < _LARGEST and abs(raw.offset) < _LARGEST):
        raise DatabaseError(f"{path}: {message}.{raw.name}", "its scale or offset is not finite", "correct it")
    big = raw.byte_order == "big_endian"
    first = 8 * (raw.start // 8) + 7 - raw.start % 8
    unit = (raw.unit or "").strip()
    minimum, maximum = _finite(raw.minimum), _finite(raw.maximum)
    if minimum is not None and maximum is not None and minimum >= maximum:
        minimum = maximum = None
    return SignalSpec(
        name=raw.name,
        unit=_SPELLINGS.get(unit, unit),
        minimum=minimum,
        maximum=maximum,
        scale=raw.scale,
        offset=raw.offset,
        is_float=bool(raw.is_float),
        is_signed=bool(raw.is_signed),
        length=raw.length,
        lowest=first + raw.length - 1 if big else raw.start,
        big_endian=big,
        choices={int(key): str(value) for key, value in raw.choices.items()} if raw.choices else None,
        initial=_initial(raw),
        is_multiplexer=bool(raw.is_multiplexer),
        multiplexer=raw.multiplexer_signal or "",
        selected_by=tuple(raw.multiplexer_ids or ()),
        comment=raw.comment or "",
    )


def _initial(raw: Any) -> float | None:
    if raw.raw_initial is None:
        return None
    return _finite(raw.conversion.raw_to_scaled(raw.raw_initial, decode_choices=False))


def _finite(value: Any) -> float | None:
    return float(value) if isinstance(value, int | float) and abs(value) < _LARGEST else None


def _declared(path: Path, message: MessageSpec) -> Protection | None:
    """The protection that the message's attributes declare."""
    attributes = message.raw.dbc.attributes if message.raw.dbc else {}
    given = {name: attributes[name].value for name in (COUNTER, CHECKSUM, ALGORITHM, DATA_ID) if name in attributes}
    counter, checksum = str(given.get(COUNTER, "")), str(given.get(CHECKSUM, ""))
    if not counter and not checksum:
        return None
    algorithm, data_id = str(given.get(ALGORITHM, "CRC8_SAE_J1850")), given.get(DATA_ID)
    return Protection(counter, 0, checksum, algorithm, None if data_id is None else int(data_id))


def _by_convention(message: MessageSpec) -> Protection | None:
    """A counter that goes by one of the usual names, such as MessageCounter or alive_cnt."""
    for signal in message.signals:
        if _COUNTER_NAME.match(signal.name) and _can_count(signal) and not signal.unit:
            return Protection(signal.name)
    return None


def _can_count(signal: SignalSpec) -> bool:
    plain = (signal.scale, signal.offset, signal.is_float, signal.is_signed) == (1, 0, False, False)
    return plain and signal.length <= 32 and not signal.multiplexer


def _modulus(signal: SignalSpec) -> int:
    """Number of values of a counter: up to its maximum where one is declared, else all its bits hold."""
    whole = 1 << signal.length
    return int(signal.maximum) + 1 if signal.maximum and 1 <= signal.maximum < whole else whole


def _checked(path: Path, message: MessageSpec, protection: Protection) -> Protection:
    """The protection with its modulus, once its signals are seen to serve."""
    place = f"{path}: message {message.name}"
    if protection.checksum:
        _check_checksum(place, _own(path, message, protection.checksum), protection)
    if not protection.counter:
        return protection
    counter = _own(path, message, protection.counter)
    if not _can_count(counter):
        raise DatabaseError(place, f"'{counter.name}' is no plain unsigned counter", "use one without scale")
    if protection.modulus and not 2 <= protection.modulus <= 1 << counter.length:
        raise DatabaseError(place, f"the counter cannot have {protection.modulus} values", "correct its modulus")
    return replace(protection, modulus=protection.modulus or _modulus(counter))


def _check_checksum(place: str, signal: SignalSpec, protection: Protection) -> None:
    if not _can_count(signal) or checksum_byte(signal) is None:
        raise DatabaseError(place, f"'{signal.name}' is no checksum of one whole byte", "use 8 bits, unsigned")
    if protection.algorithm not in ALGORITHMS:
        raise DatabaseError(place, f"there is no checksum '{protection.algorithm}'", f"use {', '.join(ALGORITHMS)}")
    if protection.data_id is not None and not 0 <= protection.data_id < 1 << 16:
        raise DatabaseError(place, f"data identifier {protection.data_id} has not 16 bits", "use 0 to 65535")


def checksum_byte(signal: SignalSpec) -> int | None:
    """The byte that the signal fills, None when it is not one whole byte."""
    aligned = signal.lowest % 8 == (7 if signal.big_endian else 0)
    return signal.lowest // 8 if aligned and signal.length == 8 else None


def _own(path: Path, message: MessageSpec, name: str) -> SignalSpec:
    """The message's signal; without it the error names the file too."""
    try:
        return message.signal(name)
    except DatabaseError as error:
        raise DatabaseError(f"{path}: {error.place}", error.problem, error.fix) from None


def _instead(name: str, known: Iterable[str]) -> str:
    names = list(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(repr(known) for known in near)}?"
    return f"it has {', '.join(names[:10])}" + (", ..." if len(names) > 10 else "")
