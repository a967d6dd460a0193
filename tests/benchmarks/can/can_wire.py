"""The way to and from a bus: the stand-in for serial adapters, our serial bus beside python-can's, a recording.

Everything over pseudo-terminals on this machine, sender, bus and receiver in three processes where there are three.
"""

from __future__ import annotations

import json
import os
import signal
import tempfile
import threading
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from statistics import median

import can

from orchestrator.can.live.bus import BusSettings, open_bus, opened, send
from orchestrator.can.live.recorder import BusRecording, record
from orchestrator.can.slcan.hub import Hub, hub_process
from tests.support.can.wiring import command, wait_for

from ..figure import Figure

BITRATE, FAST = 500_000, 1_000_000
LONG = 300.0  # [s]
FRAME = can.Message(arbitration_id=0x123, is_extended_id=False, data=bytes(8))
LINES = b"t12381122334455667788\r"


def figures() -> list[Figure]:
    """All of them."""
    with tempfile.TemporaryDirectory() as folder:
        with hub_process(Path(folder) / "unpaced", 2, paced=False) as hub:
            found = [_throughput(hub), _latency(hub)]
        with hub_process(Path(folder) / "paced", 2, BITRATE) as hub:
            found.append(_recording(hub, Path(folder) / "recording"))
        found.append(_two_channels(Path(folder), 5.0))
    ours, theirs = _reading(ours=True), _reading(ours=False)
    return [
        *found,
        Figure(
            "frames read from a serial port, ours beside python-can's",
            "4,000/s",
            f"{ours:,.0f}/s beside {theirs:,.0f}/s",
            ours >= 4000,
        ),
    ]


def endurance() -> list[Figure]:
    """Two full buses recorded for five minutes."""
    with tempfile.TemporaryDirectory() as folder:
        return [_two_channels(Path(folder), LONG)]


def _settings(hub: Hub, port: int) -> BusSettings:
    return BusSettings("slcan", str(hub.paths[port]), BITRATE)


def _throughput(hub: Hub, bursts: int = 40, size: int = 1000) -> Figure:
    """Bursts that fit into the ports' buffers, each received before the next."""
    with opened(_settings(hub, 0)) as one, opened(_settings(hub, 1)) as other:
        time.sleep(0.1)
        begun = time.perf_counter()
        received = 0
        for _ in range(bursts):
            for _ in range(size):
                send(one, FRAME)
            received += sum(1 for _ in zip(range(size), iter(partial(other.recv, 1.0), None), strict=False))
        rate = received / (time.perf_counter() - begun)
    return Figure(
        "frames relayed between two serial ports, none lost",
        "4,000/s",
        f"{rate:,.0f}/s",
        rate >= 4000 and received == bursts * size,
    )


def _latency(hub: Hub, count: int = 500) -> Figure:
    taken = []
    with opened(_settings(hub, 0)) as one, opened(_settings(hub, 1)) as other:
        time.sleep(0.1)
        for _ in range(count):
            begun = time.perf_counter()
            send(one, FRAME)
            other.recv(1.0)
            taken.append(time.perf_counter() - begun)
            time.sleep(0.002)
    return Figure(
        "a frame from port to port, idle, median",
        "well below 1 ms",
        f"{1e6 * median(taken):.0f} µs",
        median(taken) < 5e-4,
    )


def _recording(hub: Hub, folder: Path, seconds: float = 5.0) -> Figure:
    """As many frames as the wire carries, recorded."""
    ending = threading.Event()

    def fill() -> None:
        with opened(_settings(hub, 0)) as one:
            while not ending.is_set():
                send(one, FRAME)

    sender = threading.Thread(target=fill)
    sender.start()
    try:
        manifest = record(BusRecording(_settings(hub, 1), folder, duration=seconds))
    finally:
        ending.set()
        sender.join()
    lost = manifest.dropped + hub.statistics().ports[1].lost
    rate = manifest.frames / seconds
    return Figure(
        "a full bus of 500 kbit/s recorded as BLF: frames lost",
        "0",
        f"{lost} of {manifest.frames:,} ({rate:,.0f}/s)",
        lost == 0 and rate > 3000,
    )


def _two_channels(folder: Path, seconds: float) -> Figure:
    """As many frames as two wires of 1 Mbit/s carry, recorded into one log by a process of its own."""
    with ExitStack() as stack:
        hubs = [stack.enter_context(hub_process(folder / f"bus{number}", 2, FAST)) for number in range(2)]
        ports = [word for hub in hubs for word in ("--channel", hub.paths[1])]
        out = folder / "both"
        options = ("--interface", "slcan", *ports, "--bitrate", FAST, "--out", out)
        recorder = stack.enter_context(command("can", "record", *options))
        wait_for((out / "manifest.json").exists)
        until = time.monotonic() + seconds
        senders = [threading.Thread(target=_fill, args=(hub, until)) for hub in hubs]
        for sender in senders:
            sender.start()
        for sender in senders:
            sender.join()
        time.sleep(1.0)
        heard = [hub.statistics().ports[1] for hub in hubs]
        recorder.send_signal(signal.SIGTERM)
        recorder.communicate()
        manifest = json.loads((out / "manifest.json").read_text())
    carried = sum(port.heard + port.lost for port in heard)
    lost = carried - manifest["frames"]
    return Figure(
        f"two full buses of 1 Mbit/s recorded into one BLF for {seconds:.0f} s: frames lost",
        "0",
        f"{lost} of {carried:,} ({carried / seconds:,.0f}/s)",
        lost == 0,
    )


def _fill(hub: Hub, until: float) -> None:
    with opened(BusSettings("slcan", str(hub.paths[0]), FAST)) as bus:
        while time.monotonic() < until:
            send(bus, FRAME)
        time.sleep(0.5)  # adapters forget what they have not sent when they are closed


def _reading(ours: bool, seconds: float = 2.0) -> float:
    """Frames per second that a bus gets out of a port which always has some."""
    master, slave = os.openpty()
    name = os.ttyname(slave)
    settings = BusSettings("slcan", name)
    bus = open_bus(settings) if ours else can.Bus(name, "slcan", sleep_after_open=0.0)
    os.set_blocking(master, False)
    ending = threading.Event()

    def fill() -> None:
        left = b""
        while not ending.is_set():
            try:
                left = left or LINES * 100
                left = left[os.write(master, left) :]
            except BlockingIOError:
                time.sleep(0.0005)

    writer = threading.Thread(target=fill)
    writer.start()
    begun, count = time.perf_counter(), 0
    while time.perf_counter() - begun < seconds:
        count += bus.recv(0.5) is not None
    ending.set()
    writer.join()
    bus.shutdown()
    os.close(slave)
    os.close(master)
    return count / seconds
