"""Messages of a CAN database and the signals that lie in their bytes."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from fmus.errors import DatabaseError
from orchestrator.can.database.addressing import ANY, CANOPEN, Addressing
from orchestrator.can.database.protection import Protection


@dataclass(frozen=True)
class LeftOut:
    """What is in a file but not used: a message, or of a message that is used (not `whole`) these signals; and why."""

    message: str
    why: str
    signals: tuple[str, ...] = ()
    whole: bool = True

    def __str__(self) -> str:
        names = f"message {self.message}" if self.whole else f"signal {self.message}.{self.signals[0]}"
        return f"{names} is left out: {self.why}"


@dataclass(frozen=True)
class SignalSpec:
    """A signal of a message.

    Attributes:
        unit: as the database spells it; "" when it is not known.
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

    @property
    def layout(self) -> tuple[object, ...]:
        """What decoding goes by, but for the values of the multiplexer."""
        place = (self.name, self.lowest, self.length, self.big_endian, self.is_signed, self.is_float, self.multiplexer)
        return (*place, self.scale, self.offset, self.unit)


@dataclass(frozen=True, eq=False)
class MessageSpec:
    """A message.

    Attributes:
        length: bytes.
        cycle: period [s], None where it is not known.
        signals: those that are numbers of at most 64 bits, and sound; `left_out` says of the others why not.
        raw: cantools' message.
        protection: its counter and checksum, None without either.
        addressing: which part of its identifier says who sends it; None where all of it is the message's.
        notes: what else is not as the file says.
    """

    name: str
    id: int
    extended: bool
    fd: bool
    length: int
    cycle: float | None
    signals: tuple[SignalSpec, ...]
    left_out: Mapping[str, str]
    raw: Any
    protection: Protection | None = None
    addressing: Addressing | None = None
    notes: tuple[str, ...] = ()

    @property
    def of_any_sender(self) -> bool:
        """Whether its identifier lacks the address of a sender, so that no frame has it as it is."""
        addressing = self.addressing
        return addressing is not None and (addressing == CANOPEN or self.id & addressing.sender == ANY)

    def is_like(self, other: MessageSpec) -> bool:
        """Whether the other is decoded in the same way, under the same names."""

        def layouts(message: MessageSpec) -> list[tuple[object, ...]]:
            return [(*signal.layout, signal.selected_by) for signal in message.signals]

        return (self.name, self.length) == (other.name, other.length) and layouts(self) == layouts(other)

    def signal(self, name: str) -> SignalSpec:
        """The signal of that name."""
        found = next((signal for signal in self.signals if signal.name == name), None)
        if found is None and name in self.left_out:
            raise DatabaseError(f"message {self.name}", f"'{name}' is left out: {self.left_out[name]}", "correct it")
        if found is None:
            known = [signal.name for signal in self.signals]
            raise DatabaseError(f"message {self.name}", f"has no signal '{name}'", instead(name, known))
        return found


def checksum_byte(signal: SignalSpec) -> int | None:
    """The byte that the signal fills, None when it is not one whole byte."""
    aligned = signal.lowest % 8 == (7 if signal.big_endian else 0)
    return signal.lowest // 8 if aligned and signal.length == 8 else None


def instead(name: str, known: Iterable[str]) -> str:
    """What to write for a name that is not known: close ones, or what there is."""
    names = list(known)
    near = difflib.get_close_matches(name, names, n=3, cutoff=0.5)
    if near:
        return f"did you mean {' or '.join(repr(known) for known in near)}?"
    return f"it has {', '.join(names[:10])}" + (", ..." if len(names) > 10 else "")
