"""What passes between a system and a bus: units, ranges, protection, and everything that is refused beforehand."""

from __future__ import annotations

import math
import struct
import tempfile
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import InputError, ScenarioError
from orchestrator.bridge.mapping import Coupling, coupled
from orchestrator.bridge.signals.location import Place
from orchestrator.bridge.signals.outputs import SentMessage, SentSignal
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.fields import raw_limits
from orchestrator.can.database.addressing import CANOPEN
from orchestrator.can.database.database import Database
from orchestrator.can.database.database import load as load_database
from orchestrator.can.statistics import FrameStatistics
from orchestrator.crossing import NamedUnit, crossing
from orchestrator.fmi.interface import Interface, Port
from orchestrator.scenario.can_block import CanBlock
from orchestrator.system import Part, wire
from orchestrator.trace import FloatArray, Trace
from orchestrator.yaml_file import load
from tests.support.coupling_samples import DBC, frame, sample_database, sample_system
from tests.support.random_databases import databases, written

STEP = Fraction(1, 1000)
AS_IT_IS = crossing("rig.any", NamedUnit(), NamedUnit())
INPUTS = ["rig.enable", "rig.gear", "rig.label", "rig.page", "rig.target", "rig.voltage"]  # in the order of the values
FINITE = st.floats(allow_nan=False, allow_infinity=False)
SAFE = {"signal": "Command.voltage", "safe": 1.5}


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Database:
    return sample_database(tmp_path_factory.mktemp("database"))


def couple(rig: Database, **block: Any) -> Coupling:
    return coupled(CanBlock(database=rig.path, **block), sample_system(), [rig], STEP)


def sent(message: SentMessage, outputs: list[float], resting: bool = False) -> bytes:
    """The data of the next frame."""
    found = message.frame(outputs, message.signals if resting else ())
    assert found is not None
    return bytes(found.data)


def received(coupling: Coupling, *frames: tuple[int, bytes]) -> FloatArray:
    """The inputs after these frames."""
    given = np.zeros(len(INPUTS))
    for identifier, data in frames:
        coupling.reception.take(frame(identifier, data), given)
    return given


def test_received_values_come_in_the_unit_of_the_input(rig: Database) -> None:
    coupling = couple(rig, receive={"rig.voltage": SAFE, "rig.target": {"signal": "target", "safe": 0}})
    values = received(coupling, (257, struct.pack("<hH", -12345, 0)), (258, struct.pack("<d", 90.0)))
    assert values[INPUTS.index("rig.voltage")] == pytest.approx(-12.345, abs=1e-12)
    assert values[INPUTS.index("rig.target")] == pytest.approx(math.pi / 2, abs=1e-12)


def test_a_tunable_parameter_can_be_received(rig: Database) -> None:
    gain = Port("gain", 0, "Real", "parameter", "V", "0", -30.0, 30.0, variability="tunable")
    system = wire({"rig": Part(Interface("rig", "2.0", {"gain": gain}, {}))}, [], ["rig.gain"])
    coupling = coupled(CanBlock(database=rig.path, receive={"rig.gain": SAFE}), system, [rig], STEP)
    values = np.zeros(2)
    coupling.reception.take(frame(257, struct.pack("<hH", -12345, 0)), values)
    assert values[0] == pytest.approx(-12.345, abs=1e-12)


def test_safe_values_and_limits_may_have_units_of_their_own(rig: Database) -> None:
    sent_ = {"source": "rig.torque", "safe": "2500 mNm", "limit": {"magnitude": "0.003 kNm"}}
    coupling = couple(rig, receive={"rig.target": {"signal": "target", "safe": "90 deg"}}, send={"torque": sent_})
    assert coupling.reception.messages[0].signals[0].safe == pytest.approx(math.pi / 2)
    (given,) = coupling.sent[0].signals
    assert given.safe == pytest.approx(2.5) and given.magnitude == pytest.approx(3)
    with pytest.raises(InputError, match=r"can.receive.rig.target.safe: V does not fit rad"):
        couple(rig, receive={"rig.target": {"signal": "target", "safe": "1 V"}})


