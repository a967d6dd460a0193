"""Messages as cantools has them into those that are decoded: numbers of at most 64 bits, with what protects them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from cantools.database.can import Message

from fmus.errors import DatabaseError
from orchestrator.can.database.addressing import Addressing
from orchestrator.can.database.message import MessageSpec, SignalSpec, checksum_byte
from orchestrator.can.database.protection import ALGORITHMS, Protection

# Message attributes of a DBC that name what protects the message.
COUNTER, CHECKSUM, ALGORITHM, DATA_ID = "CounterSignal", "ChecksumSignal", "ChecksumAlgorithm", "ChecksumDataId"

_COUNTER_NAME = re.compile(r"(^|.*_)(alive|rolling|msg|message|sequence)_?(counter|count|cnt|ctr)$", re.IGNORECASE)
_LARGEST = 1e200  # of scales, offsets and ranges: what is scaled stays finite
_FLOAT_LENGTHS = (16, 32, 64)


def specification(raw: Any, addressing: Addressing | None = None) -> MessageSpec:
    """The message as it is decoded, without those of its signals that cannot be.

    Raises:
        ValueError: something has no name; or what else comes of values that are none.
    """
    if not all(isinstance(name, str) and name for name in (raw.name, *(signal.name for signal in raw.signals))):
        raise ValueError("a name is missing")
    left_out = {signal.name: why for signal in raw.signals if (why := _unusable(signal, raw.length))}
    signals = _distinct((_signal(signal) for signal in raw.signals if signal.name not in left_out), left_out)
    while lost := [s for s in signals if s.multiplexer in left_out]:
        left_out |= {signal.name: f"its multiplexer {signal.multiplexer} is left out" for signal in lost}
        signals = [signal for signal in signals if signal not in lost]
    message = MessageSpec(
        name=raw.name,
        id=raw.frame_id,
        extended=raw.is_extended_frame,
        fd=bool(raw.is_fd or (raw.length > 8 and not addressing)),
        length=raw.length,
        cycle=_seconds(raw.cycle_time),
        signals=tuple(signals),
        left_out=left_out,
        raw=_without(raw, left_out),
        addressing=addressing,
    )
    try:
        protection = _declared(message) or _by_convention(message)
        return message if protection is None else protected("", message, protection)
    except DatabaseError as error:
        return replace(message, notes=(f"its counter and checksum are not checked, {error.problem}",))


def protected(path: Path | str, message: MessageSpec, protection: Protection) -> MessageSpec:
    """The message with this counter and checksum.

    Raises:
        DatabaseError: it lacks the signal, or it cannot serve.
    """
    return replace(message, protection=_checked(path, message, protection))


def _unusable(raw: Any, length: int) -> str:
    """Why a signal cannot be decoded; "" where it can."""
    if raw.length > 64 or (raw.is_float and raw.length not in _FLOAT_LENGTHS):
        return f"it has {raw.length} bits" + (" and is a float" if raw.is_float else "")
    if not (abs(raw.scale) < _LARGEST and abs(raw.offset) < _LARGEST):
        return "its scale or offset is not finite"
    if raw.scale == 0 and not raw.is_multiplexer:
        return f"its factor is 0, whatever it holds would be {raw.offset:g}"
    lowest = _lowest(raw)
    first, last = (
        (lowest - raw.length + 1, lowest) if raw.byte_order == "big_endian" else (lowest, lowest + raw.length - 1)
    )
    if raw.length < 1 or first < 0 or last >= 8 * length:
        return f"it does not lie in the {length} bytes of its message"
    return ""


def _distinct(signals: Iterable[SignalSpec], left_out: dict[str, str]) -> list[SignalSpec]:
    """The signals, where those of one name are one if they are alike but for what selects them, else left out."""
    found: dict[str, SignalSpec] = {}
    for signal in signals:
        known = found.setdefault(signal.name, signal)
        if known is signal:
            continue
        if known.multiplexer and signal.layout == known.layout:
            found[signal.name] = replace(known, selected_by=known.selected_by + signal.selected_by)
        else:
            left_out[signal.name] = "it is there twice, and not the same"
    return [signal for name, signal in found.items() if name not in left_out]


def _without(raw: Any, left_out: Mapping[str, str]) -> Any:
    """cantools' message with the signals that are decoded only."""
    if not left_out:
        return raw
    kept = [
        signal for signal in raw.signals if signal.name not in left_out and signal.multiplexer_signal not in left_out
    ]
    return Message(
        raw.frame_id,
        raw.name,
        raw.length,
        kept,
        is_extended_frame=raw.is_extended_frame,
        is_fd=raw.is_fd,
        strict=False,
        dbc_specifics=raw.dbc,
    )


