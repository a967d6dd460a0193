"""A stand-in for serial CAN adapters on one bus: pseudo-terminals that programs open as they would real ports.

`hub_process` runs it as a process of its own, which ends with the one that started it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import IO, Any

from fmus.errors import BusError, InputError
from orchestrator.can.slcan.adapter import AdapterBus, BitRates, SerialAdapter

with contextlib.suppress(ImportError):  # where terminals are no files; `_taken` says so
    import fcntl
    import termios
    import tty

_STARTING = 20.0  # patience with a process that has still to start [s]
_ENDING = 5.0  # patience with one that has been told to end [s]
_ROOT = Path(__file__).parents[3]


@dataclass(frozen=True)
class HubSettings:
    """A bus and its adapters.

    Attributes:
        folder: where the ports are: links named 0, 1, ...
        bitrate: of the bus [bit/s].
        data_bitrate: of the part of CAN FD frames that switches [bit/s].
        paced: whether frames take the time that their bits take on a wire, and wait for each other.
    """

    folder: Path
    ports: int = 2
    bitrate: int = 500_000
    data_bitrate: int = 2_000_000
    paced: bool = True


@dataclass(frozen=True)
class PortStatistics:
    """Frames of an adapter: sent, heard, lost as its port was too slow, and refused."""

    sent: int
    heard: int
    lost: int
    refused: int


@dataclass(frozen=True)
class HubStatistics:
    """Frames that have passed, how long they kept the bus busy and the hub has run [s], and counts of its ports.

    Attributes:
        paused: the longest time for which this computer kept the hub from its work, so that frames were heard late [s].
    """

    frames: int
    busy: float
    elapsed: float
    paused: float
    ports: tuple[PortStatistics, ...]


class _Port:
    """A pseudo-terminal with an adapter behind it.

    The hub keeps the application's end open too, so that applications may come and go as with a real port.
    """

    def __init__(self, path: Path, adapter: SerialAdapter) -> None:
        self.adapter, self.path = adapter, path
        self.master, self._slave, self._name = _pseudo_terminal()
        if path.is_symlink():  # of a hub that was killed
            path.unlink()
        path.symlink_to(self._name)
        self.plugged = True

    def read(self, now: float) -> None:
        """Take what the application has written."""
        try:
            data = os.read(self.master, 65536)
        except BlockingIOError:
            return
        if self.adapter.take(data, now) and not self.adapter.open and sys.platform != "win32":
            termios.tcflush(self._slave, termios.TCIFLUSH)  # what the one before has not read

    def write(self) -> None:
        """Pass on what the port takes."""
        with contextlib.suppress(BlockingIOError):
            count = os.write(self.master, self.adapter.outgoing)
            del self.adapter.outgoing[:count]

    def unplug(self) -> None:
        """Be gone."""
        if self.plugged:
            self.plugged = self.adapter.open = False
            with contextlib.suppress(OSError):
                if str(self.path.readlink()) == self._name:
                    self.path.unlink()
            os.close(self.master)
            os.close(self._slave)


class _Hub:
    """The loop that moves lines between ports and bus.

    Args:
        orders: where commands come from, line by line, each answered by a JSON document on stdout; at its end the hub
            ends. None: it runs until it is told by a signal.
    """

    def __init__(self, settings: HubSettings, orders: int | None) -> None:
        self._lock = _taken(settings.folder)
        rates = BitRates(settings.bitrate, settings.data_bitrate)
        self._ports = [
            _Port(settings.folder / str(number), SerialAdapter(rates, settings.paced))
            for number in range(settings.ports)
        ]
        self._bus = AdapterBus([port.adapter for port in self._ports])
        self._orders, self._order = orders, b""
        self._parent = os.getppid()
        self._started = time.monotonic()
        self._paused = 0.0
        self.running = True

    def run(self) -> None:
        """Work until told to end."""
        orders = [] if self._orders is None else [self._orders]
        by_number = {port.master: port for port in self._ports}
        due = time.monotonic()  # by when the loop is to come round
        while self.running:
            now = time.monotonic()
            self._paused = max(self._paused, now - due)
            end = self._bus.advance(now)
            live = [port for port in self._ports if port.plugged]
            for port in live:
                if port.adapter.outgoing:
                    port.write()
            readable = [port.master for port in live if not port.adapter.full]
            writable = [port.master for port in live if port.adapter.outgoing]
            patience = 1.0 if end is None else max(0.0, end - time.monotonic())
            due = now + patience
            readable, writable, _ = select.select(readable + orders, writable, [], patience)
            now = time.monotonic()
            for number in readable:
                if number == self._orders:
                    self._obey()
                else:
                    by_number[number].read(now)
            if not readable and self._orders is not None and os.getppid() != self._parent:
                self.running = False

    def close(self) -> None:
        """Take the ports away."""
        for port in self._ports:
            port.unplug()
        os.close(self._lock)

    def _obey(self) -> None:
        """Do what the process that started this one asks for."""
        assert self._orders is not None
        data = os.read(self._orders, 4096)
        *lines, self._order = (self._order + data).split(b"\n")
        self.running = bool(data)
        for line in lines:
            word, *numbers = line.decode().split()
            ports = [self._ports[int(number)] for number in numbers]
            for port in ports:
                if word == "unplug":
                    port.unplug()
                elif word == "fill":
                    port.adapter.fill(time.monotonic())
                else:
                    port.adapter.spare() if word == "spare" else port.adapter.go_off()
            _tell(asdict(self._statistics()))

    def _statistics(self) -> HubStatistics:
        ports = (
            PortStatistics(adapter.sent, adapter.heard, adapter.lost, adapter.ignored) for adapter in self._bus.adapters
        )
        elapsed = time.monotonic() - self._started
        return HubStatistics(self._bus.frames, self._bus.busy, elapsed, self._paused, tuple(ports))


def _pseudo_terminal() -> tuple[int, int, str]:
    """Its two ends, the first of which never waits, and the name of the second."""
    if sys.platform == "win32":
        raise OSError("Windows has no pseudo-terminals")
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    return master, slave, os.ttyname(slave)


def _taken(folder: Path) -> int:
    """Make the folder this hub's own, for as long as what is returned stays open."""
    if sys.platform == "win32":
        raise InputError(folder, "cannot hold serial ports on Windows", "work under WSL, or with real adapters")
    try:
        folder.mkdir(parents=True, exist_ok=True)
        number = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise InputError(folder, "has the ports of another hub, which runs", "give another folder, or end it") from None
    except OSError as error:
        raise InputError(folder, f"cannot hold ports ({error.strerror})", "give another folder") from error
    return number