def test_the_latest_of_several_frames_counts(rig: Database) -> None:
    coupling = couple(rig, receive={"rig.voltage": SAFE})
    values = received(coupling, *((257, struct.pack("<hH", 1000 * k, 0)) for k in range(5)))
    assert values[INPUTS.index("rig.voltage")] == 4.0
    assert coupling.reception.statistics.messages["Command"] == 5


def test_truth_values_and_whole_numbers_can_be_received(rig: Database) -> None:
    coupling = couple(
        rig, receive={"rig.enable": {"signal": "Command.enable", "safe": 0}, "rig.gear": {"signal": "gear", "safe": 0}}
    )
    values = received(coupling, (257, struct.pack("<hH", 0, 1 | 5 << 1)))
    assert values[:2].tolist() == [1.0, 5.0]


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_leaves_the_last_one_and_is_counted(rig: Database, bad: float) -> None:
    coupling = couple(rig, receive={"rig.target": {"signal": "target", "safe": 0}})
    values = received(coupling, (258, struct.pack("<d", 180.0)), (258, struct.pack("<d", bad)))
    assert values[INPUTS.index("rig.target")] == pytest.approx(math.pi)
    assert coupling.reception.statistics.not_finite["target"] == 1


def test_frames_that_are_too_short_or_wrong_by_their_checksum_change_nothing(rig: Database) -> None:
    sender = couple(rig, send={"torque": "rig.torque"})
    good = sent(sender.sent[0], [0.25])
    receiver = couple(rig, receive={"rig.page": {"signal": "torque", "safe": 0}})
    spoilt = bytes([good[0] ^ 1]) + good[1:]
    assert received(receiver, (259, good), (259, spoilt), (259, good[:2]))[INPUTS.index("rig.page")] == 0.25
    assert receiver.reception.statistics.checksums["Guarded"] == 1
    assert receiver.reception.statistics.short["Guarded"] == 1


def test_a_page_without_the_signal_leaves_its_value(rig: Database) -> None:
    coupling = couple(rig, receive={"rig.page": {"signal": "second", "safe": 0}})
    pages = [struct.pack("<BHxxxxx", page, value) for page, value in ((1, 7), (0, 9), (5, 11))]
    assert received(coupling, *((260, data) for data in pages))[INPUTS.index("rig.page")] == 7.0
    assert coupling.reception.statistics.multiplexers["Paged"] == 1


def test_frames_of_others_change_nothing_and_are_counted(rig: Database) -> None:
    coupling = couple(rig, receive={"rig.voltage": SAFE})
    assert not received(coupling, (257, b"\0" * 4), (261, b"\1\1"), (0x7FF, b"")).any()
    assert coupling.reception.statistics.unknown == {"7FF": 1}


def test_the_sender_of_a_message_fills_in_what_protects_it(rig: Database) -> None:
    (message,) = couple(rig, send={"torque": "rig.torque"}).sent
    frames = [sent(message, [0.001 * k]) for k in range(18)]
    assert [data[2] & 15 for data in frames] == [(k + 1) % 16 for k in range(18)]
    receiver = couple(rig, receive={"rig.page": {"signal": "torque", "safe": 0}})
    received(receiver, *((259, data) for data in frames))
    assert receiver.reception.statistics.clean


