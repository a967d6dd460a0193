"""A log goes back onto a bus frame by frame, each at its own time, and how late each was is known."""

from __future__ import annotations

import json
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import BusError, DatabaseError, InputError, TraceError
from fmus.json_document import document_of
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database.database import load
from orchestrator.can.live.bus import BusSettings, opened
from orchestrator.can.live.single_encoding import SingleEncoder
from orchestrator.can.sending import replay as replaying
from orchestrator.can.sending.replay import Replay, Replayed
from orchestrator.can.sending.safe_end import Last
from orchestrator.can.sending.selection import MessageSelection
from orchestrator.can.slcan.hub import hub_process
from orchestrator.can.statistics import FrameStatistics
from orchestrator.progress import Progress, silent
from orchestrator.realtime.lateness import Lateness
from orchestrator.realtime.stopping import Stop
from tests.support.can.scripted_adapter import ScriptedAdapter, willing
from tests.support.can.wiring import HANG, command, frame, heard, joined, number

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


def replay(bus: BusSettings, log: Path, speed: float = 1.0, progress: Progress = silent, **options: Any) -> Replayed:
    return replaying.replay(Replay(log, (bus,), speed, **options), progress)


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


def test_error_frames_are_left_out_and_counted(tmp_path: Path, listener: can.BusABC) -> None:
    messages = [*stamped(3, lambda k: 0.0), can.Message(is_error_frame=True, timestamp=START)]
    done = replay(BUS, written(tmp_path / "log.asc", messages))
    assert (done.sent, done.skipped) == (3, 1)
    assert len(heard(listener, 3)) == 3


@pytest.mark.parametrize("where", ["asleep", "in a send"])
def test_a_replay_that_was_held_up_goes_on_where_it_was_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, where: str
) -> None:
    log, due = written(tmp_path / "log.blf", stamped(50, lambda k: 0.005 * k)), list[float]()

    def sleep_until(stop: Stop, deadline: float) -> None:
        due.append(deadline)
        time.sleep(0.6 * (len(due) == 11 and where == "asleep"))

    def send(bus: can.BusABC, message: can.Message) -> None:
        time.sleep(0.6 * (len(due) == 10 and where == "in a send"))

    monkeypatch.setattr("orchestrator.realtime.stopping.Stop.sleep_until", sleep_until)
    monkeypatch.setattr("orchestrator.can.sending.replay.send", send)
    done = replay(BUS, log)
    moved = [deadline - due[0] - 0.005 * k for k, deadline in enumerate(due)]
    assert moved[:11] == pytest.approx([0.0] * 11, abs=1e-6) and moved[11] > 0.2
    assert moved[-1] == pytest.approx(done.paused, abs=1e-6) and done.pauses and done.sent == 50
    assert "held up" in caplog.text and "held up" in " ".join(done.lines())


def test_what_was_due_while_an_adapter_had_no_room_is_moved_and_not_a_burst(tmp_path: Path) -> None:
    log, came = written(tmp_path / "log.blf", stamped(200, lambda k: 0.005 * k)), list[bytes]()

    def answer(line: bytes) -> bytes:
        if line[:1] == b"t":
            came.append(line)
            time.sleep(0.6 * (len(came) == 100))
        return willing(line)

    with ScriptedAdapter(answer) as adapter:
        done = replay(BusSettings("slcan", adapter.path), log)
    assert [int(line[-8:], 16) for line in came] == list(range(200))
    assert done.paused > 0.4 and done.duration > 0.995 + 0.4


