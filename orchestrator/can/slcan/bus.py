"""Serial CAN adapters (slcan) at the pace of a full bus: python-can's bus, reading and writing in blocks.

python-can's own reads byte by byte, stops at the first line that is noise, and drops what adapters say about errors.
"""

from __future__ import annotations

import contextlib
import errno
import math
import os
import re
import sys
import time
from binascii import unhexlify
from collections import deque
from select import select
from threading import Lock
from typing import Any

import can
import serial
from can.interfaces.slcan import slcanBus

from orchestrator.can.slcan import protocol
from orchestrator.can.slcan.adapter_clock import AdapterClock
from orchestrator.can.slcan.flow import LATE, STALL, Flow, Key
from orchestrator.can.slcan.opening import VERSION, take_over

# Classes of error frames and their details, as socketcan has them in identifier and data (linux/can/error.h).
ERROR_CONTROLLER, ERROR_PROTOCOL, ERROR_ACK, ERROR_BUS_OFF, ERROR_COUNTERS = 0x04, 0x08, 0x20, 0x40, 0x200

_CLEARING = 0.3  # patience with an adapter that is to leave the bus and to join it again [s]
_ASKING = 0.5  # between two questions whether an adapter that has stopped to answer is there [s]
_TAKEN = (b"", b"z", b"Z")  # the answers to a frame, without and with automatic polling
_ANSWER = re.compile(rb"v[0-9A-Fa-f]{2,4}|N\w{1,8}|F[0-9A-Fa-f]{2}")
_STATE = re.compile(rb"s([awpb])(\d{3})(\d{3})")
_ERRORS = re.compile(rb"e\d([abBcfosO]+)")
_STATES = {  # letter: state, bits in byte 1 of an error frame
    b"a": (can.BusState.ACTIVE, 0x40),
    b"w": (can.BusState.ACTIVE, 0x0C),
    b"p": (can.BusState.PASSIVE, 0x30),
    b"b": (can.BusState.ERROR, 0x00),
}
_DETAILS = {  # letter: class, byte of the data, bits in it
    "a": (ERROR_ACK, 0, 0x00),
    "b": (ERROR_PROTOCOL, 2, 0x08),
    "B": (ERROR_PROTOCOL, 2, 0x10),
    "c": (ERROR_PROTOCOL, 3, 0x08),
    "f": (ERROR_PROTOCOL, 2, 0x02),
    "s": (ERROR_PROTOCOL, 2, 0x04),
    "o": (ERROR_CONTROLLER, 1, 0x01),
    "O": (ERROR_CONTROLLER, 1, 0x02),
}


class PortInUse(can.CanInitializationError):
    """Somebody else has the serial port open."""


