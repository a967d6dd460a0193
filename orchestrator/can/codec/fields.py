"""How the signals of a database lie in frames, and what raw numbers they may have."""

from __future__ import annotations

import numpy as np
from cantools.database.errors import Error as CantoolsError

from fmus.errors import DatabaseError
from orchestrator.can.codec.bits import BitField
from orchestrator.can.database.message import MessageSpec, SignalSpec
from orchestrator.can.frames import LONGEST

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)


def field_of(signal: SignalSpec) -> BitField:
    """Where the signal lies and what its bits stand for."""
    return BitField(
        signal.lowest,
        signal.length,
        signal.big_endian,
        signal.is_signed,
        signal.is_float,
        signal.scale,
        signal.offset,
    )


def longest(spec: MessageSpec) -> int:
    """Data bytes a frame of the message has at most: CAN FD fills up to the next length it knows."""
    return next((size for size in FD_LENGTHS if size >= spec.length), spec.length) if spec.fd else spec.length


def check_sendable(spec: MessageSpec) -> None:
    """See that the message can be sent: as one frame, with every signal in bits of its own.

    Raises:
        DatabaseError: it cannot.
    """
    if spec.length > LONGEST:
        raise DatabaseError(f"message {spec.name}", f"has {spec.length} bytes, more than a frame", "split it")
    for signal in spec.signals:
        if signal.scale == 0:
            raise DatabaseError(f"{spec.name}.{signal.name}", "cannot be sent: its scale is 0", "correct the scale")
    try:
        spec.raw.refresh(strict=True)
    except CantoolsError as error:
        raise DatabaseError(f"message {spec.name}", f"cannot be sent: {str(error).rstrip('.')}", "correct it") from None


def raw_limits(signal: SignalSpec) -> tuple[float, float]:
    """Smallest and largest raw number: what the bits hold, within the signal's range where that leaves any."""
    low, high = least, most = field_of(signal).limits()
    ends = [
        open_end if end is None else (end - signal.offset) / signal.scale
        for end, open_end in ((signal.minimum, -np.inf), (signal.maximum, np.inf))
    ]
    if signal.scale < 0:
        ends = [-np.inf if signal.maximum is None else ends[1], np.inf if signal.minimum is None else ends[0]]
    if not signal.is_float:
        ends = [np.ceil(ends[0] - 1e-6), np.floor(ends[1] + 1e-6)]
    low, high = max(low, float(ends[0])), min(high, float(ends[1]))
    return (low, high) if low <= high else (least, most)


def outside(signal: SignalSpec, value: float) -> str:
    """Where a value can be that is sent in the signal, in words; "" where this one is there."""
    low, high = raw_limits(signal)
    raw, slack = (value - signal.offset) / signal.scale, 1e-6 if signal.is_float else 0.5
    ends = sorted(float(end * signal.scale + signal.offset) for end in (low, high))
    return "" if low - slack <= raw <= high + slack else f"{signal.name} has [{ends[0]:g}, {ends[1]:g}]"


def resting(signal: SignalSpec) -> float:
    """The value of a signal that nobody sets: its initial one, else the nearest to zero that it may have."""
    if signal.initial is not None:
        return signal.initial
    return float(min(max(0.0, signal.minimum or 0.0), np.inf if signal.maximum is None else signal.maximum))


def unfit(signal: SignalSpec) -> str:
    """Why its initial value is not what is sent while nobody sets the signal; "" where it is."""
    return "" if signal.initial is None else outside(signal, signal.initial)