@given(angle=st.floats(-100, 100), speed=st.floats(-300, 300))
def test_what_is_sent_comes_back_to_half_a_step_of_its_resolution(rig: Database, angle: float, speed: float) -> None:
    coupling = couple(rig, send={"angle": "rig.angle", "State.speed": "rig.speed"})
    values = rig.message("State").raw.decode(sent(coupling.sent[0], [angle, speed]))
    assert values["angle"] == pytest.approx(angle, abs=0.5e-4 * (1 + 1e-9))
    assert values["speed"] == pytest.approx(speed * 30 / math.pi, abs=0.05 * (1 + 1e-9))
    assert coupling.sent_statistics.clean


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(made=databases(), data=st.data())
def test_any_value_goes_into_any_message_as_the_nearest_that_it_holds(made: Any, data: st.DataObject) -> None:
    with tempfile.TemporaryDirectory() as folder:
        rig = load_database(written(made, Path(folder)))
    for message in rig.messages:
        statistics = FrameStatistics()
        signals = [signal for signal in message.signals if not signal.is_multiplexer]  # whose pages take turns
        given = [SentSignal(signal, "rig.any", place, AS_IT_IS, None) for place, signal in enumerate(signals)]
        values = data.draw(st.lists(FINITE, min_size=len(given), max_size=len(given)))
        sender, found = SentMessage(Place(None, message), given, 1, statistics), dict[str, float]()
        for _ in sender.pages:
            found |= message.raw.decode(sent(sender, values), decode_choices=False)
        for signal, value in zip(signals, values, strict=True):
            low, high = raw_limits(signal)
            raw = min(max((value - signal.offset) / signal.scale, low), high)
            slack = 1e-6 * abs(raw) + 1e-37 if signal.is_float else 0.5 + 1e-12 * abs(raw)
            nearest, slack = raw * signal.scale + signal.offset, slack * abs(signal.scale)
            assert found[signal.name] == pytest.approx(nearest, abs=slack + 1e-9 * abs(signal.offset), rel=1e-12)


@given(angle=FINITE, before=st.floats(-100, 100))
def test_a_value_beyond_the_range_is_limited_and_counted(rig: Database, angle: float, before: float) -> None:
    coupling = couple(rig, send={"angle": "rig.angle"})
    coupling.sent[0].frame([before])
    found = rig.message("State").raw.decode(sent(coupling.sent[0], [angle]))["angle"]
    assert found == pytest.approx(min(max(angle, -100.0), 100.0), abs=0.5001e-4)
    assert coupling.sent_statistics.saturated["angle"] == (abs(angle) > 100.00005)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_a_value_that_is_not_finite_is_not_sent_and_its_safe_one_where_there_is_one(rig: Database, bad: float) -> None:
    coupling = couple(rig, send={"angle": "rig.angle", "torque": {"source": "rig.torque", "safe": 0.5}})
    angle, torque = coupling.sent
    assert angle.frame([bad, 0.0]) is None
    assert sent(torque, [0.0, bad])[:2] == struct.pack("<h", 500)
    assert coupling.sent_statistics.not_finite == {"angle": 1, "torque": 1}
    assert coupling.sent_statistics.messages == {"Guarded": 1}


def test_signals_that_nobody_sends_rest_and_that_is_said(rig: Database) -> None:
    coupling = couple(rig, send={"angle": "rig.angle"})
    values = rig.message("State").raw.decode(sent(coupling.sent[0], [1.0]))
    assert (values["speed"], values["spare"]) == (0.0, 0.0)
    assert coupling.notes()[0] == "State: no `safe` value for angle: whatever happens, the last value is the last"
    assert coupling.notes()[1:] == [
        "State: speed, spare rest at the initial value, or zero, since nothing is sent there"
    ]