class SlcanBus(slcanBus):
    """An adapter on a serial port that is ours alone; what it reports of errors comes as error frames.

    Received frames carry the adapter's stamps, or the time at which they were read, on a clock that never jumps.

    Attributes:
        clock: what it makes of the adapter's stamps.
        tells_version: whether it says its version when it is asked, so that answers up to then are known to be all.
        flow: which frames it took.
        malformed: lines that were no frame and no answer: noise, or an adapter that speaks something else.
        refused: commands and frames that the adapter has not taken (BEL).
        stays: whether the adapter stays on the bus when it is left, and sends what it has still to send.
        insists: whether frames are also given to an adapter that has stopped to answer; they go when it goes on.
    """

    def __init__(
        self,
        channel: str,
        tty_baudrate: int = 115200,
        bitrate: int | None = None,
        timing: can.BitTimingFd | None = None,
        listen_only: bool = False,
        sleep_after_open: float = 0.0,
        rtscts: bool = False,
        btr: str | None = None,
        **options: Any,
    ) -> None:
        self.malformed = self.refused = 0
        self.stays = self.insists = False
        self.clock = AdapterClock()
        self._bus_state = can.BusState.ACTIVE
        self._received: deque[can.Message] = deque()
        self._reading = Lock()
        self._unsent = b""
        self._asked = 0.0  # when it was asked last whether it is still there
        self._epoch = time.time() - time.perf_counter()
        self._can_protocol = can.CanProtocol.CAN_20
        name, _, baudrate = channel.partition("@")
        self.serialPortOrig = _port(name, int(baudrate or tty_baudrate), rtscts)
        try:
            time.sleep(sleep_after_open)
            self.serialPortOrig.reset_output_buffer()
            nominal, data = (timing.nom_bitrate, timing.data_bitrate) if timing else (bitrate, None)
            self._commands = [*_settings(nominal, data, btr), "L" if listen_only else "O"]
            self.tells_version, (*lines, self._partial) = take_over(self.serialPortOrig.fd, self._commands)
            self.flow = Flow(self.tells_version)
            for line in lines:
                self._take(line, self._epoch + time.perf_counter())
            can.BusABC.__init__(self, channel, **options)
        except BaseException:
            _release(self.serialPortOrig)
            raise

    @property
    def owed(self) -> int:
        """Frames that the adapter has still to answer to; one that has not for a while is asked whether it is there.

        Answers are in order: what it owes when it has answered to that, and says no more, noise has swallowed.
        """
        flow, now = self.flow, time.monotonic()
        if flow.owed and now - max(flow.given, flow.heard) > STALL and flow.answers:
            with contextlib.suppress(OSError):  # one that is gone is noticed where it is read
                self._ask(now)
        if flow.given < self._asked < flow.heard < now - LATE:
            flow.settle()
        return flow.owed if flow.answers else 0

    @property
    def state(self) -> can.BusState:
        """What the adapter said last about its state."""
        return self._bus_state

    @state.setter
    def state(self, new_state: can.BusState) -> None:
        raise NotImplementedError("a serial adapter changes its state by itself")

    def flush_tx_buffer(self) -> None:
        """Have the adapter forget what it has not sent: it leaves the bus and joins it again.

        Raises:
            CanTimeoutError: the adapter does not answer.
            CanOperationError: the port is gone.
        """
        port, before = self.serialPortOrig.fd, self.flow.settled
        if port is None:
            raise can.CanOperationError("the port is closed")
        self.flow.ask()
        lines = "\r".join(["C", *self._commands, "V", ""]).encode("ascii")
        try:
            self._unsent = self._written(port, self._unsent + lines, _CLEARING)
        except OSError as error:
            raise can.CanOperationError(f"the adapter is gone ({error.strerror})") from error
        until = time.monotonic() + _CLEARING
        while self.tells_version and self.flow.settled == before:  # answers are in order; the version is the last one
            if time.monotonic() > until:
                raise can.CanTimeoutError("the adapter has stopped to answer")
            self._fetch(0.01)

    def shutdown(self) -> None:
        """Leave the bus and free the port, also that of an adapter which is gone.

        python-can's own would wait for the port before it frees it, and keep it where the adapter does not answer.
        """
        can.BusABC.shutdown(self)
        try:
            if self.serialPortOrig.fd is not None:
                self._written(self.serialPortOrig.fd, self._unsent + (b"" if self.stays else b"C\r"), 0.2)
        except OSError:
            pass
        finally:
            _release(self.serialPortOrig)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        if not self._received:
            self._fetch(timeout)
        return (self._received.popleft() if self._received else None), False

    def _fetch(self, timeout: float | None) -> None:
        """Take in all that the port has, after waiting for the first of it.

        Raises:
            CanOperationError: the port is gone.
        """
        port = self.serialPortOrig.fd
        if port is None:
            raise can.CanOperationError("the port is closed")
        try:
            if not select([port], [], [], timeout)[0]:
                return
            with self._reading:
                if select([port], [], [], 0.0)[0]:  # another thread may have read it; then nothing looks like a hang-up
                    self._read_lines(port)
        except OSError as error:
            if isinstance(error, can.CanError):
                raise
            raise can.CanOperationError(f"the adapter is gone ({error.strerror})") from error

    def _read_lines(self, port: int) -> None:
        if not (data := os.read(port, 65536)):
            raise can.CanOperationError("the adapter is gone (hung up)")
        stamp = self._epoch + time.perf_counter()
        lines = (self._partial + protocol.marked(data)).split(protocol.END)
        self._partial = lines.pop()
        if len(self._partial) > protocol.LONGEST:
            self._partial = b""
            self.malformed += 1
        for line in lines:
            self._take(line, stamp)

    def _take(self, line: bytes, stamp: float) -> None:
        """Act on one line: a frame, news of errors, an answer, or noise."""
        frame = protocol.parse(line)
        if frame is not None:
            self._received.append(_data_frame(frame, self.clock.dated(frame.stamp, stamp)))
        elif line in _TAKEN:
            self.flow.answered(True, time.monotonic())
        elif VERSION.fullmatch(line):
            self.flow.spoke()
        elif _ANSWER.fullmatch(line):
            pass
        elif state := _STATE.fullmatch(line):
            self._change(state, stamp)
        elif errors := _ERRORS.fullmatch(line):
            self._received.append(_error_frame(errors[1].decode(), stamp))
        elif line == protocol.BELL:
            self.refused += 1
            self.flow.answered(False, time.monotonic())
        else:
            self.malformed += 1

    def _change(self, match: re.Match[bytes], stamp: float) -> None:
        """Keep the state that the adapter is in, and pass it on as an error frame."""
        self._bus_state, details = _STATES[match[1]]
        off = ERROR_BUS_OFF if self._bus_state is can.BusState.ERROR else ERROR_CONTROLLER
        data = bytearray(8)
        data[1], data[6], data[7] = details, min(int(match[3]), 255), min(int(match[2]), 255)
        self._received.append(_error(off | ERROR_COUNTERS, data, stamp))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        """Send a frame; setting another timeout already asks the port, which may be gone.

        Raises:
            CanTimeoutError: the adapter took nothing of it within the timeout [s]; what it was given before and has
                not taken is dropped where the port can.
            CanOperationError: the port is gone.
        """
        try:
            key = msg.arbitration_id, msg.is_extended_id
            if not self.insists:
                self._await_answers(key, timeout)
            with self.flow.giving(key, time.monotonic()):
                super().send(msg, timeout)
            if self.tells_version and not self._asked:
                self._ask(time.monotonic())  # whether it answers to frames, or to this alone
        except OSError as error:
            if isinstance(error, can.CanError):
                raise
            raise can.CanOperationError(f"the adapter is gone ({error})") from error

    def _await_answers(self, key: Key, patience: float | None) -> None:
        """See that the adapter takes what it is given: no command is to wait behind old ones, and be late itself."""
        until = math.inf if patience is None else time.monotonic() + patience
        while self.flow.stalled(now := time.monotonic(), key):
            self._ask(now)
            self._fetch(min(max(until - now, 0.0), 0.01))
            if time.monotonic() >= until and self.flow.stalled(time.monotonic(), key):
                raise can.CanTimeoutError("the adapter has stopped to answer")

    def _ask(self, now: float) -> None:
        """Ask an adapter that has stopped to answer whether it is there, but not all the time."""
        if now - self._asked > _ASKING and self.serialPortOrig.fd is not None:
            self._asked = now
            self.flow.ask()
            self._unsent = self._written(self.serialPortOrig.fd, self._unsent + b"V\r", 0.0)  # answers are in order

    def _write(self, string: str) -> None:
        """Write a line whole; what does not fit in time goes before the next line.

        Raises:
            CanTimeoutError: the port took nothing of the line within the timeout of `send`.
            CanOperationError: the port is gone.
        """
        line = string.encode("ascii") + self.LINE_TERMINATOR
        port, patience = self.serialPortOrig.fd, self.serialPortOrig.write_timeout
        if port is None:
            raise can.CanOperationError("the port is closed")
        self._unsent = self._written(port, self._unsent, patience)
        left = line if self._unsent else self._written(port, line, patience)
        if left == line:
            self._drop()
            raise can.CanTimeoutError("the adapter takes no more frames")
        self._unsent = left

    def _drop(self) -> None:
        """Drop what waits in the port, where a line may be cut: the end of a line comes next."""
        self.serialPortOrig.reset_output_buffer()
        self.flow.settle()
        self._unsent = protocol.END

    @staticmethod
    def _written(port: int, data: bytes, patience: float | None) -> bytes:
        """Write, waiting at most that long each time the port is full; what is left."""
        while data:
            try:
                data = data[os.write(port, data) :]
            except BlockingIOError:
                if not select([], [port], [], patience)[1]:
                    break
        return data


