"""Frames of several channels, databases and senders in one log: all of them are in the trace, and apart."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fmus.errors import DatabaseError, TraceError, WiringError
from orchestrator import formats
from orchestrator.formats import Layout, Recording, can_conversion
from orchestrator.progress import silent
from tests.support.commands import servotwin

MESSAGE = 'BO_ {id} {name}: {length} Rig\n SG_ {signal} : {start}|16@1- (0.1,0) [0|0] "rad/s" Rig\n'


def dbc(folder: Path, name: str, *messages: str) -> Path:
    path = folder / f"{name}.dbc"
    path.write_text('VERSION ""\nBU_: Rig\n' + "".join(messages))
    return path


def message(name: str, identifier: int, signal: str = "speed", start: int = 0, length: int = 8) -> str:
    return MESSAGE.format(id=identifier, name=name, signal=signal, start=start, length=length)


def log(folder: Path, *frames: str) -> Path:
    """A candump log of frames `MILLISECONDS CHANNEL ID#DATA`."""
    path = folder / "run.log"
    lines = (frame.split() for frame in frames)
    path.write_text("".join(f"({1.7e9 + float(at) / 1e3:.6f}) {channel} {data}\n" for at, channel, data in lines))
    return path


def speed(value: float) -> str:
    return int(value * 10).to_bytes(2, "little").hex().upper().ljust(16, "0")


def read(path: Path, **layout: Any) -> Recording:
    """The recording, once it is seen that converting gives the same."""
    found = formats.read(path, Layout(**layout))
    done = can_conversion.convert(path, path.with_suffix(".parquet"), Layout(**layout), silent)
    assert done.notes == found.notes
    again = formats.read(path.with_suffix(".parquet")).trace
    assert again.names == found.trace.names
    for name in again.names:
        np.testing.assert_array_equal(again[name], found.trace[name])
    return found


@pytest.fixture
def twins(tmp_path: Path) -> Path:
    """A log of one message on two channels."""
    frames = [
        f"{10 * step + channel} can{channel} 123#{speed(10 + 10 * channel + step)}"
        for step in range(3)
        for channel in (0, 1)
    ]
    return log(tmp_path, *frames)


def test_a_message_that_comes_late_leaves_the_rows_before_empty_and_is_told(tmp_path: Path) -> None:
    frames = [f"{10 * step} can0 123#{speed(step)}" for step in range(100)]
    path = log(tmp_path, *frames[:60], "595 can0 124#0A00000000000000", *frames[60:])
    found = read(path, database=dbc(tmp_path, "a", message("Rig", 291), message("Fault", 292, "fault")))
    assert len(found.trace) == 101 and found.trace["speed"].max() == pytest.approx(99)
    assert np.flatnonzero(np.isfinite(found.trace["fault"]))[0] == 60
    assert found.notes == ("fault is first seen at 0.595 s: it is empty in the 60 of 101 rows before",)


def test_whole_numbers_that_doubles_do_not_hold_are_told_of_logs_too(tmp_path: Path) -> None:
    counter = message("Rig", 291, "count").replace("|16@1- (0.1,0)", "|64@1+ (1,0)")
    path = log(tmp_path, "0 can0 123#FFFFFFFFFFFFFF0F", "10 can0 123#0100000000000000")
    assert read(path, database=dbc(tmp_path, "a", counter)).notes[-1] == (
        "whole numbers beyond 2^53 are rounded, as doubles are: 'count' to 256"
    )


def test_a_recording_becomes_frames_in_the_units_of_the_database(tmp_path: Path) -> None:
    base = dbc(tmp_path, "a", message("Rig", 291) + MESSAGE.partition("\n")[2].format(signal="rest", start=32))
    source = tmp_path / "run.csv"
    source.write_text("time,speed [rpm],odd\n2026-01-02T00:00:00Z,60,1\n2026-01-02T00:00:00.5Z,120,2\n")
    done = can_conversion.convert(source, tmp_path / "run.blf", Layout(database=base), silent)
    assert done.notes == (
        "run.speed: rpm to rad/s, times 0.10472",
        "not in the database: odd",
        "without a value in the recording, sent at rest: Rig.rest",
    )
    back = formats.read(tmp_path / "run.blf", Layout(database=base))
    assert back.trace["speed"].tolist() == pytest.approx([6.3, 12.6]) and back.trace["rest"].tolist() == [0, 0]
    assert back.start == formats.read(source).start
    source.write_text("time,speed [V]\n0,60\n1,120\n")
    with pytest.raises(WiringError, match=r"run\.speed: V does not fit rad/s"):
        can_conversion.convert(source, tmp_path / "run.blf", Layout(database=base), silent)


def test_samples_that_are_missing_are_empty_cells(tmp_path: Path) -> None:
    path = log(tmp_path, f"0 can0 123#{speed(1)}", "10 can0 124#0A00000000000000")
    base = dbc(tmp_path, "a", message("Rig", 291), message("Fault", 292, "fault"))
    can_conversion.convert(path, tmp_path / "run.csv", Layout(database=base), silent)
    assert (tmp_path / "run.csv").read_text().splitlines()[1] == "0,1,"


def test_frames_with_equal_stamps_are_all_kept_and_told(tmp_path: Path) -> None:
    stamps = [0, 15, 15, 15, 31, 31, 31]
    path = log(tmp_path, *(f"{stamp} can0 123#{speed(row)}" for row, stamp in enumerate(stamps)))
    found = read(path, database=dbc(tmp_path, "a", message("Rig", 291)))
    assert found.trace["speed"].tolist() == pytest.approx(range(7))
    assert "frames of one message with equal stamps" in found.notes[0] and found.found["crowded"] == {"Rig": 4}


def test_one_identifier_on_two_channels_is_two_signals(twins: Path) -> None:
    found = read(twins, database=dbc(twins.parent, "a", message("Rig", 291)))
    assert found.trace.names == ("can0.speed", "can1.speed")
    assert found.trace["can0.speed"][-1] == pytest.approx(12) and found.trace["can1.speed"][-1] == pytest.approx(22)
    assert found.notes[0] == "message Rig comes from can0 and can1, which are kept apart as can0.speed, can1.speed"


def test_a_signal_of_two_channels_is_asked_for_with_either_or_both(twins: Path) -> None:
    base = dbc(twins.parent, "a", message("Rig", 291))
    assert read(twins, database=base, signals=["speed"]).trace.names == ("can0.speed", "can1.speed")
    assert read(twins, database=base, signals=["can1.Rig.speed"]).trace.names == ("can1.speed",)
    assert read(twins, database=base, channel=1).trace.names == ("speed",)
    named = read(twins, database=base, columns={"left": "can0.speed", "right": "can1.Rig.speed"}).trace
    assert named.names == ("left", "right") and named["right"][-1] == pytest.approx(22)
    with pytest.raises(TraceError, match=r"'speed' 2 times, as can0.speed and can1.speed; name one, or give the chan"):
        formats.read(twins, Layout(database=base, columns={"left": "speed"}))
    with pytest.raises(TraceError, match=r"can2.speed"):
        formats.read(twins, Layout(database=base, signals=["can2.speed"]))
    with pytest.raises(DatabaseError, match=r"has no signal 'can1.sped'"):
        formats.read(twins, Layout(database=base, signals=["can1.sped"]))


def test_counters_are_followed_on_each_channel(twins: Path) -> None:
    counted = message("Rig", 291) + ' SG_ alive_counter : 16|4@1+ (1,0) [0|0] "" Rig\n'
    frames = [
        f"{10 * step + channel} can{channel} 123#0000{step % 16:02X}" + "00" * 5
        for step in range(40)
        for channel in (0, 1)
    ]
    found = read(log(twins.parent, *frames), database=dbc(twins.parent, "a", counted))
    assert not {"counters", "missing", "duplicates"} & found.found.keys()


def test_several_databases_decode_one_log(tmp_path: Path) -> None:
    path = log(tmp_path, f"0 can0 123#{speed(1)}", f"5 can0 124#{speed(2)}")
    files = [dbc(tmp_path, "a", message("Rig", 291)), dbc(tmp_path, "b", message("Drive", 292, "velocity"))]
    assert read(path, database=files).trace.names == ("speed", "velocity")


def test_what_two_databases_define_differently_is_told_and_the_first_counts(tmp_path: Path) -> None:
    path = log(tmp_path, f"0 can0 123#{speed(1)}", f"5 can0 123#{speed(2)}")
    files = [dbc(tmp_path, "a", message("Rig", 291)), dbc(tmp_path, "b", message("Other", 291, "x"))]
    found = read(path, database=files)
    assert found.trace.names == ("speed",)
    assert "message Other is left out: it has the identifier 0x123 of Rig, which is used" in found.notes[0]
    with pytest.raises(DatabaseError, match="'x' is in message Other, which is left out"):
        formats.read(path, Layout(database=files, signals=["x"]))
    twice = [files[0], dbc(tmp_path, "c", message("Rig", 291))]
    assert read(path, database=twice).notes == ()


@pytest.mark.parametrize("keys", [("0", "1"), ("can0", "can1"), ("all", "1")])
def test_each_channel_may_have_its_own_database(twins: Path, keys: tuple[str, str]) -> None:
    first, second = dbc(twins.parent, "a", message("Rig", 291)), dbc(twins.parent, "b", message("Arm", 291, "rate"))
    trace = read(twins, database={keys[0]: first, keys[1]: [second]}).trace
    assert trace.names == (("rate", "speed") if keys[0] == "all" else ("speed", "rate"))
    assert trace["speed"][-1] == pytest.approx(12) and trace["rate"][-1] == pytest.approx(22)


def test_interfaces_with_names_are_channels_by_their_names(tmp_path: Path) -> None:
    frames = [f"{10 * step + place} {name} 123#{speed(step)}" for step in range(3) for place, name in enumerate("ab")]
    path, base = log(tmp_path, *frames), dbc(tmp_path, "a", message("Rig", 291))
    assert read(path, database=base).trace.names == ("a.speed", "b.speed")
    assert read(path, database=base, signals=["b.Rig.speed"]).trace.names == ("b.speed",)
    found = read(path, database={"b": base, "9": dbc(tmp_path, "c", message("Arm", 291, "rate"))})
    assert found.trace.names == ("speed",)
    assert "no frame comes over channel 9, which has a database of its own" in found.notes


def test_a_message_longer_than_the_frames_of_a_log_leaves_the_others_alone(tmp_path: Path) -> None:
    base = dbc(tmp_path, "a", message("Rig", 291), message("Long", 512, "far", 80, 12))
    rig = [f"{10 * step} can0 123#{speed(1)}" for step in range(2)]
    found = read(log(tmp_path, *rig, "15 can0 200#0102030405060708", "17 can0 123#01"), database=base)
    assert found.trace.names == ("speed",)
    assert found.notes == ("frames too short, not decoded: 2 (Rig 1, Long 1)",)


def test_the_option_dbc_repeats_and_takes_channels(twins: Path) -> None:
    files = dbc(twins.parent, "a", message("Rig", 291)), dbc(twins.parent, "b", message("Arm", 291, "rate"))
    asked = ["trace", "info", str(twins), "--dbc", f"0={files[0]}", "--dbc", f"can1={files[1]}", "--json"]
    result = servotwin(*asked)
    assert result.exit_code == 0, result.output
    names = [signal["name"] for signal in json.loads(result.stdout)["traces"][0]["signals"]]
    assert names == ["speed", "rate"]
    asked[4:7:2] = f"0={files[0]}", f"1={files[0]}"
    result = servotwin(*asked)
    assert result.exit_code == 0, result.output
    names = [signal["name"] for signal in json.loads(result.stdout)["traces"][0]["signals"]]
    assert names == ["can0.speed", "can1.speed"]


@pytest.mark.parametrize("option", ["--dbc=0=", "--dbc==a.dbc", "--dbc=", "--source=x", "--source=256"])
def test_options_of_databases_that_say_nothing_are_refused(twins: Path, option: str) -> None:
    result = servotwin("trace", "info", twins, option)
    assert result.exit_code == 2 and option.replace("=", " ", 1) in result.stderr


@pytest.mark.parametrize(
    ("frames", "layout", "reason"),
    [
        (["0 can0 124#00"], {}, "Rig: its identifier 123 is not in the log; identifiers in the log: 124"),
        (["0 can0 123#00"], {}, "Rig: 1 frames of 123 are too short for its 8 bytes"),
        ([f"0 can0 123#{speed(1)}"], {"channel": 1}, "Rig: 123 comes over another channel only"),
        ([f"0 can0 00000123#{speed(1)}"], {}, "Rig: its identifier comes as 00000123, extended only"),
        ([f"0 can0 0CF00400#{speed(1)}"], {"signals": ["rpm"]}, "another source address (--source any), as 0CF00400"),
        ([f"0 can0 0CF00400#{speed(1)}"], {"signals": ["rpm"], "source": 3}, "frames come from another source address"),
    ],
)  # fmt: skip
def test_a_refusal_says_why_a_signal_is_not_there(
    tmp_path: Path, frames: list[str], layout: dict[str, Any], reason: str
) -> None:
    base = dbc(tmp_path, "a", message("Rig", 291), message("EEC1", 0x0CF004FE | 1 << 31, "rpm"))
    asked = Layout(**{"database": base, "signals": ["speed"]} | layout)
    path, target = log(tmp_path, *frames), tmp_path / "x.csv"
    with pytest.raises(TraceError) as refused:
        formats.read(path, asked)
    assert reason in str(refused.value)
    with pytest.raises(TraceError) as refused:
        can_conversion.convert(path, target, asked, silent)
    assert reason in str(refused.value) and not target.exists()
