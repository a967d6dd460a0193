"""A machine on a serial CAN adapter that has nothing of the project in it: its own lines, counter and checksum."""

from __future__ import annotations

import math
import os
import struct
import threading
import time
import tty
from contextlib import suppress
from pathlib import Path
from select import select

COMMAND, SENSORS, LAST = 0x100, 0x200, 0x7FF  # LAST goes after whatever else waits for the bus
PERIOD = 0.01  # of what it sends [s]
DBC = """VERSION ""
BU_: Law Rig
BO_ 256 Command: 8 Law
 SG_ level : 0|32@1- (1,0) [-100|100] "" Rig
 SG_ AliveCounter : 32|4@1+ (1,0) [0|15] "" Rig
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" Rig
BO_ 512 Sensors: 8 Rig
 SG_ flow : 0|32@1- (1,0) [-1000|1000] "" Law
 SG_ AliveCounter : 32|4@1+ (1,0) [0|15] "" Law
 SG_ Crc : 56|8@1+ (1,0) [0|255] "" Law
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_ BO_ "CounterSignal" STRING;
BA_DEF_ BO_ "ChecksumAlgorithm" STRING;
BA_DEF_DEF_ "GenMsgCycleTime" 10;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_DEF_DEF_ "CounterSignal" "";
BA_DEF_DEF_ "ChecksumAlgorithm" "";
BA_ "CounterSignal" BO_ 256 "AliveCounter";
BA_ "CounterSignal" BO_ 512 "AliveCounter";
BA_ "ChecksumSignal" BO_ 256 "Crc";
BA_ "ChecksumSignal" BO_ 512 "Crc";
BA_ "ChecksumAlgorithm" BO_ 256 "CRC8_SAE_J1850";
BA_ "ChecksumAlgorithm" BO_ 512 "CRC8_SAE_J1850";
SIG_VALTYPE_ 256 level : 1;
SIG_VALTYPE_ 512 flow : 1;
"""


def checksum(data: bytes) -> int:
    """CRC-8 SAE J1850, bit by bit."""
    crc = 0xFF
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc << 1) ^ (0x1D if crc & 0x80 else 0)
    return (crc & 0xFF) ^ 0xFF


def sensors(value: float, count: int) -> bytes:
    """The data of a good frame."""
    data = struct.pack("<fB2x", value, count % 16)
    return data + bytes([checksum(data)])


class ForeignPort:
    """A serial adapter at 500 kbit/s."""

    def __init__(self, path: Path) -> None:
        self.number = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self.number)
        self._partial = b""
        os.write(self.number, b"C\rS6\rO\r")

    def send(self, identifier: int, data: bytes) -> None:
        with suppress(OSError):  # full, or gone
            os.write(self.number, b"t%03X%d%s\r" % (identifier, len(data), data.hex().upper().encode()))

    def frames(self, patience: float) -> list[tuple[int, bytes]]:
        """Identifier and data of what comes, waiting for the first of it."""
        if not select([self.number], [], [], patience)[0]:
            return []
        with suppress(OSError):
            self._partial += os.read(self.number, 65536)
        *lines, self._partial = self._partial.replace(b"\a", b"\r").split(b"\r")
        return [
            (int(line[1:4], 16), bytes.fromhex(line[5 : 5 + 2 * int(line[4:5])].decode()))
            for line in lines
            if line[:1] == b"t" and len(line) >= 5
        ]


class ForeignMachine:
    """Sends its sensors, wrongly where it is told to, and keeps the commands that it sees.

    Attributes:
        fault: "", or what is wrong: "silence", "checksum", "counter", "not finite", "short".
        commands: instant [s] and value of all that came.
        pauses: the longest time in which it could not look since it was set to 0 [s].
    """

    def __init__(self, sender: Path, watcher: Path) -> None:
        self.fault, self.pauses = "", 0.0
        self.commands: list[tuple[float, float]] = []
        self._ports = [ForeignPort(path) for path in (sender, watcher)]
        self._over, self._heard_out = threading.Event(), threading.Event()
        self._threads = [threading.Thread(target=work) for work in (self._send, self._watch)]
        for thread in self._threads:
            thread.start()

    @property
    def latest(self) -> float:
        """The latest command; NaN before the first."""
        return self.commands[-1][1] if self.commands else math.nan

    def hear_out(self, patience: float = 5.0) -> None:
        """Wait until all that was sent up to now has come."""
        self._heard_out.clear()
        self._ports[0].send(LAST, b"")
        self._heard_out.wait(patience)

    def end(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join()
        for port in self._ports:
            os.close(port.number)

    def _send(self) -> None:
        begun, port, count = time.monotonic(), self._ports[0], 0
        for number in range(1 << 40):
            if self._over.wait(max(0.0, begun + number * PERIOD - time.monotonic())):
                return
            port.frames(0.0)
            fault = self.fault
            if fault == "silence":
                continue
            count += fault != "counter"
            data = sensors(math.nan if fault == "not finite" else 9.0, count)
            data = data[:7] + bytes([data[7] ^ 0x55]) if fault == "checksum" else data
            port.send(SENSORS, data[:6] if fault == "short" else data)

    def _watch(self) -> None:
        before, port = time.monotonic(), self._ports[1]
        while not self._over.is_set():
            frames = port.frames(0.02)
            now = time.monotonic()
            self.pauses, before = max(self.pauses, now - before), now
            self.commands += [
                (now, struct.unpack_from("<f", data)[0])
                for identifier, data in frames
                if identifier == COMMAND and len(data) == 8 and checksum(data[:7]) == data[7]
            ]
            if any(identifier == LAST for identifier, _ in frames):
                self._heard_out.set()