def _port(name: str, baudrate: int, rtscts: bool) -> serial.Serial:
    """The port, for us alone.

    Raises:
        CanInitializationError: somebody else has it, or it does not open.
    """
    try:
        return serial.Serial(name, baudrate, rtscts=rtscts, timeout=0.001, exclusive=True)
    except serial.SerialException as error:
        if error.errno == errno.EWOULDBLOCK:
            raise PortInUse("another program has the port open") from error
        raise can.CanInitializationError(str(error)) from error


def _release(port: serial.Serial) -> None:
    """Let others have the port, also where a child of this process has inherited it."""
    if sys.platform != "win32" and port.fd is not None:
        import fcntl  # noqa: PLC0415 (of Unix)

        with contextlib.suppress(OSError):
            fcntl.flock(port.fd, fcntl.LOCK_UN)
    port.close()


def _settings(bitrate: int | None, data_bitrate: int | None, btr: str | None) -> list[str]:
    """The commands that set the bit rates."""
    codes = [*(code for code, rate in protocol.BITRATES.items() if rate == bitrate)]
    codes += [code for code, rate in protocol.DATA_BITRATES.items() if rate == data_bitrate]
    return codes + ([f"s{btr}"] if btr else [])


def _data_frame(frame: protocol.FrameLine, stamp: float) -> can.Message:
    return can.Message(
        timestamp=stamp,
        arbitration_id=frame.identifier,
        is_extended_id=frame.extended,
        is_remote_frame=frame.remote,
        is_fd=frame.fd,
        bitrate_switch=frame.switched,
        dlc=frame.length,
        data=unhexlify(frame.digits),
    )


def _error_frame(letters: str, stamp: float) -> can.Message:
    """The error frame that an adapter's letters mean."""
    identifier, data = 0, bytearray(8)
    for letter in letters:
        kind, place, details = _DETAILS[letter]
        identifier |= kind
        data[place] |= details
    return _error(identifier, data, stamp)


def _error(identifier: int, data: bytearray, stamp: float) -> can.Message:
    return can.Message(
        timestamp=stamp, arbitration_id=identifier, is_error_frame=True, is_extended_id=False, dlc=8, data=data
    )
