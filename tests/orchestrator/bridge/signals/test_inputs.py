"""What received signals make of inputs: units, types, the latest frame, and what changes nothing."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest

from fmus.errors import InputError
from orchestrator.assembly.wiring import wire
from orchestrator.bridge.mapping import coupled
from orchestrator.can.database.database import Database
from orchestrator.fmi.interface import Interface, Port
from orchestrator.scenario.can_block import CanBlock
from orchestrator.system import Part
from tests.support.can.coupling_samples import frame
from tests.support.can.mapped import INPUTS, SAFE, STEP, couple, received, sent


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


def test_a_counter_that_stands_still_makes_no_good_frame(rig: Database) -> None:
    receiver = couple(rig, receive={"rig.page": {"signal": "torque", "safe": 0}}).reception
    data = sent(couple(rig, send={"torque": "rig.torque"}).sent[0], [0.25])
    taken = [receiver.take(frame(259, data), np.zeros(7)) for _ in range(2)]
    assert [list(each.faults.values()) for each in taken if each] == [[], ["the counter stands still"]]
