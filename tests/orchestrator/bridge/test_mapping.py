"""What passes between a system and a bus: units, ranges, protection, and everything that is refused beforehand."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import InputError, ScenarioError
from orchestrator.bridge.mapping import coupled
from orchestrator.can.database.addressing import CANOPEN
from orchestrator.can.database.database import Database
from orchestrator.can.database.database import load as load_database
from orchestrator.scenario.can_block import CanBlock
from orchestrator.yaml_file import load
from tests.support.can.coupling_samples import DBC, frame, sample_system
from tests.support.can.mapped import INPUTS, SAFE, STEP, couple


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
        ("receive: {rig.voltage: {signal: voltage}}", ":2: receive.rig.voltage.safe: is missing; write `safe: 1.0`"),
        (
            "receive: {rig.voltage: voltage}",
            ":2: receive.rig.voltage: should be keys with values; such as `rig.voltage: {signal: angle, safe: 1.0}`",
        ),
        ("receive: {rig.voltage: {signal: voltage, safe: .nan}}", ":2: receive.rig.voltage.safe: input should be a f"),
        ("send: {angle: {safe: 1}}", ":2: send.angle.source: is missing; write `source: motor.speed`"),
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