def test_somebody_else_who_sends_what_is_replayed_is_told(
    tmp_path: Path, listener: can.BusABC, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    def send(bus: can.BusABC, message: can.Message) -> None:
        bus.send(message)
        listener.send(frame(99, message.arbitration_id))
        listener.send(frame(99, 0x7FF))

    monkeypatch.setattr("orchestrator.can.sending.replay.send", send)
    done = replay(BUS, written(tmp_path / "log.blf", stamped(5, lambda k: 0.01 * k)))
    assert done.foreign == ["100"]
    assert "virtual:replay: 100 is also sent by somebody else" in caplog.text


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


DATABASE = """VERSION ""
BS_:
BU_:
BO_ 256 Command: 8 Vector__XXX
 SG_ torque : 0|16@1- (0.01,0) [-100|100] "N.m" Vector__XXX
 SG_ mode : 16|8@1+ (1,0) [0|0] "" Vector__XXX
 SG_ AliveCounter : 24|4@1+ (1,0) [0|15] "" Vector__XXX
 SG_ check : 32|8@1+ (1,0) [0|255] "" Vector__XXX
BO_ 257 Sensors: 8 Vector__XXX
 SG_ angle : 0|16@1- (0.001,0) [0|0] "rad" Vector__XXX
BA_DEF_ BO_ "ChecksumSignal" STRING;
BA_DEF_ BO_ "CounterSignal" STRING;
BA_DEF_DEF_ "ChecksumSignal" "";
BA_DEF_DEF_ "CounterSignal" "";
BA_ "CounterSignal" BO_ 256 "AliveCounter";
BA_ "ChecksumSignal" BO_ 256 "check";
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    (tmp_path / "rig.dbc").write_text(DATABASE)
    return tmp_path / "rig.dbc"


def mixed(path: Path, count: int = 30) -> Path:
    """Frames of three messages in turn, the last unknown; one in ten milliseconds."""
    messages = [frame(k, (0x100, 0x101, 0x7AB)[k % 3]) for k in range(count)]
    for k, message in enumerate(messages):
        message.timestamp = START + 0.01 * k
    return written(path, messages)


@pytest.mark.parametrize(
    ("chosen", "first"),
    [
        (MessageSelection(only=["Command"]), [0, 3, 6]),
        (MessageSelection(only=["Sensors", "0x7AB"]), [1, 2, 4, 5]),
        (MessageSelection(without=["7AB", "Sensors"]), [0, 3]),
        (MessageSelection(only=["100", "101"], without=["Sensors"]), [0, 3]),
    ],
)
def test_messages_are_chosen_by_name_or_identifier(
    tmp_path: Path, rig: Path, listener: can.BusABC, deadlines: list[float], chosen: MessageSelection, first: list[int]
) -> None:
    done = replay(BUS, mixed(tmp_path / "log.blf"), database=rig, chosen=chosen)
    assert [number(message) for message in heard(listener, len(first))][: len(first)] == first
    assert done.sent + done.left_out == 30


def test_what_is_chosen_and_not_there_is_told_or_refused(tmp_path: Path, rig: Path, listener: can.BusABC) -> None:
    log = mixed(tmp_path / "log.blf")
    done = replay(BUS, log, chosen=MessageSelection(only=["0x100", "0x123"]))
    assert "the log holds no frame of 0x123" in done.lines()
    for loop in (1, None):
        with pytest.raises(InputError, match="none of the frames that are chosen, among 30"):
            replay(BUS, log, chosen=MessageSelection(only=["0x123"]), loop=loop)
    with pytest.raises(InputError, match="give --dbc"):
        replay(BUS, log, chosen=MessageSelection(only=["Command"]))
    with pytest.raises(DatabaseError, match="did you mean 'Command'"):
        replay(BUS, log, chosen=MessageSelection(without=["Comand"]), database=rig)


def test_passes_follow_each_other_at_the_mean_distance(
    tmp_path: Path, listener: can.BusABC, deadlines: list[float]
) -> None:
    done = replay(BUS, written(tmp_path / "log.blf", stamped(10, lambda k: 0.01 * k)), loop=3)
    assert [number(message) for message in heard(listener, 30)] == 3 * list(range(10))
    assert [due - deadlines[0] for due in deadlines] == pytest.approx([0.01 * k for k in range(30)], abs=1e-5)
    assert (done.sent, done.setbacks) == (30, 0)


def test_a_log_of_one_instant_is_not_repeated(tmp_path: Path, listener: can.BusABC) -> None:
    with pytest.raises(InputError, match="takes no time"):
        replay(BUS, written(tmp_path / "log.blf", stamped(3, lambda k: 0.0)), loop=None)


def test_safe_values_go_last_and_follow_what_was_sent(tmp_path: Path, rig: Path, listener: can.BusABC) -> None:
    base = load(rig).message("Command")
    encoder = SingleEncoder(base, FrameStatistics())
    messages = []
    for k in range(20):
        encoder.set(base.signal("torque"), 5.0 + k)
        encoder.set(base.signal("mode"), 3)
        message = encoder.frame()
        assert message is not None
        message.timestamp = START
        messages.append(message)
    last = Last(["Command.torque=-1.5"], ["7FF#DEAD", "18FF0003#"])
    done = replay(BUS, written(tmp_path / "log.blf", messages), database=rig, last=last)
    *_, safe, one, other = heard(listener, 23)
    values = base.raw.decode(bytes(safe.data))
    assert (values["torque"], values["mode"], values["AliveCounter"]) == (-1.5, 3, 21 % 16)
    decoder = SingleDecoder(load(rig))
    decoder.decode(safe)
    assert decoder.statistics.clean
    assert (one.arbitration_id, one.data.hex()) == (0x7FF, "dead")
    assert (other.arbitration_id, other.is_extended_id, other.dlc) == (0x18FF0003, True, 0)
    assert len(done.last) == 3 and done.sent == 20


@pytest.mark.parametrize("count", [1, 3])
def test_safe_values_go_last_after_any_signals(tmp_path: Path, rig: Path, count: int) -> None:
    log = mixed(tmp_path / "log.blf")
    with hub_process(tmp_path / "ports", 2) as hub, joined(hub.paths[1]) as other:
        bus = ["--interface", "slcan", "--channel", hub.paths[0], "--bitrate", "500000"]
        options = ["--dbc", rig, "--safe", "torque=0", "--loop", "endless"]
        with command("can", "replay", log, *bus, *options, "--json") as process:
            assert other.recv(HANG) is not None
            for _ in range(count):
                process.send_signal(signal.SIGINT)
            answer, _ = process.communicate(timeout=HANG)
        assert process.returncode == 130
        document = json.loads(answer)
        assert len(document["last"]) == 1
        latest = heard(other, document["sent"])[-1]
        assert (latest.arbitration_id, latest.data[:2]) == (0x100, bytes(2))


def test_a_safe_end_that_is_not_taken_is_an_error(tmp_path: Path, rig: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = mixed(tmp_path / "log.blf", 3)
    sent: list[can.Message] = []

    def send(bus: can.BusABC, message: can.Message) -> None:
        sent.append(message)
        if len(sent) > 3:
            raise can.CanTimeoutError("the adapter takes no more frames")

    for module in ("replay", "last_frames"):
        monkeypatch.setattr(f"orchestrator.can.sending.{module}.send", send)
    with pytest.raises(BusError, match=r"NOT followed by 100#\w+ on virtual:replay"):
        replay(BUS, log, database=rig, last=Last(["torque=0"]))


@pytest.mark.parametrize(
    ("last", "problem"),
    [
        (Last(["torque"]), "write SIGNAL=NUMBER"),
        (Last(["torque=fast"]), "write SIGNAL=NUMBER"),
        (Last(["torque=500"]), r"torque has \[-100, 100\]"),
        (Last(["torqe=0"]), "did you mean 'torque'"),
        (Last([], ["800#00"]), "is no frame"),
        (Last([], ["12#00"]), "is no frame"),
        (Last([], ["123#0"]), "is no frame"),
    ],
)
def test_a_safe_end_that_cannot_be_is_refused(tmp_path: Path, rig: Path, last: Last, problem: str) -> None:
    with pytest.raises((InputError, DatabaseError), match=problem):
        replay(BusSettings("slcan", "/dev/ttyNONE"), mixed(tmp_path / "log.blf", 3), database=rig, last=last)


def test_each_channel_goes_to_its_bus_or_all_to_one(tmp_path: Path) -> None:
    messages = stamped(9, lambda k: 0.001 * k)
    for k, message in enumerate(messages):
        message.channel = k % 3
    log = written(tmp_path / "log.blf", messages)
    buses = BusSettings("virtual", "left"), BusSettings("virtual", "right")
    with opened(buses[0]) as left, opened(buses[1]) as right:
        done = replaying.replay(Replay(log, buses))
        assert [number(message) for message in heard(left, 3)] == [0, 3, 6]
        assert [number(message) for message in heard(right, 3)] == [1, 4, 7]
        assert (done.sent, done.homeless) == (6, 3)
        done = replaying.replay(Replay(log, buses[:1]))
        assert done.sent == 9
        assert "frames of channels 0, 1, 2 went onto one bus" in done.lines()


def test_an_adapter_that_refuses_frames_has_not_sent_them(tmp_path: Path) -> None:
    log = written(tmp_path / "log.blf", stamped(9, lambda k: 0.001 * k))
    with ScriptedAdapter(lambda line: b"\a" if line.endswith(b"4") and line[:1] == b"t" else willing(line)) as adapter:
        done = replay(BusSettings("slcan", adapter.path), log)
        assert document_of(done)["sent"] == 8 and "1 frames were not sent: the adapter refused them" in done.lines()
        adapter.answer = lambda line: b"\a" if line[:1] == b"t" else willing(line)
        with pytest.raises(BusError, match=r"failed after 0 frames \(the adapter refuses all frames"):
            replay(BusSettings("slcan", adapter.path), log)


@given(st.lists(st.floats(1e-6, 100.0), min_size=1, max_size=300), st.sampled_from([0.5, 0.99, 1.0]))
def test_percentiles_of_lateness_are_right_to_five_percent(values: list[float], share: float) -> None:
    counted = Lateness()
    for value in values:
        counted.add(value)
    exact = sorted(values)[max(0, -(-int(1000 * share) * len(values) // 1000) - 1)]
    assert exact <= counted.quantile(share) * (1 + 1e-9)
    assert counted.quantile(share) <= 1.05 * exact
