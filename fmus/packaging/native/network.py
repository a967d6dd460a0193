"""What a network FMU exchanges over a CAN bus, in plain values."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SelectedBy:
    """That a signal is in the frames only in which another has one of some values.

    Attributes:
        selector: where the other lies; it is there itself where its own `presence` says so.
        values: raw numbers.
    """

    selector: FrameSignal
    values: tuple[int, ...]


@dataclass(frozen=True)
class FrameSignal:
    """Where a variable of the model lies in a frame: variable = gain * raw + bias.

    Attributes:
        variable: "" of what has the same raw number, `low`, in every frame that it is in.
        lowest: position of the lowest bit: counted from the first byte's lowest bit upwards, or, `big_endian`, from
            the first byte's highest bit downwards.
        length: bits.
        low, high: smallest and largest raw number that is sent.
        presence: in which frames it is; None for all.
    """

    variable: str
    lowest: int
    length: int
    big_endian: bool
    signed: bool
    is_float: bool
    gain: float
    bias: float
    low: float
    high: float
    presence: SelectedBy | None = None


@dataclass(frozen=True)
class Checksum:
    """A CRC of 8 bits over all others of the first bytes: the byte that it fills, and what it is computed with.

    Attributes:
        length: how many bytes.
    """

    byte: int
    length: int
    polynomial: int
    start: int
    mask: int
    data_id: int | None


@dataclass(frozen=True)
class Frame:
    """A frame that the FMU sends or receives.

    Attributes:
        length: data bytes.
        period: between two that are sent [ns]; 0 of those that are received.
        signals: of a frame that is sent, what others go by comes before those.
        pages: its data where nothing is set, in turn; none of those that are received.
        mask: the bits of an identifier by which frames are received.
        counter: where the counter of frames lies, and how many values it has.
    """

    name: str
    id: int
    extended: bool
    fd: bool
    length: int
    period: int
    signals: tuple[FrameSignal, ...]
    pages: tuple[bytes, ...] = ()
    mask: int = 0x1FFFFFFF
    counter: tuple[FrameSignal, int] | None = None
    checksum: Checksum | None = None

    @property
    def sent(self) -> bool:
        """Whether the FMU sends it."""
        return self.period > 0


@dataclass(frozen=True)
class Network:
    """A bus of an FMU.

    Attributes:
        name: of its terminal.
        database: the file that describes its frames.
    """

    name: str
    frames: tuple[Frame, ...]
    database: bytes

    @property
    def received(self) -> frozenset[str]:
        """The variables that frames set."""
        return frozenset(signal.variable for frame in self.frames if not frame.sent for signal in frame.signals)