def test_each_message_is_on_its_channel(rig: Database, tmp_path: Path) -> None:
    """A gateway: the same message on both buses, and one that only the second one's database has."""
    (tmp_path / "drive.dbc").write_text(DBC.replace("State", "Drive").replace("speed", "rate"))
    block: dict[str, Any] = {
        "database": {0: rig.path, 1: tmp_path / "drive.dbc"},
        "receive": {
            "rig.voltage": {"signal": "Command.voltage", "safe": 0},
            "rig.gear": {"signal": "Command.gear", "safe": 0, "channel": 1},
        },
        "send": {
            "angle": "rig.angle",
            "rate": "rig.speed",
            "Guarded.torque": {"source": "rig.torque", "safe": 0, "while": ["can1.Command"]},
        },
        "channel": {"Guarded": 1},
    }
    databases = [rig, load_database(tmp_path / "drive.dbc")]
    coupling = coupled(CanBlock.model_validate(block), sample_system(), databases, STEP)
    assert [message.name for message in coupling.reception.messages] == ["can0.Command", "can1.Command"]
    assert {message.name for message in coupling.sent} == {"can0.State", "can1.Drive", "can1.Guarded"}
    (torque,) = [signal for message in coupling.sent for signal in message.signals if signal.safe is not None]
    assert torque.needs == {"rig.gear"}
    given = np.zeros(coupling.width)
    for bus, data in ((0, struct.pack("<hBx", 7000, 5 << 1)), (1, struct.pack("<hBx", 9000, 3 << 1))):
        coupling.reception.take(frame(257, data), given, bus)
    assert (given[INPUTS.index("rig.voltage")], given[INPUTS.index("rig.gear")]) == (7, 3)
    assert coupling.reception.statistics.messages == {"can0.Command": 1, "can1.Command": 1}
    assert coupling.reception.statistics.frames == 2


@pytest.mark.parametrize(
    ("changes", "problem"),
    [
        (
            {"channel": {"Command": 2}},
            r"can\.channel\.Command: is on channel 2, and 2 are given .* --channel once for each",
        ),
        ({"channel": {"Comand": 1}}, "has no message 'Comand'"),
        ({"receive": {"rig.voltage": SAFE | {"channel": 7}}}, r"can\.receive\.rig\.voltage: is on channel 7"),
        ({"send": {"Command.gear": {"source": "rig.angle"}}}, "is both received and sent"),
    ],
)
def test_a_channel_that_cannot_be_is_refused(rig: Database, changes: dict[str, Any], problem: str) -> None:
    block = CanBlock.model_validate({"database": rig.path, "receive": {"rig.voltage": SAFE}} | changes)
    with pytest.raises(InputError, match=problem):
        coupled(block, sample_system(), [rig, rig], STEP)


def test_an_initial_value_outside_its_range_is_limited_and_that_is_said(tmp_path: Path) -> None:
    path = tmp_path / "rig.dbc"
    initial = """BA_DEF_ SG_ "GenSigStartValue" FLOAT -1000000 1000000;
BA_DEF_DEF_ "GenSigStartValue" 0;
BA_ "GenSigStartValue" SG_ 256 spare 900;
BA_ "GenSigStartValue" SG_ 256 angle 5000000;
"""
    path.write_text(DBC + initial)
    coupling = couple(load_database(path), send={"angle": "rig.angle"})
    [note] = [note for note in coupling.notes() if "spare of" in note or "of spare" in note]
    assert note == "State: the initial value 440 of spare is not sent: spare has [-10, 50]"
    for count in (1, 2):
        values = load_database(path).message("State").raw.decode(sent(coupling.sent[0], [1.0]))
        assert values["spare"] == 50 and coupling.sent_statistics.unfit == {"State.spare": count}
    assert "initial values outside their range, limited: State.spare 2" in coupling.sent_statistics.lines()
    encoder = Encoder(load_database(path), ["angle"])
    encoder.encode(Trace(np.arange(3.0), {"angle": np.zeros(3)}))
    assert encoder.statistics.unfit["State.spare"] > 2


def test_the_last_frame_has_the_safe_values_and_leaves_the_others(rig: Database) -> None:
    coupling = couple(rig, send={"angle": "rig.angle", "speed": {"source": "rig.speed", "safe": 0.0}})
    coupling.sent[0].frame([1.25, 7.0])
    (last,) = coupling.sent[0].safe_frames()
    values = rig.message("State").raw.decode(bytes(last.data))
    assert (values["angle"], values["speed"]) == (pytest.approx(1.25), 0.0)
    assert couple(rig, send={"angle": "rig.angle"}).sent[0].safe_frames() == []