def serve(settings: HubSettings, orders: int | None = None) -> None:
    """Be the adapters until told to end: by SIGTERM, by Ctrl-C, or by the end of `orders`.

    Raises:
        InputError: the folder has another hub's ports.
    """
    hub = _Hub(settings, orders)

    def end(number: int, frame: FrameType | None) -> None:
        hub.running = False

    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, end)
    try:
        _tell({"ports": [str(settings.folder / str(number)) for number in range(settings.ports)]})
        hub.run()
    finally:
        hub.close()


def _tell(document: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(document) + "\n")
    sys.stdout.flush()


class Hub:
    """A hub in another process.

    Attributes:
        paths: the ports.
        pid: number of its process.
    """

    def __init__(self, process: subprocess.Popen[str], settings: HubSettings) -> None:
        self._process, self._paced = process, settings.paced
        self.paths = tuple(settings.folder / str(number) for number in range(settings.ports))
        self.pid = process.pid

    def unplug(self, port: int) -> None:
        """Take a port away."""
        self._ask(f"unplug {port}")

    def bus_off(self, port: int) -> None:
        """Let an adapter leave the bus as after too many errors."""
        self._ask(f"off {port}")

    def fill(self, port: int) -> None:
        """Have an adapter send frames of the highest priority without a gap, until `spare`.

        Raises:
            InputError: frames take no time on this bus, so that it is never full.
        """
        if not self._paced:
            raise InputError("fill", "frames take no time on this bus", "start a hub that is paced")
        self._ask(f"fill {port}")

    def spare(self, port: int) -> None:
        """Have that one leave the bus to others again."""
        self._ask(f"spare {port}")

    def statistics(self) -> HubStatistics:
        """What has passed until now."""
        document = json.loads(self._ask("tell"))
        ports = tuple(PortStatistics(**port) for port in document.pop("ports"))
        return HubStatistics(**document, ports=ports)

    def _ask(self, order: str) -> str:
        orders, answers = self._process.stdin, self._process.stdout
        assert orders is not None
        assert answers is not None
        orders.write(order + "\n")
        orders.flush()
        return _answer(answers, _ENDING, self._process)


