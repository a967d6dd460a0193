"""A CAN bus by the name of its interface, whichever of python-can's that is; what goes wrong with it is a `BusError`.

`send` and `is_bus_off` are for everything that talks to an open bus.
"""

from __future__ import annotations

import contextlib
import difflib
import errno
import re
import time
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypedDict

import can
from can.util import cast_from_string

from fmus.errors import BusError, InputError
from fmus.words import complaint
from orchestrator.can import frame_time
from orchestrator.can.slcan import protocol
from orchestrator.can.slcan.bus import ERROR_BUS_OFF, PortInUse, SlcanBus

__all__ = ["BusSettings", "OnBuses", "is_bus_off", "occupied", "open_bus", "opened", "parse_option", "send"]

_TIMED = ("pcan", "slcan")  # interfaces that want the timing of bits for CAN FD instead of bit rates
_CLOCK = 80_000_000  # of CAN FD controllers [Hz]
_SAMPLE_POINT = 80.0  # [%]


@dataclass(frozen=True)
class BusSettings:
    """Which bus, through which adapter.

    Attributes:
        interface: python-can's name of the interface.
        channel: what the interface calls the bus: can0, PCAN_USBBUS1, 0, a serial port, ...
        bitrate: None: as the adapter is set [bit/s].
        data_bitrate: of CAN FD frames that switch [bit/s].
        options: of that interface only.
        reopens: whether it is opened again when it is lost.

    Raises:
        InputError: the interface is not known, or a bit rate is not possible.
    """

    KEYS = ("interface", "channel", "bitrate", "fd", "data_bitrate")

    interface: str
    channel: str
    bitrate: int | None = None
    fd: bool = False
    data_bitrate: int | None = None
    options: Mapping[str, str] = field(default_factory=dict)
    reopens: bool = False

    def __post_init__(self) -> None:
        if self.interface not in can.VALID_INTERFACES:
            near = difflib.get_close_matches(self.interface, can.VALID_INTERFACES, 1)
            meant = f"did you mean {near[0]}? " if near else ""
            raise InputError(
                f"interface {self.interface}",
                "is not known to python-can",
                f"{meant}it has {', '.join(sorted(can.VALID_INTERFACES))}",
            )
        if self.data_bitrate is not None and not self.fd:
            raise InputError(self.place, "has a data bit rate, but is no CAN FD bus", "give --fd, too")
        if self.fd and self.interface in _TIMED and None in (self.bitrate, self.data_bitrate):
            raise InputError(self.place, "lacks a bit rate for CAN FD", "give --bitrate and --data-bitrate")
        if self.interface == "slcan":
            _check(self.place, "bit rate", self.bitrate, protocol.BITRATES)
            _check(self.place, "data bit rate", self.data_bitrate, protocol.DATA_BITRATES)

    @property
    def place(self) -> str:
        """How messages name the bus."""
        return f"{self.interface}:{self.channel}"


def _check(place: str, what: str, value: int | None, known: Mapping[str, int]) -> None:
    if value is not None and value not in known.values():
        rates = ", ".join(str(rate) for rate in sorted(known.values()))
        raise InputError(place, f"no serial adapter has the {what} {value}", f"choose among {rates}")


def parse_option(text: str) -> tuple[str, str]:
    """Name and value of `name=value`.

    Raises:
        InputError: it is not of that form.
    """
    match = re.fullmatch(r"([A-Za-z_]\w*)=(.*)", text)
    if match is None:
        raise InputError(f"--option {text}", "is not understood", "write name=value")
    return match[1], match[2]


class OnBuses:
    """What is done on one bus or several; channels are numbered in their order, `bus` is 0."""

    bus: BusSettings
    others: tuple[BusSettings, ...]

    @property
    def buses(self) -> tuple[BusSettings, ...]:
        """All buses, by the number of their channel."""
        return self.bus, *self.others

    @property
    def places(self) -> str:
        """All buses, in words."""
        return " and ".join(bus.place for bus in self.buses)


def open_bus(settings: BusSettings) -> can.BusABC:
    """The open bus.

    Only the settings count: python-can's configuration files and environment variables are not read.

    Raises:
        BusError: the adapter does not open.
    """
    options = {name: cast_from_string(value) for name, value in settings.options.items()}
    try:
        keywords: dict[str, Any] = {**_rates(settings), **options}
        if settings.interface == "slcan" and "://" not in settings.channel:
            return SlcanBus(settings.channel, **keywords)
        return can.Bus(settings.channel, settings.interface, ignore_config=True, **keywords)
    except Exception as error:  # drivers raise anything: ImportError, AttributeError, their own
        fix = "see that the adapter is plugged in, its driver installed, and the channel right"
        if isinstance(error, PortInUse):
            fix = "end the other program, or give another channel"
        raise BusError(settings.place, f"does not open ({complaint(error)})", fix) from error


@contextlib.contextmanager
def opened(settings: BusSettings) -> Iterator[can.BusABC]:
    """The open bus, closed at the end whatever happened; an adapter that fails while it closes is gone anyway."""
    bus = open_bus(settings)
    try:
        yield bus
    finally:
        with contextlib.suppress(Exception):
            bus.shutdown()


class _BitRates(TypedDict, total=False):
    timing: can.BitTimingFd
    bitrate: int
    data_bitrate: int
    protocol: can.CanProtocol
    fd: bool


def _rates(settings: BusSettings) -> _BitRates:
    """The bit rates as the interface wants them."""
    if settings.fd and settings.interface in _TIMED:
        timing = can.BitTimingFd.from_sample_point(
            f_clock=_CLOCK,
            nom_bitrate=settings.bitrate or 0,
            nom_sample_point=_SAMPLE_POINT,
            data_bitrate=settings.data_bitrate or 0,
            data_sample_point=_SAMPLE_POINT,
        )
        return {"timing": timing, "fd": True} if settings.interface == "pcan" else {"timing": timing}
    values: _BitRates = {}
    if settings.bitrate is not None:
        values["bitrate"] = settings.bitrate
    if settings.data_bitrate is not None:
        values["data_bitrate"] = settings.data_bitrate
    if settings.interface == "virtual":
        values["protocol"] = can.CanProtocol.CAN_FD if settings.fd else can.CanProtocol.CAN_20
    elif settings.fd or settings.interface == "udp_multicast":  # that one's own default is CAN FD
        values["fd"] = settings.fd
    return values


def send(bus: can.BusABC, message: can.Message, patience: float = 1.0) -> None:
    """Send a frame; wait that long [s] while the adapter's buffer is full.

    Raises:
        CanError: the adapter took no frame in that time, or failed.
    """
    until = time.monotonic() + patience
    while True:
        try:
            return bus.send(message, timeout=patience)
        except can.CanOperationError as error:
            if error.error_code != errno.ENOBUFS or time.monotonic() >= until:
                raise
        time.sleep(0.001)


def occupied(message: can.Message, settings: BusSettings) -> float:
    """For how long a frame takes its bus [s]; 0 where that is not known."""
    if settings.bitrate is None or message.is_error_frame:
        return 0.0
    switched = settings.data_bitrate if message.bitrate_switch else None
    kind = message.is_extended_id, message.is_remote_frame, message.is_fd
    return frame_time.seconds(message.dlc, *kind, settings.bitrate, switched)


def is_bus_off(message: can.Message) -> bool:
    """Whether this is the error frame by which an adapter says that it has left the bus for too many errors."""
    return bool(message.is_error_frame and message.arbitration_id & ERROR_BUS_OFF)
