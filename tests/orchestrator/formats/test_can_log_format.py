"""CAN logs are recordings once a database says what their frames mean: read, shown, converted and plotted."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import DatabaseError, TraceError
from orchestrator import formats
from orchestrator.can import logs
from orchestrator.can.frames import Flag, Frames, concatenated
from orchestrator.formats import Layout, can_conversion
from orchestrator.progress import silent
from orchestrator.trace import Trace
from tests.support.can.can_samples import START, all_of, any_frames, database, different, rig_frames
from tests.support.commands import servotwin

pytestmark = pytest.mark.slow  # processes, compilers or minutes of work

FORMATS = [pytest.param(form, marks=pytest.mark.needs("mf4")) if form == ".mf4" else form for form in logs.SUFFIXES]
WRITABLE = [form for form in logs.SUFFIXES if form != ".mf4" or find_spec("asammdf")]


def answer_of(*arguments: object) -> dict[str, Any]:
    """The JSON document of a command that succeeds."""
    result = servotwin(*arguments, "--json")
    assert result.exit_code == 0, result.output
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """A folder with a log of the rig in every format that can be written here, and its database."""
    for suffix in WRITABLE:
        logs.write(tmp_path / f"rig{suffix}", [rig_frames(500)])
    database(tmp_path)
    return tmp_path


@pytest.mark.parametrize("suffix", FORMATS)
def test_a_log_of_any_format_is_a_recording_with_units_and_absolute_start(rig: Path, suffix: str) -> None:
    recording = formats.read(rig / f"rig{suffix}", Layout(database=rig / "rig.dbc"))
    trace = recording.trace
    assert set(trace.names) == {"angle", "speed", "voltage"} and trace.name == "rig"
    assert trace.units == {"angle": "rad", "speed": "rad/s", "voltage": "V"}
    assert recording.start == pytest.approx(START, abs=1e-3) and recording.notes == ()
    assert trace.time[0] == 0 and trace.time[1] == pytest.approx(2e-4, abs=2e-6) and len(trace) == 1000
    assert np.flatnonzero(np.isnan(trace["voltage"])).tolist() == [0]  # Command comes after State
    at = trace.time[0::2]  # State comes on whole milliseconds
    np.testing.assert_allclose(trace["angle"][0::2], np.sin(np.round(at * 1e3) * 1e-2), atol=1e-6)


def test_signals_are_chosen_named_and_interpolated_by_the_layout(rig: Path) -> None:
    layout = Layout(database=rig / "rig.dbc", columns={"theta": "State.angle"}, units={"theta": "rad"})
    assert formats.read(rig / "rig.blf", layout).trace.names == ("theta",)
    layout = Layout(database=rig / "rig.dbc", signals=["angle", "voltage"], interpolated=["angle"])
    trace = formats.read(rig / "rig.blf", layout).trace
    assert trace.names == ("angle", "voltage")
    np.testing.assert_allclose(trace["angle"][2:-2], np.sin(trace.time[2:-2] * 10), atol=1e-5)


def test_only_frames_of_the_channel_are_taken(tmp_path: Path) -> None:
    one, other = rig_frames(100), rig_frames(100, START + 0.5)
    other = Frames(other.time, other.id, other.flags, other.channel + np.uint8(1), other.length, other.data)
    logs.write(tmp_path / "a.blf", [one, other])
    path = database(tmp_path)
    assert formats.read(tmp_path / "a.blf", Layout(database=path, channel=1)).trace.duration < 0.11
    assert formats.read(tmp_path / "a.blf", Layout(database=path)).trace.duration > 0.5
    document = answer_of("trace", "info", tmp_path / "a.blf", "--dbc", path, "--channel", 0)
    assert document["traces"][0]["to"] < 0.11
    assert answer_of("trace", "convert", tmp_path / "a.blf", tmp_path / "b.asc", "--channel", 1)["frames"] == 200


def test_a_log_without_a_database_says_what_to_give(rig: Path) -> None:
    with pytest.raises(TraceError, match=r"--dbc FILE, in a study as traces\.layout\.database"):
        formats.read(rig / "rig.blf")


@pytest.mark.parametrize("command", ["info", "plot"])
def test_a_log_that_is_not_there_is_said_to_be_missing(tmp_path: Path, command: str) -> None:
    assert "there is no such file" in servotwin("trace", command, tmp_path / "none.blf").stderr


def test_a_log_of_other_identifiers_lists_them(rig: Path) -> None:
    frames = any_frames(50)
    strange = frames[(frames.id != 256) & (frames.id != 257) & ~frames.has(Flag.ERROR | Flag.REMOTE)]
    logs.write(rig / "other.blf", [strange])
    with pytest.raises(TraceError, match=r"no frame of the database \(.*identifiers in the log: [0-9A-F]{3}"):
        formats.read(rig / "other.blf", Layout(database=rig / "rig.dbc"))
    layout = Layout(database=rig / "rig.dbc", signals=["angle"])
    with pytest.raises(TraceError, match=r"no frame with the signal angle .*identifiers in the log"):
        can_conversion.convert(rig / "other.blf", rig / "x.parquet", layout, silent)
    with pytest.raises(DatabaseError, match="angel"):
        formats.read(rig / "rig.blf", Layout(database=rig / "rig.dbc", signals=["angel"]))
    with pytest.raises(TraceError, match="units are given for 'x'"):
        formats.read(rig / "rig.blf", Layout(database=rig / "rig.dbc", units={"x": "m"}))


def test_what_was_found_is_in_the_recording(rig: Path) -> None:
    content = bytearray((rig / "rig.log").read_bytes())
    content[1000:1004] = b"????"
    (rig / "rig.log").write_bytes(content)
    with (rig / "rig.log").open("a") as file:
        file.write("(1700000001.0) can0 7FF#00 R\n")
    recording = formats.read(rig / "rig.log", Layout(database=rig / "rig.dbc"))
    told = "\n".join(recording.notes)
    assert "could not be read: byte" in told and "unknown identifiers: 7FF 1" in told
    assert recording.found["damaged"] == 1 and recording.found["unknown"] == {"7FF": 1}


@pytest.mark.parametrize("suffix", [".parquet", ".csv", ".mat", ".txt"])
def test_a_converted_log_equals_the_recording(rig: Path, suffix: str) -> None:
    document = answer_of("trace", "convert", rig / "rig.blf", rig / f"b{suffix}", "--dbc", rig / "rig.dbc")
    assert document["samples"] == 1000 and document["start"] == "2023-11-14T22:13:20.250Z"
    one = formats.read(rig / "rig.blf", Layout(database=rig / "rig.dbc")).trace
    other = formats.read(rig / f"b{suffix}").trace
    assert one.names == other.names and (suffix == ".mat" or one.units == other.units)
    np.testing.assert_allclose(one.time, other.time, atol=1e-7)
    for name in one.names:
        np.testing.assert_array_equal(one[name], other[name])


def test_a_log_of_many_batches_streams_as_it_is_read(rig: Path) -> None:
    """Messages that begin late and disorder across batches included."""
    early, late = rig_frames(40_000), rig_frames(40_000, START + 40)
    frames = concatenated([early[0::2], late])
    order = np.arange(len(frames))
    order[39_999], order[40_001] = 40_001, 39_999
    logs.write(rig / "long.blf", [frames[order]])
    layout = Layout(database=rig / "rig.dbc")
    told: list[float] = []
    done = can_conversion.convert(
        rig / "long.blf", rig / "long.parquet", layout, lambda share, doing: told.append(share)
    )
    one, other = formats.read(rig / "long.blf", layout).trace, formats.read(rig / "long.parquet").trace
    assert done.count == len(one) == len(other) and told == sorted(told) and told[-1] == 1.0
    np.testing.assert_allclose(one.time, other.time, atol=1e-7)
    np.testing.assert_array_equal(one["voltage"], other["voltage"])
    assert any("out of order" in note for note in done.notes)


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_converting_takes_no_more_memory_for_a_longer_log(rig: Path, suffix: str) -> None:
    logs.write(rig / "one.blf", [rig_frames(10_000)])
    content = (rig / "one.blf").read_bytes()

    def peak(blocks: int) -> int:
        path = rig / f"{blocks}.blf"
        path.write_bytes(content + blocks * content[144:])  # its clock jumps back each time
        tracemalloc.start()
        can_conversion.convert(path, rig / f"x{suffix}", Layout(database=rig / "rig.dbc"), silent)
        highest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return highest

    assert peak(12) < 1.3 * peak(4)


@pytest.mark.needs("mf4")
def test_frames_stay_what_they_are_from_log_to_log(rig: Path) -> None:
    frames = any_frames(300)
    logs.write(rig / "all.mf4", [frames])
    document = answer_of("trace", "convert", rig / "all.mf4", rig / "all.blf")
    assert document["frames"] == 300 and set(document["found"]["lost"]) == {"that error frames were sent"}
    answer_of("trace", "convert", rig / "all.blf", rig / "again.mf4")
    assert different(all_of(logs.read(rig / "again.mf4")), frames, "id channel length data") == []
    result = servotwin("trace", "convert", rig / "all.mf4", rig / "all.trc")
    assert result.exit_code == 0 and ".trc does not hold CAN FD frames: " in result.stdout


def test_a_csv_of_frames_is_made_without_and_one_of_signals_with_a_database(rig: Path) -> None:
    answer_of("trace", "convert", rig / "rig.blf", rig / "frames.csv")
    answer_of("trace", "convert", rig / "rig.blf", rig / "signals.csv", "--dbc", rig / "rig.dbc", "--signal", "speed")
    assert logs.is_log(rig / "frames.csv") and not logs.is_log(rig / "signals.csv")
    assert formats.read(rig / "signals.csv").trace.names == ("speed",)


@pytest.mark.parametrize("suffix", [form for form in FORMATS if form != ".csv"])
def test_a_trace_becomes_a_log_that_decodes_to_it(tmp_path: Path, suffix: str) -> None:
    time = np.linspace(0.0, 1.99, 200)
    trace = Trace(time, {"angle": np.sin(time), "speed": np.cos(time), "voltage": np.sin(3 * time)})
    formats.write(trace, tmp_path / "a.parquet")
    document = answer_of(
        "trace", "convert", tmp_path / "a.parquet", tmp_path / f"b{suffix}", "--dbc", database(tmp_path)
    )
    assert document["frames"] == 400
    back = formats.read(tmp_path / f"b{suffix}", Layout(database=tmp_path / "rig.dbc")).trace
    np.testing.assert_allclose(back["angle"], trace["angle"], atol=1e-6)
    np.testing.assert_allclose(back["voltage"], trace["voltage"], atol=5.1e-4)


def test_signals_of_components_find_theirs_in_a_database_and_others_are_named(tmp_path: Path) -> None:
    time = np.linspace(0.0, 1.0, 11)
    formats.write(Trace(time, {"hand.angle": time, "extra": time}), tmp_path / "a.parquet")
    path = database(tmp_path)
    path.write_text(path.read_text().replace("SG_ angle", "SG_ hand_angle"))
    command = ("trace", "convert", tmp_path / "a.parquet", tmp_path / "a.blf", "--dbc", path)
    assert answer_of(*command)["notes"] == [
        "not in the database: extra",
        "without a value in the recording, sent at rest: State.speed",
    ]
    back = formats.read(tmp_path / "a.blf", Layout(database=path, signals=["hand_angle"])).trace
    np.testing.assert_allclose(back["hand_angle"], time, atol=1e-6)
    formats.write(Trace(time, {"extra": time}), tmp_path / "a.parquet")
    assert "has no signal of" in servotwin(*command).stderr


def test_a_trace_becomes_no_log_without_a_database(tmp_path: Path) -> None:
    formats.write(Trace(np.arange(3.0), {"angle": np.arange(3.0)}), tmp_path / "a.parquet")
    result = servotwin("trace", "convert", tmp_path / "a.parquet", tmp_path / "a.blf")
    assert result.exit_code == 2 and "give it as --dbc FILE" in result.stderr


def test_info_tells_frames_without_and_signals_with_a_database(rig: Path) -> None:
    for command in (("info", rig / "rig.blf"), ("trace", "info", rig / "rig.blf")):
        document = answer_of(*command)
        document = document.get("traces", [document])[0]
        assert (document["frames"], document["start"]) == (1000, "2023-11-14T22:13:20.250Z")
        frames = {identifier["id"]: identifier["frames"] for identifier in document["identifiers"]}
        assert frames == {"100": 500, "101": 500}
    document = answer_of("trace", "info", rig / "rig.blf", "--dbc", rig / "rig.dbc")["traces"][0]
    assert [signal["name"] for signal in document["signals"]] == ["angle", "speed", "voltage"]
    assert document["found"]["messages"] == {"State": 500, "Command": 500}
    (rig / "cut.blf").write_bytes((rig / "rig.blf").read_bytes()[:-100])
    assert "could not be read: byte 144" in servotwin("trace", "info", rig / "cut.blf").stdout


def test_plot_shows_signals_and_what_was_found(rig: Path) -> None:
    with (rig / "rig.log").open("a") as file:
        file.write("(1700000001.0) can0 7FF#00 R\n")
    document = answer_of(
        "trace", "plot", rig / "rig.log", "--dbc", rig / "rig.dbc", "--signal", "angle", "--out", rig / "a.html"
    )
    text = Path(document["report"]).read_text()
    assert "angle" in text and "unknown identifiers" in text and "voltage" not in text


@pytest.mark.parametrize("damage", [lambda raw: raw[: len(raw) // 2], lambda raw: b"\0" * len(raw), lambda raw: b"x"])
@pytest.mark.parametrize("suffix", [suffix for suffix in logs.SUFFIXES if suffix != ".mf4"])
def test_commands_on_damaged_logs_end_with_a_message(rig: Path, suffix: str, damage: Callable[[bytes], bytes]) -> None:
    path = rig / f"rig{suffix}"
    path.write_bytes(damage(path.read_bytes()))
    for arguments in (("info", path), ("convert", path, rig / "o.parquet", "--dbc", rig / "rig.dbc")):
        result = servotwin("trace", *arguments)
        assert result.exit_code in (0, 2) and "Traceback" not in result.output
        assert result.exit_code == 0 or str(path) in result.stderr