def _answer(answers: IO[str], patience: float, process: subprocess.Popen[str]) -> str:
    """The hub's next line, a document."""
    line = answers.readline() if select.select([answers], [], [], patience)[0] else ""
    if not line:
        raise BusError("slcan hub", f"gives no answer (process {process.pid})", "see what it said before")
    if refused := json.loads(line).get("refused"):
        raise InputError(*refused)
    return line


@contextlib.contextmanager
def hub_process(
    folder: Path, ports: int = 2, bitrate: int = 500_000, data_bitrate: int = 2_000_000, paced: bool = True
) -> Iterator[Hub]:
    """A hub that is ready, in a process of its own; it ends with the block, and when this process dies.

    Raises:
        BusError: it did not start.
        InputError: the folder has another hub's ports.
    """
    settings = HubSettings(folder, ports, bitrate, data_bitrate, paced)
    command = [
        sys.executable,
        "-m",
        __name__,
        str(folder),
        "--ports",
        str(ports),
        "--bitrate",
        str(bitrate),
        "--data-bitrate",
        str(data_bitrate),
        "--supervised",
        *([] if paced else ["--unpaced"]),
    ]
    path = os.pathsep.join(filter(None, (str(_ROOT), os.environ.get("PYTHONPATH"))))
    process = subprocess.Popen(
        command,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        env=os.environ | {"PYTHONPATH": path},
        start_new_session=True,
    )
    try:
        assert process.stdout is not None
        _answer(process.stdout, _STARTING, process)
        yield Hub(process, settings)
    finally:
        _end(process)


def _end(process: subprocess.Popen[str]) -> None:
    for pipe in (process.stdin, process.stdout):
        assert pipe is not None
        with contextlib.suppress(OSError):
            pipe.close()
    try:
        process.wait(_ENDING)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def main(arguments: Sequence[str]) -> None:
    """The process of a hub."""
    parser = argparse.ArgumentParser("python -m orchestrator.can.slcan.hub", description=__doc__)
    parser.add_argument("folder", type=Path, help="where the ports are put: links named 0, 1, ...")
    parser.add_argument("--ports", type=int, default=2)
    parser.add_argument("--bitrate", type=int, default=500_000)
    parser.add_argument("--data-bitrate", type=int, default=2_000_000)
    parser.add_argument("--unpaced", action="store_true", help="frames take no time on the bus")
    parser.add_argument("--supervised", action="store_true", help="take orders from stdin, and end when it does")
    given = parser.parse_args(arguments)
    settings = HubSettings(given.folder, given.ports, given.bitrate, given.data_bitrate, not given.unpaced)
    try:
        serve(settings, sys.stdin.fileno() if given.supervised else None)
    except InputError as error:
        if given.supervised:
            _tell({"refused": [error.place, error.problem, error.fix]})
        sys.exit(f"servotwin: {error}" if not given.supervised else error.exit_code)


if __name__ == "__main__":
    main(sys.argv[1:])
