"""What is sent of outputs: protected, limited, at its period, on its page, and safe in the end."""

from __future__ import annotations

import math
import struct
import tempfile
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from orchestrator.bridge.mapping import coupled
from orchestrator.bridge.signals.location import MessageLocation
from orchestrator.bridge.signals.outputs import SentMessage, SentSignal
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.fields import raw_limits
from orchestrator.can.database.database import Database
from orchestrator.can.database.database import load as load_database
from orchestrator.can.statistics import FrameStatistics
from orchestrator.scenario.can_block import CanBlock
from orchestrator.trace import Trace
from tests.support.can.coupling_samples import DBC, sample_system
from tests.support.can.mapped import AS_IT_IS, INPUTS, SAFE, STEP, couple, received, sent
from tests.support.can.random_databases import databases, written

FINITE = st.floats(allow_nan=False, allow_infinity=False)


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


@pytest.mark.slow
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
        sender, found = SentMessage(MessageLocation(None, message), given, 1, statistics), dict[str, float]()
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


def test_magnitude_and_rate_of_what_is_sent_are_limited_and_counted(rig: Database) -> None:
    limit = {"rate": 100, "magnitude": 2}
    coupling = couple(rig, send={"torque": {"source": "rig.torque", "safe": 0, "limit": limit}})
    (message,) = coupling.sent
    asked = [(9.0, True), (9.0, False), (9.0, False), (9.0, False), (1.5, False), (-9.0, True), (-0.5, False)]
    found = [struct.unpack_from("<h", sent(message, [value], resting))[0] for value, resting in asked]
    assert found == [0, 1000, 2000, 2000, 1500, 0, -500]
    assert coupling.sent_statistics.limited == {"torque": 3}


def test_the_first_value_is_as_far_from_the_safe_one_as_the_rate_allows(rig: Database) -> None:
    limit = {"rate": 100}
    coupling = couple(rig, send={"torque": {"source": "rig.torque", "safe": -1, "limit": limit}})
    (message,) = coupling.sent
    assert [struct.unpack_from("<h", sent(message, [9.0]))[0] for _ in range(3)] == [0, 1000, 2000]


def test_values_outside_their_range_are_limited_or_refused_as_declared(rig: Database) -> None:
    limited = couple(rig, receive={"rig.voltage": SAFE})
    assert received(limited, (257, struct.pack("<hH", 29000, 0)))[INPUTS.index("rig.voltage")] == 24.0
    assert limited.reception.statistics.out_of_range["voltage"] == 1
    rejected = couple(rig, receive={"rig.voltage": SAFE | {"range": "reject"}})
    frames = [(257, struct.pack("<hH", value, 0)) for value in (9000, 29000)]
    assert received(rejected, *frames)[INPUTS.index("rig.voltage")] == 9.0