def _seconds(cycle: object) -> float | None:
    """A cycle time [ms] as a period [s]; None for what is none."""
    return cycle / 1000 if isinstance(cycle, int | float) and math.isfinite(cycle) and cycle > 0 else None


def _lowest(raw: Any) -> int:
    """Where its lowest bit is; see `SignalSpec.lowest`."""
    if raw.byte_order != "big_endian":
        return int(raw.start)
    return int(8 * (raw.start // 8) + 7 - raw.start % 8 + raw.length - 1)


def _signal(raw: Any) -> SignalSpec:
    unit = (raw.unit or "").strip()
    minimum, maximum = _finite(raw.minimum), _finite(raw.maximum)
    if minimum is not None and maximum is not None and minimum >= maximum:
        minimum = maximum = None
    return SignalSpec(
        name=raw.name,
        unit=unit,
        minimum=minimum,
        maximum=maximum,
        scale=raw.scale,
        offset=raw.offset,
        is_float=bool(raw.is_float),
        is_signed=bool(raw.is_signed),
        length=raw.length,
        lowest=_lowest(raw),
        big_endian=raw.byte_order == "big_endian",
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


def _declared(message: MessageSpec) -> Protection | None:
    """The protection that the message's attributes declare."""
    attributes = message.raw.dbc.attributes if message.raw.dbc else {}
    given = {name: attributes[name].value for name in (COUNTER, CHECKSUM, ALGORITHM, DATA_ID) if name in attributes}
    counter, checksum = str(given.get(COUNTER, "")), str(given.get(CHECKSUM, ""))
    if not counter and not checksum:
        return None
    algorithm, data_id = str(given.get(ALGORITHM, "CRC8_SAE_J1850")), given.get(DATA_ID)
    if not isinstance(data_id, int | None):
        raise DatabaseError(
            f"message {message.name}", f"the {DATA_ID} '{data_id}' is no whole number", "declare an INT"
        )
    return Protection(counter or _counter_by_name(message), 0, checksum, algorithm, data_id)


def _by_convention(message: MessageSpec) -> Protection | None:
    counter = _counter_by_name(message)
    return Protection(counter) if counter else None


def _counter_by_name(message: MessageSpec) -> str:
    """A counter that goes by one of the usual names, such as MessageCounter or alive_cnt; "" without one."""
    usual = (s for s in message.signals if _COUNTER_NAME.match(s.name) and _can_count(s) and not s.unit)
    return next((signal.name for signal in usual), "")


def _can_count(signal: SignalSpec) -> bool:
    plain = (signal.scale, signal.offset, signal.is_float, signal.is_signed) == (1, 0, False, False)
    return plain and signal.length <= 32 and not signal.multiplexer


def _modulus(signal: SignalSpec) -> int:
    """Number of values of a counter: up to its maximum where one is declared, else all its bits hold."""
    whole = 1 << signal.length
    return int(signal.maximum) + 1 if signal.maximum and 1 <= signal.maximum < whole else whole


def _checked(path: Path | str, message: MessageSpec, protection: Protection) -> Protection:
    """The protection with its modulus, once its signals are seen to serve."""
    place = f"{path}: message {message.name}"
    if protection.checksum:
        _check_checksum(place, message.signal(protection.checksum), protection)
    if not protection.counter:
        return protection
    counter = message.signal(protection.counter)
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
