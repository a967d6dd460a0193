"""A log goes back onto a bus frame by frame, each at its own time, and how late each was is known."""

from __future__ import annotations

import json
import random
import signal
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
from tests.support.wiring import HANG, command, frame, heard, joined, number

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


@pytest.fixture
def deadlines(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """When frames were due; none of them is waited for."""
    found: list[float] = []
    monkeypatch.setattr("orchestrator.realtime.stopping.Stop.sleep_until", lambda stop, due: found.append(due))
    return found


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_frames_are_due_at_the_distances_they_were_recorded_with(
    tmp_path: Path, listener: can.BusABC, deadlines: list[float], speed: float
) -> None:
    random.seed(1)
    gaps = [random.uniform(0.0, 0.01) for _ in range(100)]
    log = written(tmp_path / "log.blf", stamped(100, lambda k: sum(gaps[:k])))
    done = replay(BUS, log, speed)
    assert [number(message) for message in heard(listener, 100)] == list(range(100))
    assert [due - deadlines[0] for due in deadlines] == pytest.approx(
        [sum(gaps[:k]) / speed for k in range(100)], abs=1e-6
    )
    assert done.sent == done.lateness.count == 100


def test_no_frame_goes_before_its_time(tmp_path: Path, listener: can.BusABC) -> None:
    done = replay(BUS, written(tmp_path / "log.blf", stamped(20, lambda k: 0.01 * k)))
    assert [number(message) for message in heard(listener, 20)] == list(range(20))
    assert done.duration >= 0.19 - 1e-6


def test_a_late_frame_does_not_delay_those_after_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, deadlines: list[float]
) -> None:
    log = written(tmp_path / "log.blf", stamped(50, lambda k: 0.005 * k))

    def send(bus: can.BusABC, message: can.Message) -> None:
        if len(deadlines) == 1:
            time.sleep(0.2)

    monkeypatch.setattr("orchestrator.can.live.replay.send", send)
    done = replay(BUS, log)
    assert [due - deadlines[0] for due in deadlines] == pytest.approx([0.005 * k for k in range(50)], abs=1e-6)
    assert done.lateness.worst > 0.1


def test_error_frames_are_left_out_and_counted(tmp_path: Path, listener: can.BusABC) -> None:
    messages = [*stamped(3, lambda k: 0.0), can.Message(is_error_frame=True, timestamp=START)]
    done = replay(BUS, written(tmp_path / "log.asc", messages))
    assert (done.sent, done.skipped) == (3, 1)
    assert len(heard(listener, 3)) == 3


def test_after_a_clock_that_jumped_back_frames_keep_their_distances(
    tmp_path: Path, listener: can.BusABC, deadlines: list[float]
) -> None:
    text = "".join(f"({START + stamp:f}) can0 100#{k:016X}\n" for k, stamp in enumerate((50.0, 50.1, 0.0, 0.1)))
    log = tmp_path / "log.log"
    log.write_text(text)
    done = replay(BUS, log)
    assert [number(message) for message in heard(listener, 4)] == [0, 1, 2, 3]
    assert done.setbacks == 1
    assert [due - deadlines[0] for due in deadlines] == pytest.approx([0.0, 0.1, 0.1, 0.2], abs=1e-5)


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
    gone = r"failed after \d+ frames \(the adapter is gone"
    with hub_process(tmp_path / "ports", 2) as hub, pytest.raises(BusError, match=gone):
        replay(BusSettings("slcan", str(hub.paths[0]), 500_000), log, progress=lambda share, doing: hub.unplug(0))


def test_at_the_wrong_bit_rate_the_replay_fails_instead_of_sending_into_nothing(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(100, lambda k: 0.001 * k))
    with hub_process(tmp_path / "ports", 2) as hub, pytest.raises(BusError, match=r"bus off.*bit rate"):
        replay(BusSettings("slcan", str(hub.paths[0]), 250_000), log)


def test_ctrl_c_ends_the_command_with_the_count_and_130(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(10_000, lambda k: 0.005 * k))
    with hub_process(tmp_path / "ports", 2) as hub, joined(hub.paths[1]) as other:
        arguments = ["--interface", "slcan", "--channel", hub.paths[0], "--bitrate", "500000", "--json"]
        with command("can", "replay", log, *arguments) as process:
            assert other.recv(HANG) is not None
            process.send_signal(signal.SIGINT)
            answer, said = process.communicate(timeout=HANG)
        sent = json.loads(answer)["sent"]
        assert len(heard(other, sent - 1)) == sent - 1
    assert process.returncode == 130
    assert json.loads(answer)["stopped"]
    assert "interrupted after" in said


@given(st.lists(st.floats(1e-6, 100.0), min_size=1, max_size=300), st.sampled_from([0.5, 0.99, 1.0]))
def test_percentiles_of_lateness_are_right_to_five_percent(values: list[float], share: float) -> None:
    counted = Lateness()
    for value in values:
        counted.add(value)
    exact = sorted(values)[max(0, -(-int(1000 * share) * len(values) // 1000) - 1)]
    assert exact <= counted.quantile(share) * (1 + 1e-9)
    assert counted.quantile(share) <= 1.05 * exact