PAGED = {"every": {"Paged": Fraction(1, 100)}}


def test_the_frame_holds_the_page_that_the_multiplexer_asks_for(rig: Database) -> None:
    send = {
        "page": "rig.speed",
        "first": {"source": "rig.angle", "safe": 7},
        "second": {"source": "rig.torque", "safe": 9},
    }
    coupling = couple(rig, send=send, **PAGED)
    (message,) = coupling.sent
    assert [sent(message, [page, 3.0, 4.0])[:3] for page in (1, 0, 1)] == [
        struct.pack("<BH", page, value) for page, value in ((1, 4), (0, 3), (1, 4))
    ]
    assert message.frame([5, 3.0, 4.0]) is None
    assert coupling.sent_statistics.multiplexers == {"Paged": 1}
    message.frame([1, 3.0, 4.0])
    last = [bytes(frame.data[:3]) for frame in message.safe_frames()]
    assert last == [struct.pack("<BH", page, value) for page, value in ((0, 7), (1, 9), (1, 9))]


def test_pages_take_turns_where_nothing_is_sent_in_the_multiplexer(rig: Database) -> None:
    coupling = couple(rig, send={"first": "rig.angle", "second": "rig.torque"}, **PAGED)
    (message,) = coupling.sent
    assert [sent(message, [3.0, 4.0])[0] for _ in range(4)] == [0, 1, 0, 1]
    assert coupling.notes()[1:] == ["Paged: its 2 pages take turns, since nothing is sent in page"]
    one = couple(rig, send={"second": {"source": "rig.torque", "safe": 2}}, **PAGED).sent[0]
    assert [bytes(frame.data[:3]) for frame in one.safe_frames()] == [struct.pack("<BH", 1, 2)]


def test_a_can_fd_frame_is_filled_up_to_a_length_that_there_is(rig: Database) -> None:
    block = CanBlock.model_validate({"database": rig.path, "send": {"wide": "rig.angle"}, "every": {"Wide": 0.01}})
    (message,) = coupled(block, sample_system(), [rig], STEP, switched=True).sent
    frame_ = message.frame([0.5])
    assert frame_ is not None
    assert (frame_.is_fd, frame_.bitrate_switch, len(frame_.data)) == (True, True, 12)
    assert rig.message("Wide").raw.decode(bytes(frame_.data))["wide"] == 0.5


def test_periods_come_from_the_block_or_else_from_the_database(rig: Database) -> None:
    coupling = couple(rig, send={"angle": "rig.angle", "torque": "rig.torque"}, every={"Guarded": "0.004"})
    assert [message.every for message in coupling.sent] == [1, 4]


def test_values_outside_their_range_are_limited_or_refused_as_declared(rig: Database) -> None:
    limited = couple(rig, receive={"rig.voltage": SAFE})
    assert received(limited, (257, struct.pack("<hH", 29000, 0)))[INPUTS.index("rig.voltage")] == 24.0
    assert limited.reception.statistics.out_of_range["voltage"] == 1
    rejected = couple(rig, receive={"rig.voltage": SAFE | {"range": "reject"}})
    frames = [(257, struct.pack("<hH", value, 0)) for value in (9000, 29000)]
    assert received(rejected, *frames)[INPUTS.index("rig.voltage")] == 9.0


def test_a_counter_that_stands_still_makes_no_good_frame(rig: Database) -> None:
    receiver = couple(rig, receive={"rig.page": {"signal": "torque", "safe": 0}}).reception
    data = sent(couple(rig, send={"torque": "rig.torque"}).sent[0], [0.25])
    taken = [receiver.take(frame(259, data), np.zeros(7)) for _ in range(2)]
    assert [list(each.faults.values()) for each in taken if each] == [[], ["the counter stands still"]]


