"""Several channels are recorded as one, each with what is its own."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import can
import pytest

from fmus.errors import InputError
from fmus.json_document import document_of
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.manifest import BusRecording
from orchestrator.can.live.recorder import record
from tests.support.can.recordings import DATABASE, numbers, recorded
from tests.support.can.wiring import BITRATE, HANG, frame

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work


def two(name: str) -> tuple[BusSettings, BusSettings]:
    """A virtual bus that keeps the stamps of frames, and another."""
    options = {"preserve_timestamps": "true"}
    one, other = (BusSettings("virtual", f"{name}_{end}", BITRATE, options=options) for end in ("left", "right"))
    return one, other


def both(folder: Path, name: str, sent: list[tuple[int, can.Message]], **options: Any) -> dict[str, Any]:
    """What is recorded of two virtual buses, on which these frames are sent: channel, frame."""
    buses = two(name)
    with opened(buses[0]) as one, opened(buses[1]) as other:

        def send_all() -> None:
            for channel, message in sent:
                (one, other)[channel].send(message)

        def end(share: float, doing: str) -> None:
            if f"{len(sent):,} frames" in doing:
                signal.raise_signal(signal.SIGINT)

        recording = BusRecording(buses[0], folder, **{"duration": HANG, "others": buses[1:]} | options)
        return document_of(record(recording, end, send_all))


def stamped(number: int, stamp: float, identifier: int = 0x100) -> can.Message:
    message = frame(number, identifier)
    message.timestamp = 1.7e9 + stamp
    return message


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_several_channels_are_one_log_in_the_order_of_its_clock(tmp_path: Path, suffix: str) -> None:
    sent = [(k // 50 % 2, stamped(k, 0.001 * k)) for k in range(300)]  # fifty here, fifty there
    found = both(tmp_path / "run", f"log{suffix[1:]}", sent, suffix=suffix)
    assert len(found["files"]) == 1
    assert numbers(tmp_path / "run") == list(range(300))
    assert [message.channel for message in recorded(tmp_path / "run")] == [channel for channel, _ in sent]
    assert [channel["frames"] for channel in found["channels"]] == [150, 150]
    names = [channel["channel"] for channel in found["channels"]]
    assert names == [bus.channel for bus in two(f"log{suffix[1:]}")]
    if suffix == ".log":
        words = (tmp_path / "run" / "run_0001.log").read_text().split("\n")[0].split()
        assert words[1] == names[0]


def test_each_channel_is_decoded_with_its_own_database(tmp_path: Path) -> None:
    (tmp_path / "a.dbc").write_text(DATABASE)
    (tmp_path / "b.dbc").write_text(DATABASE.replace("State", "Other"))
    sent = [(0, frame(0)), (1, frame(0)), (1, frame(0))]
    database = {"0": tmp_path / "a.dbc", "own_right": tmp_path / "b.dbc"}
    assert both(tmp_path / "run", "own", sent, database=database)["found"]["messages"] == {"State": 1, "Other": 2}


def test_a_channel_without_frames_is_named_and_one_twice_is_refused(tmp_path: Path) -> None:
    found = both(tmp_path / "run", "idle", [(1, frame(k)) for k in range(3)])
    assert found["remarks"] == ["virtual:idle_left: no frame came"]
    one, _ = two("idle")
    with pytest.raises(InputError, match="recorded twice"):
        BusRecording(one, tmp_path / "twice", others=(one,))
