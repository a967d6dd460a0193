"""MF4 logs as other tools write them: Vector's identifiers, lengths by code, channels from 1, files never finalized."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import TraceError
from orchestrator.can import logs
from orchestrator.can.frames import Flag
from tests.support.can.can_samples import all_of

pytestmark = [pytest.mark.slow, pytest.mark.needs("mf4")]

LENGTHS = [8, 12, 3]


def bus_log(path: Path, columns: dict[str, Any]) -> Path:
    """A log of three frames with these fields besides their stamps."""
    import asammdf
    from asammdf.blocks.source_utils import Source

    kinds = {"ID": "<u4", "DataBytes": "(64,)u1"}
    records = np.zeros(3, [(f"CAN_DataFrame.{name}", kinds.get(name, "<u1")) for name in columns])
    for name, values in columns.items():
        records[f"CAN_DataFrame.{name}"] = values
    source = Source("", "", "", Source.BUS_TYPE_CAN, Source.SOURCE_BUS)
    mdf = asammdf.MDF(version="4.10")
    mdf.header.start_time = datetime(2024, 3, 7, tzinfo=UTC)
    mdf.append(asammdf.Signal(records, np.arange(3) * 0.01, name="CAN_DataFrame", source=source))
    mdf.save(path, overwrite=True)
    mdf.close()
    return path


def test_bit_31_marks_an_extended_identifier_where_no_field_does(tmp_path: Path) -> None:
    fields = {"BusChannel": 1, "ID": [0x98FEF1FE, 0x123, 0x80000001], "DLC": 8, "DataLength": 8, "DataBytes": 7}
    frames = all_of(logs.read(bus_log(tmp_path / "a.mf4", fields)))
    assert frames.id.tolist() == [0x18FEF1FE, 0x123, 1]
    assert frames.has(Flag.EXTENDED).tolist() == [True, False, True]


def test_the_length_code_tells_the_length_where_nothing_else_does(tmp_path: Path) -> None:
    data = np.arange(192).reshape(3, 64)
    fields = {"BusChannel": 1, "ID": 0x123, "DLC": [8, 9, 3], "EDL": [0, 1, 0], "DataBytes": data}
    frames = all_of(logs.read(bus_log(tmp_path / "a.mf4", fields)))
    assert frames.length.tolist() == LENGTHS
    assert [row[:length].tolist() for row, length in zip(frames.data, LENGTHS, strict=True)] == [
        row[:length].tolist() for row, length in zip(data, LENGTHS, strict=True)
    ]


@pytest.mark.parametrize(("told", "channels"), [([1, 2, 1], [0, 1, 0]), ([0, 2, 1], [0, 2, 1])])
def test_channels_count_from_0_as_in_other_logs(tmp_path: Path, told: list[int], channels: list[int]) -> None:
    fields = {"BusChannel": told, "ID": 0x123, "DLC": 8, "DataLength": 8, "DataBytes": 7}
    log = logs.read(bus_log(tmp_path / "a.mf4", fields))
    assert all_of(log).channel.tolist() == channels
    assert log.findings.notes == (["channels are counted from 0 in this file"] if 0 in told else [])


def test_a_log_that_was_not_finalized_is_read_and_left_as_it_is(tmp_path: Path) -> None:
    path = bus_log(tmp_path / "a.mf4", {"BusChannel": 1, "ID": 5, "DLC": 8, "DataLength": 8, "DataBytes": 7})
    content = bytearray(path.read_bytes())
    content[:8], content[60:62] = b"UnFinMF ", (0x25).to_bytes(2, "little")
    path.write_bytes(content)
    log = logs.read(path)
    assert len(all_of(log)) == 3 and "did not finalize" in log.findings.notes[0]
    assert path.read_bytes() == content and [*tmp_path.iterdir()] == [path]


def test_a_measurement_without_frames_is_no_empty_log(tmp_path: Path) -> None:
    import asammdf

    time = np.arange(10) * 0.1
    mdf = asammdf.MDF(version="4.10")
    mdf.append([asammdf.Signal(np.sin(time), time, name=name, unit="rad/s") for name in ("speed", "current")])
    mdf.save(tmp_path / "a.mf4")
    mdf.close()
    with pytest.raises(TraceError, match="no CAN frames but measured channels"):
        all_of(logs.read(tmp_path / "a.mf4"))
