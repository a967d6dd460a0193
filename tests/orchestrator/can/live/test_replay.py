"""A log goes back onto a bus frame by frame, each at its own time, and how late each was is known."""

from __future__ import annotations

import json
import random
import signal
import statistics
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError, InputError, TraceError
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.replay import replay
from orchestrator.can.slcan.hub import hub_process
from orchestrator.realtime.lateness import Lateness
from tests.support.wiring import command, frame, heard, joined, number

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

START = 1.7e9  # [s]


def written(path: Path, messages: list[can.Message]) -> Path:
    with can.Logger(path) as log:
        for message in messages:
            log(message)
    return path


def stamped(count: int, stamp: Callable[[int], float]) -> list[can.Message]:
    messages = [frame(k) for k in range(count)]
    for k, message in enumerate(messages):
        message.timestamp = START + stamp(k)
    return messages


@pytest.fixture
def listener() -> Iterator[can.BusABC]:
    """The other side of the virtual bus `replay`."""
    with opened(BusSettings("virtual", "replay")) as bus:
        yield bus


BUS = BusSettings("virtual", "replay")


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_frames_come_at_the_distances_they_were_recorded_with(
    tmp_path: Path, listener: can.BusABC, speed: float
) -> None:
    random.seed(1)
    gaps = [random.uniform(0.0, 0.01) for _ in range(100)]
    log = written(tmp_path / "log.blf", stamped(100, lambda k: sum(gaps[:k])))
    done = replay(BUS, log, speed)
    found = heard(listener, 0.1)
    assert [number(message) for message in found] == list(range(100))
    late = [m.timestamp - found[0].timestamp - sum(gaps[:k]) / speed for k, m in enumerate(found)]
    assert statistics.median(map(abs, late)) < 2e-3
    assert done.duration == pytest.approx(sum(gaps[:99]) / speed, abs=0.05)
    assert done.sent == done.lateness.count == 100


def test_a_late_frame_does_not_delay_those_after_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = written(tmp_path / "log.blf", stamped(50, lambda k: 0.005 * k))
    sent: list[float] = []

    def send(bus: can.BusABC, message: can.Message) -> None:
        if not sent:
            time.sleep(0.1)
        sent.append(time.monotonic())

    monkeypatch.setattr("orchestrator.can.live.replay.send", send)
    done = replay(BUS, log)
    assert sent[-1] - sent[0] == pytest.approx(49 * 0.005 - 0.1, abs=0.03)
    assert done.lateness.worst > 0.09


def test_error_frames_are_left_out_and_counted(tmp_path: Path, listener: can.BusABC) -> None:
    messages = [*stamped(3, lambda k: 0.0), can.Message(is_error_frame=True, timestamp=START)]
    done = replay(BUS, written(tmp_path / "log.asc", messages))
    assert (done.sent, done.skipped) == (3, 1)
    assert len(heard(listener, 0.1)) == 3


def test_after_a_clock_that_jumped_back_frames_keep_their_distances(tmp_path: Path, listener: can.BusABC) -> None:
    text = "".join(f"({START + stamp:f}) can0 100#{k:016X}\n" for k, stamp in enumerate((50.0, 50.1, 0.0, 0.1)))
    log = tmp_path / "log.log"
    log.write_text(text)
    done = replay(BUS, log)
    found = heard(listener, 0.1)
    assert [number(message) for message in found] == [0, 1, 2, 3]
    assert done.setbacks == 1
    assert found[-1].timestamp - found[0].timestamp == pytest.approx(0.2, abs=0.05)


def test_can_fd_frames_are_refused_on_a_bus_that_is_opened_without(tmp_path: Path, listener: can.BusABC) -> None:
    message = can.Message(arbitration_id=1, is_fd=True, data=bytes(12), timestamp=START)
    log = written(tmp_path / "log.blf", [message])
    with pytest.raises(InputError, match="give --fd"):
        replay(BUS, log)
    assert replay(BusSettings("virtual", "replay", fd=True), log).sent == 1


def test_what_a_damaged_log_still_holds_is_sent_and_the_rest_is_named(tmp_path: Path, listener: can.BusABC) -> None:
    log = written(tmp_path / "log.blf", stamped(20_000, lambda k: 0.0))
    log.write_bytes(log.read_bytes()[:-3000])
    done = replay(BUS, log)
    assert 0 < done.sent < 20_000
    assert done.damage


@pytest.mark.parametrize("speed", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_speed_is_refused(tmp_path: Path, speed: float) -> None:
    with pytest.raises(InputError, match="--speed"):
        replay(BUS, tmp_path / "log.blf", speed)


def test_a_log_that_is_not_there_is_refused_before_the_bus_is_opened(tmp_path: Path) -> None:
    with pytest.raises(TraceError, match="no such file"):
        replay(BusSettings("slcan", "/dev/ttyNONE"), tmp_path / "log.blf")


def test_an_adapter_that_goes_away_ends_the_replay_with_the_count(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(500, lambda k: 0.005 * k))
    with hub_process(tmp_path / "ports", 2) as hub:
        timer = threading.Timer(0.5, hub.unplug, [0])
        timer.start()
        with pytest.raises(BusError, match=r"failed after \d+ frames \(the adapter is gone"):
            replay(BusSettings("slcan", str(hub.paths[0]), 500_000), log)
        timer.join()


def test_at_the_wrong_bit_rate_the_replay_fails_instead_of_sending_into_nothing(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(100, lambda k: 0.001 * k))
    with hub_process(tmp_path / "ports", 2) as hub, pytest.raises(BusError, match=r"bus off.*bit rate"):
        replay(BusSettings("slcan", str(hub.paths[0]), 250_000), log)


def test_ctrl_c_ends_the_command_with_the_count_and_130(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(10_000, lambda k: 0.005 * k))
    with hub_process(tmp_path / "ports", 2) as hub, joined(hub.paths[1]) as other:
        arguments = ["--interface", "slcan", "--channel", hub.paths[0], "--bitrate", "500000", "--json"]
        with command("can", "replay", log, *arguments) as process:
            assert other.recv(20.0) is not None
            process.send_signal(signal.SIGINT)
            answer, said = process.communicate(timeout=10)
        found = heard(other, 0.2)
    assert process.returncode == 130
    assert json.loads(answer)["stopped"]
    assert json.loads(answer)["sent"] == len(found) + 1
    assert "interrupted after" in said


@given(st.lists(st.floats(1e-6, 100.0), min_size=1, max_size=300), st.sampled_from([0.5, 0.99, 1.0]))
def test_percentiles_of_lateness_are_right_to_five_percent(values: list[float], share: float) -> None:
    counted = Lateness()
    for value in values:
        counted.add(value)
    exact = sorted(values)[max(0, -(-int(1000 * share) * len(values) // 1000) - 1)]
    assert exact <= counted.quantile(share) * (1 + 1e-9)
    assert counted.quantile(share) <= 1.05 * exact
