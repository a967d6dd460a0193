"""Recordings of a bus and what is in them; a virtual bus that is recorded in this process."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import can

from fmus.errors import TraceError
from fmus.json_document import document_of
from orchestrator.can import logs
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.manifest import BusRecording
from orchestrator.can.live.recorder import record
from tests.support.can.wiring import BITRATE, HANG, frame, number

DATABASE = """VERSION ""
BS_:
BU_:
BO_ 256 State: 8 Vector__XXX
 SG_ angle : 0|16@1+ (0.001,0) [0|60] "rad" Vector__XXX
"""


def manifest(folder: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((folder / "manifest.json").read_text())
    return document


def recorded(folder: Path) -> list[can.Message]:
    """All frames of a recording, in the order of its files."""
    files = [folder / file["file"] for file in manifest(folder)["files"]]
    return [message for file in files for batch in logs.read(file) for message in batch.messages()]


def numbers(folder: Path) -> list[int]:
    return [number(message) for message in recorded(folder) if not message.is_error_frame]


def on_disk(folder: Path) -> int:
    """Frames that can be read of a recording which goes on."""
    try:
        return len(numbers(folder))
    except TraceError:  # nothing is written yet
        return 0


def virtual(channel: str, folder: Path, *batches: list[can.Message], **options: Any) -> dict[str, Any]:
    """What is recorded of a virtual bus on which the batches are sent, the next when those before are written."""
    bus, waiting, sent = BusSettings("virtual", channel, BITRATE), list(batches), 0

    def go_on(share: float = 0.0, doing: str = "0 frames") -> None:
        nonlocal sent
        if int(doing.split(maxsplit=1)[0].replace(",", "")) < sent:
            return
        if not waiting:
            signal.raise_signal(signal.SIGINT)
            return
        batch = waiting.pop(0)
        for message in batch:
            sender.send(message)
        sent += len(batch)

    with opened(bus) as sender:
        return document_of(record(BusRecording(bus, folder, **{"duration": HANG} | options), go_on, go_on))


def frames(count: int, first: int = 0) -> list[can.Message]:
    return [frame(number) for number in range(first, first + count)]