def test_magnitude_and_rate_of_what_is_sent_are_limited_and_counted(rig: Database) -> None:
    limit = {"rate": 100, "magnitude": 2}
    coupling = couple(rig, send={"torque": {"source": "rig.torque", "safe": 0, "limit": limit}})
    (message,) = coupling.sent
    asked = [(9.0, True), (9.0, False), (9.0, False), (9.0, False), (1.5, False), (-9.0, True), (-0.5, False)]
    found = [struct.unpack_from("<h", sent(message, [value], resting))[0] for value, resting in asked]
    assert found == [0, 1000, 2000, 2000, 1500, 0, -500]
    assert coupling.sent_statistics.limited == {"torque": 3}


def test_an_output_needs_what_leads_to_it_through_any_component_or_what_it_is_told(rig: Database) -> None:
    receive = {
        "rig.voltage": SAFE,
        "rig.gear": {"signal": "gear", "safe": 0},
        "rig.page": {"signal": "first", "safe": 0},
    }
    send = {"angle": {"source": "rig.angle", "safe": 0}}
    (given,) = couple(rig, receive=receive, send=send).sent[0].signals
    assert given.needs == set(receive)
    send["angle"] |= {"while": ["Command", "rig.page"]}
    (given,) = couple(rig, receive=receive, send=send).sent[0].signals
    assert given.needs == set(receive)
    send["angle"] |= {"while": ["gear"]}
    (given,) = couple(rig, receive=receive, send=send, stop="Other.enable").sent[0].signals
    assert given.needs == {"rig.gear", "can.stop"}


VOLTAGE = {"rig.voltage": SAFE}
REFUSED: list[tuple[dict[str, Any], str]] = [
    (
        {"receive": {"rig.voltage": {"signal": "Command.volts", "safe": 0}}},
        "{database}: message Command: has no signal 'volts'; did you mean 'voltage'?",
    ),
    (
        {"receive": {"rig.enable": {"signal": "enable", "safe": 0}}},
        "{database}: signal 'enable' is in 2 messages; write 'Command.enable' or 'Other.enable'",
    ),
    (
        {"receive": {"rig.voltage": {"signal": "angle", "safe": 0}}},
        "can.receive.rig.voltage: rad does not fit V; connect like quantities",
    ),
    (
        {"receive": {"rig.voltage": {"signal": "voltage", "safe": 31}}},
        "can.receive.rig.voltage.safe: is 31, outside its bounds [-30, 30]; choose a value inside",
    ),
    (
        {"receive": {"rig.gear": {"signal": "target", "safe": 0}}},
        "can.receive.rig.gear: target cannot drive an Integer; it takes whole numbers",
    ),
    (
        {"receive": {"rig.gear": {"signal": "gear", "safe": 0.5}}},
        "can.receive.rig.gear.safe: 0.5 is not whole; it is an Integer",
    ),
    (
        {"receive": {"rig.label": {"signal": "gear", "safe": 0}}},
        "can.receive.rig.label: a String cannot be received; set it as a start value",
    ),
    (
        {
            "receive": {
                "rig.voltage": SAFE | {"silence": 0.2},
                "rig.gear": {"signal": "gear", "safe": 0, "silence": 0.3},
            }
        },
        "can.receive.rig.gear.silence: differs from that of another signal of Command; they come and go together; "
        "give one",
    ),
    ({"send": {"angle": "rig.angel"}}, "can.send.angle: no variable 'angel' in 'rig'; did you mean 'angle'?"),
    ({"send": {"angle": "law.angle"}}, "can.send.angle: no component 'law'; there are rig"),
    (
        {"send": {"angle": "rig.voltage"}},
        "can.send.angle: 'rig.voltage' is an input; only an output can be sent; outputs there: angle, speed, torque, "
        "text",
    ),
    ({"send": {"slow": "rig.torque"}}, "can.send.slow: N.m does not fit V; connect like quantities"),
    ({"send": {"angle": "rig.text"}}, "can.send.angle: a String cannot be sent; send a number"),
    (
        {"send": {"angle": "rig.angle", "State.angle": "rig.angle"}},
        "can.send.State.angle: State.angle is sent twice; remove one",
    ),
    (
        {"send": {"Guarded.count": "rig.angle"}},
        "can.send.Guarded.count: protects Guarded and is filled in by itself; remove it",
    ),
    (
        {"send": {"target": "rig.angle"}},
        "can.every.Exact: is not given, and the database has no cycle time of it; give a period in seconds",
    ),
    (
        {"send": {"target": "rig.angle"}, "every": {"Exact": 0.0025}},
        "can.every.Exact: 0.0025 s is not a multiple of 0.001 s; use 0.002 s",
    ),
    (
        {"send": {"angle": "rig.angle"}, "every": {"Exact": 0.01}},
        "can.every.Exact: no signal is sent in it; there are State",
    ),
    (
        {"send": {"angle": {"source": "rig.angle", "safe": 500}}},
        "can.send.angle.safe: is 500 rad on the bus, and angle has [-100, 100]; choose a value inside",
    ),
    (
        {"send": {"angle": {"source": "rig.angle", "safe": 0, "while": ["Sensors"]}}, "receive": VOLTAGE},
        "can.send.angle.while: 'Sensors' is not received; there is Command",
    ),
    (
        {"receive": {"rig.voltage": {"signal": "voltage", "safe": 25}}},
        "can.receive.rig.voltage.safe: is 25, and voltage is in [-24, 24]; choose a value inside",
    ),
    (
        {"receive": VOLTAGE, "stop": "Panel.halt"},
        "{database}: has no signal 'Panel.halt'; did you mean 'Paged.page'?",
    ),
    (
        {"receive": {"rig.voltage": SAFE | {"silence": 0.01}}},
        "can: silence: is 0.01 s, and Command comes every 0.01 s; allow some periods",
    ),
    (
        {"send": {"gear": "rig.torque"}, "receive": VOLTAGE},
        "can: Command: is both received and sent; a message has one sender",
    ),
]


