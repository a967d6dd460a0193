"""The EDS or DCF of a CANopen device is a database of the process data that it maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fmus.errors import DatabaseError
from orchestrator.can.codec.decoding import trace
from orchestrator.can.database.bus import load_all
from orchestrator.can.database.database import load
from orchestrator.can.frames import Frames
from tests.support.can.canopen_devices import EDS, OBJECTS

pytestmark = pytest.mark.needs("canopen")


def file(folder: Path, text: str, name: str = "drive.eds") -> Path:
    path = folder / name
    path.write_text(text)
    return path


def frames(*lines: tuple[int, bytes]) -> Frames:
    count = len(lines)
    data = np.array([[*data.ljust(8, b"\0")] for _, data in lines], np.uint8)
    nothing = np.zeros(count, np.uint8)
    identifiers = np.array([identifier for identifier, _ in lines], np.uint32)
    length = np.array([len(data) for _, data in lines], np.uint8)
    return Frames(0.01 * np.arange(count), identifiers, nothing, nothing, length, data)


def state(word: int, position: int) -> bytes:
    return word.to_bytes(2, "little") + position.to_bytes(4, "little", signed=True)


def test_mapped_process_data_are_messages_of_the_device(tmp_path: Path) -> None:
    base = load(file(tmp_path, EDS))
    assert {message.name: (message.id, message.length, message.cycle) for message in base.messages} == {
        "RPDO3": (0x345, 7, None),
        "TPDO1": (0x180, 6, 0.02),
    }
    position, temperature = base.signal("Position_actual_value")[1], base.signal("Temperature")[1]
    assert (position.lowest, position.length, position.is_signed) == (16, 32, True)
    assert (temperature.lowest, temperature.is_float) == (8, True)  # behind a dummy of 8 bits
    assert base.signal("x3000_01")[1].lowest == 40  # not described


def test_what_a_mapping_does_not_tell_of_its_objects_is_told(tmp_path: Path) -> None:
    text = EDS.replace("DataType=4", "DataType=9")
    assert load(file(tmp_path, text)).notes == (
        "drive.eds: RPDO3: x3000_01 is taken for an unsigned number: the file does not describe it",
        "drive.eds: TPDO1: Position_actual_value is taken for an unsigned number: its type is none of numbers",
    )
    without = file(tmp_path, EDS.replace("DefaultValue=0x60640020\n", ""))
    assert load(without).message("TPDO1").length == 2
    assert "TPDO1: entry 2 of its mapping has no value; what lies from there on is left out" in load(without).notes[1]


def test_frames_of_each_node_are_a_stream_of_their_own_and_one_can_be_chosen(tmp_path: Path) -> None:
    log = frames((0x185, state(1, -7)), (0x187, state(2, 8)), (0x185, state(3, -9)))
    base = load_all(file(tmp_path, EDS))
    found = trace([log], base).trace
    assert found["node5.Position_actual_value"].tolist() == [-7, -7, -9]
    assert found["node7.Statusword"][-1] == 2
    assert trace([log], base, source=7).trace["Position_actual_value"].tolist() == [8]


def test_an_identifier_is_counted_from_what_the_eds_adds_to_the_node(tmp_path: Path) -> None:
    base = load_all(file(tmp_path, EDS.replace("$NODEID+0x180", "0x1C0 + $NODEID")))
    found = trace([frames((0x185, state(9, 9)), (0x1C5, state(1, -7)))], base).trace
    assert found["Statusword"].tolist() == [1]
    unused = load(file(tmp_path, EDS.replace("$NODEID+0x180", "$NODEID+0x80000180")))
    assert [message.name for message in unused.messages] == ["RPDO3"]


def test_a_dcf_has_its_node_and_the_values_that_it_is_set_to(tmp_path: Path) -> None:
    text = EDS.replace("DefaultValue=$NODEID+0x180", "DefaultValue=$NODEID+0x180\nParameterValue=$NODEID+0x1C0")
    path = file(tmp_path, text + "[DeviceComissioning]\nNodeID=5\n", "drive.dcf")
    assert load(path).message("TPDO1").id == 0x1C5
    assert trace([frames((0x1C5, state(1, -7)), (0x1C7, state(1, 5)))], load_all(path)).trace[
        "Statusword"
    ].tolist() == [1]


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("[DeviceInfo]\n" + OBJECTS, "maps no process data"),
        ("no section\n", "cannot be read: File contains no section headers"),
        (EDS + "[6041]\n", "cannot be read: .*already exists"),
        (EDS.replace("DataType=4", "DataType=x"), "cannot be read"),
    ],
)
def test_what_is_no_description_of_process_data_is_refused(tmp_path: Path, text: str, problem: str) -> None:
    with pytest.raises(DatabaseError, match=problem):
        load(file(tmp_path, text))