@pytest.mark.parametrize(("block", "message"), REFUSED)
def test_what_does_not_fit_is_refused_with_its_place(rig: Database, block: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError) as refused:
        couple(rig, **block)
    assert str(refused.value) == message.replace("{database}", str(rig.path))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("receive: {rig.voltage: {signal: voltage}}", ":2: receive.rig.voltage.safe: field required"),
        ("receive: {rig.voltage: voltage}", ":2: receive.rig.voltage: input should be"),
        ("receive: {rig.voltage: {signal: voltage, safe: .nan}}", ":2: receive.rig.voltage.safe: input should be a f"),
        ("send: {angle: {safe: 1}}", ":2: send.angle.source: field required"),
        ("silence: 0", ":2: silence: input should be greater than 0"),
        ("send: {angle: rig.angle}\nevery: {State: 0}", "a period in `every` must be positive"),
        ("send: {angle: rig.angle, angle: rig.speed}", "is not YAML (found duplicate key"),
        ("{}", "give `receive`, `send` or both"),
    ],
)
def test_a_block_that_does_not_fit_its_schema_is_refused(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "can.yaml"
    path.write_text("database: rig.dbc\n" + ("" if text == "{}" else text))
    with pytest.raises(ScenarioError) as refused:
        load(path, CanBlock)
    assert message in str(refused.value)


def test_a_message_of_any_sender_takes_no_part_in_a_bus(rig: Database) -> None:
    spec = rig.message("Command")
    anyone = rig.changed(replace(own, addressing=CANOPEN) if own is spec else own for own in rig.messages)
    with pytest.raises(InputError, match=r"can: Command: the identifier 0x101 has no sender's address"):
        couple(anyone, receive=VOLTAGE)
