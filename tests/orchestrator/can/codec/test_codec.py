"""Decoding and encoding many frames at once give what cantools gives for each, whatever the layout."""

from __future__ import annotations

import math
import struct
import tempfile
from pathlib import Path
from typing import Any

import cantools
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fmus.errors import DatabaseError, TraceError
from orchestrator.can import frames
from orchestrator.can.codec import decoding
from orchestrator.can.codec.bits import BIG, LITTLE, BitField, words
from orchestrator.can.codec.decoding import Decoder
from orchestrator.can.codec.encoding import Encoder
from orchestrator.can.codec.fields import raw_limits
from orchestrator.can.codec.merging import Merger
from orchestrator.can.codec.single_decoding import SingleDecoder
from orchestrator.can.database import database
from orchestrator.can.database.bus import LogDatabase
from orchestrator.can.database.database import Database
from orchestrator.can.database.message import MessageSpec
from orchestrator.can.frames import Flag, Frames
from orchestrator.trace import Trace
from tests.support.can.can_samples import by_message
from tests.support.can.random_databases import databases, written

QUICK = settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])


def loaded(random: Any) -> Database:
    with tempfile.TemporaryDirectory() as folder:
        return database.load(written(random, Path(folder)))


def payloads(message: MessageSpec, seed: int, count: int = 40) -> Frames:
    """Frames of a message with random bytes; bytes of all zeros and all ones among them."""
    rng = np.random.default_rng(seed)
    width = 8 if message.length <= 8 else 64
    data = rng.integers(0, 256, (count, width), dtype=np.uint8)
    data[0], data[1] = 0, 255
    for signal in message.signals:
        if signal.is_multiplexer:
            known = [id for signal in message.signals for id in signal.selected_by]
            data[2:, 0] = rng.choice(known, count - 2)
    data[:, message.length :] = 0
    flags = Flag.EXTENDED * message.extended | Flag.FD * message.fd
    return Frames(
        0.01 * np.arange(count),
        np.full(count, message.id, np.uint32),
        np.full(count, flags, np.uint8),
        np.zeros(count, np.uint8),
        np.full(count, message.length, np.uint8),
        data,
    )


def same(ours: float, theirs: float) -> bool:
    return ours == theirs or (math.isnan(ours) and math.isnan(theirs))


@pytest.mark.slow
@QUICK
@given(databases(), st.integers(0, 1000))
def test_decoding_gives_the_values_of_cantools_bit_for_bit(random: Any, seed: int) -> None:
    base = loaded(random)
    for message in base.messages:
        batch, refused = payloads(message, seed), 0
        decoder = Decoder(LogDatabase(base))
        series = by_message(decoder.feed(batch))[message.name]
        for row in range(len(batch)):
            try:
                expected = message.raw.decode(batch.data[row, : message.length].tobytes(), decode_choices=False)
            except cantools.database.DecodeError:
                refused += 1
                continue
            for signal in message.signals:
                value = float(series.values[base.public_name(message, signal)][row])
                assert same(value, float(expected.get(signal.name, math.nan))), (signal, row)
        assert decoder.statistics.multiplexers[message.name] == refused


@pytest.mark.slow
@QUICK
@given(databases(), st.integers(0, 1000))
def test_one_frame_at_a_time_gives_the_same_as_many(random: Any, seed: int) -> None:
    base = loaded(random)
    for message in base.messages:
        batch = payloads(message, seed)
        many, single = Decoder(LogDatabase(base)), SingleDecoder(base)
        series = by_message(many.feed(batch))[message.name]
        for row, frame in enumerate(batch.messages()):
            values = single.decode(frame)
            assert values is None or all(same(float(series.values[name][row]), v) for name, v in values.items())
            assert values is None or len(values) == sum(np.isfinite(v[row]) for v in series.values.values())
        for name in ("frames", "messages", "unknown", "short", "multiplexers", "counters", "checksums", "missing"):
            assert getattr(many.statistics, name) == getattr(single.statistics, name)


@pytest.mark.slow
@QUICK
@given(databases(floats=False), st.integers(0, 1000))
def test_encoding_gives_the_bytes_of_cantools_and_decodes_to_what_was_sent(random: Any, seed: int) -> None:
    base = loaded(random)
    rng = np.random.default_rng(seed)
    for message in base.messages:
        sent = [signal for signal in message.signals if not signal.multiplexer]
        raws = {signal.name: np.rint(rng.uniform(*span(signal), 20)) for signal in sent}
        if "_mux" in sent[0].name:
            raws[sent[0].name] = rng.choice([id for signal in message.signals for id in signal.selected_by], 20)
        values = {signal.name: raws[signal.name] * float(signal.scale) + signal.offset for signal in sent}
        out = Encoder(base, list(values)).encode(Trace(np.arange(20.0), values))
        assert len(out) == 20
        for row in range(20):
            others = {signal.name: 0 for signal in message.signals if signal.multiplexer}
            given = others | {name: float(column[row]) for name, column in values.items()}
            assert out.data[row, : message.length].tobytes() == expected(message, given, list(others))
        back = by_message(Decoder(LogDatabase(base)).feed(out))[message.name]
        for name, column in values.items():
            np.testing.assert_allclose(back.values[name], column, rtol=1e-12, atol=1e-12)


def span(signal: database.SignalSpec) -> tuple[float, float]:
    """Raw numbers that are floats, and whose scaled values are."""
    bits = min(signal.length - signal.is_signed, 30)
    return (-(2.0**bits) if signal.is_signed else 0.0), 2.0**bits - 1


def expected(message: MessageSpec, values: dict[str, float], resting: list[str]) -> bytes:
    """cantools' bytes; signals that rest have the raw value nearest to a value of zero."""
    raw = {name: message.raw.get_signal_by_name(name).scaled_to_raw(value) for name, value in values.items()}
    for name in resting:
        signal = message.signal(name)
        low, high = BitField(0, signal.length, False, signal.is_signed, False, 1, 0).limits()
        raw[name] = int(min(max(raw[name], low), high))
    return bytes(message.raw.encode(raw, scaling=False, strict=False))


@given(st.binary(min_size=2, max_size=2), st.integers(0, 48), st.booleans())
def test_floats_of_16_bits_are_those_of_the_standard(half: bytes, lowest: int, big: bool) -> None:
    field = BitField(lowest + 15 if big else lowest, 16, big, False, True, 1, 0)
    number = int.from_bytes(half, "little") << (48 - lowest if big else lowest)
    data = np.frombuffer(number.to_bytes(8, "big" if big else "little"), np.uint8).reshape(1, 8)
    value = float(field.values(field.raw(words(data, BIG if big else LITTLE)))[0])
    assert same(value, struct.unpack("<e", half)[0])


DBC = """VERSION ""
BU_: A B
BO_ 100 State: 8 A
 SG_ angle : 0|16@1- (0.1,0) [-100|100] "rad" B
 SG_ speed : 23|16@0- (0.5,1) [0|0] "rad/s" B
BO_ 101 Command: 8 A
 SG_ voltage : 0|16@1- (0.001,0) [-24|24] "V" B
 SG_ current : 32|32@1- (1,0) [0|0] "A" B
BO_ 102 Muxed: 4 A
 SG_ page M : 0|8@1+ (1,0) [0|0] "" B
 SG_ first m0 : 8|16@1+ (1,0) [0|0] "" B
 SG_ second m1 : 8|8@1+ (1,0) [0|0] "" B
 SG_ third m1 : 16|8@1+ (1,0) [0|0] "" B
BA_DEF_ BO_ "GenMsgCycleTime" INT 0 65535;
BA_DEF_DEF_ "GenMsgCycleTime" 0;
BA_ "GenMsgCycleTime" BO_ 100 10;
SIG_VALTYPE_ 101 current : 1;
"""


@pytest.fixture
def base(tmp_path: Path) -> Database:
    path = tmp_path / "rig.dbc"
    path.write_text(DBC)
    return database.load(path)


def sent(base: Database, time: list[float], start: float = 0.0, **values: list[float]) -> Frames:
    return Encoder(base, list(values)).encode(Trace(np.array(time), {k: np.array(v) for k, v in values.items()}), start)


def test_rows_of_a_trace_are_the_stamps_of_all_messages_with_held_values(base: Database) -> None:
    commands = sent(base, [0.0, 0.03], 100.0, voltage=[1.0, 2.0], current=[0.5, 0.25])
    states = sent(base, [0.005, 0.025], 100.0, angle=[3.0, 4.0], speed=[1.0, 1.5])
    decoded = decoding.trace([frames.concatenated([commands, states])], LogDatabase(base), name="log")
    assert decoded.start == 100.0
    np.testing.assert_allclose(decoded.trace.time, [0, 0.005, 0.015, 0.025, 0.03], atol=1e-9)
    np.testing.assert_allclose(decoded.trace["angle"], [np.nan, 3, 3, 4, 4])
    np.testing.assert_allclose(decoded.trace["voltage"], [1, 1, 1, 1, 2])
    assert decoded.trace.units == {"angle": "rad", "speed": "rad/s", "voltage": "V", "current": "A"}


def test_interpolated_signals_run_linearly_between_their_frames(base: Database) -> None:
    commands = sent(base, [0.0, 0.0125], voltage=[1.0, 2.0], current=[0.0, 0.0])
    states = sent(base, [0.0, 0.02], angle=[0.0, 4.0], speed=[1.0, 1.0])
    both = frames.concatenated([commands, states[states.time != 0.01]])
    decoded = decoding.trace([both], LogDatabase(base), interpolated=["State.angle"])
    np.testing.assert_allclose(decoded.trace.time, [0, 0.0125, 0.02])
    np.testing.assert_allclose(decoded.trace["angle"], [0, 2.5, 4.0])
    np.testing.assert_allclose(decoded.trace["speed"], 1.0)


def test_only_the_asked_signals_and_channel_are_in_the_trace(base: Database) -> None:
    states = sent(base, [0.0, 0.02], angle=[0.0, 4.0])
    assert decoding.trace([states], LogDatabase(base), ["State.angle"], channel=0).trace.names == ("angle",)
    with pytest.raises(TraceError, match="no frame with the signal angle"):
        decoding.trace([states], LogDatabase(base), ["angle"], channel=1)
    with pytest.raises(DatabaseError, match="did you mean 'angle'"):
        decoding.trace([states], LogDatabase(base), ["angel"])


def test_multiplexed_signals_hold_their_own_last_value(base: Database) -> None:
    out = sent(base, [0.0, 1.0, 2.0, 3.0], first=[1, 2, 3, 4], second=[5, 6, 7, 8], third=[9, 9, 9, 9])
    assert out.data[:, 0].tolist() == [0, 1, 0, 1]
    decoded = decoding.trace([out], LogDatabase(base), ["first", "second"])
    assert decoded.trace["first"].tolist() == [1, 1, 3, 3]
    np.testing.assert_array_equal(decoded.trace["second"], [np.nan, 6, 6, 8])
    assert np.isnan(by_message(decoded.series)["Muxed"].values["second"]).tolist() == [True, False, True, False]


def test_a_multiplexer_that_is_sent_itself_says_what_the_frames_hold(base: Database) -> None:
    out = sent(base, [0.0, 1.0, 2.0], page=[1, 1, 0], first=[258, 258, 258], second=[5, 6, 7])
    assert out.data[:, :3].tolist() == [[1, 5, 0], [1, 6, 0], [0, 2, 1]]


def test_a_message_with_a_cycle_time_is_sent_in_that_cycle_and_others_at_every_row(base: Database) -> None:
    out = sent(base, [0.0, 0.004, 0.025], 5.0, angle=[1.0, 2.0, 3.0], voltage=[1.0, 2.0, 3.0])
    assert out.time[out.id == 100].tolist() == pytest.approx([5.0, 5.01, 5.02])
    assert out.time[out.id == 101].tolist() == pytest.approx([5.0, 5.004, 5.025])
    back = by_message(Decoder(LogDatabase(base)).feed(out))
    np.testing.assert_allclose(back["State"].values["angle"], [1, 2, 2])
    assert np.all(np.diff(out.time) >= 0)


def test_values_that_do_not_fit_are_limited_and_counted(base: Database) -> None:
    encoder = Encoder(base, ["voltage", "speed", "current"])
    columns = {"voltage": [30.0, -24.0, 24.0], "speed": [1e9, -1e9, 0.0], "current": [1e300, 0.1, -1e300]}
    out = encoder.encode(Trace(np.array([0.0, 0.01, 0.02]), {k: np.array(v) for k, v in columns.items()}))
    back = by_message(Decoder(LogDatabase(base)).feed(out))
    np.testing.assert_allclose(back["Command"].values["voltage"], [24, -24, 24])
    np.testing.assert_allclose(back["State"].values["speed"], [16384.5, -16383, 0])
    assert np.isfinite(back["Command"].values["current"]).all()
    assert encoder.statistics.saturated == {"voltage": 1, "speed": 2, "current": 2}


@pytest.mark.parametrize(("signed", "low", "high"), [(False, 0, 255), (True, -128, 127)])
def test_a_value_counts_as_limited_when_its_nearest_raw_number_does_not_fit(signed: bool, low: int, high: int) -> None:
    field = BitField(0, 8, False, signed, False, 0.5, 3.0)
    raw = np.array([low - 0.6, low - 0.4, low, high, high + 0.4, high + 0.6])
    bits, limited = field.encoded(0.5 * raw + 3.0, *field.limits())
    assert limited.tolist() == [True, False, False, False, False, True]
    assert field.values(bits).tolist() == [0.5 * nearest + 3.0 for nearest in [low] * 3 + [high] * 3]


def test_a_long_log_is_decoded_in_chunks_with_nothing_lost_between_them(
    base: Database, monkeypatch: pytest.MonkeyPatch
) -> None:
    time, signals = [0.01 * k for k in range(20)], {name: [float(k) for k in range(20)] for name in ("angle", "first")}
    batch = sent(base, time, **signals)
    whole = by_message(Decoder(LogDatabase(base)).feed(batch))
    monkeypatch.setattr(decoding, "CHUNK", 7)
    decoder = Decoder(LogDatabase(base))
    chunked = by_message(decoder.feed(batch))
    assert decoder.statistics.frames == len(batch) == 40
    assert chunked.keys() == whole.keys() == {"State", "Muxed"}
    for name, series in whole.items():
        np.testing.assert_array_equal(chunked[name].time, series.time)
        for signal, values in series.values.items():
            np.testing.assert_array_equal(chunked[name].values[signal], values)


@pytest.mark.parametrize(
    ("scale", "span", "limits"),
    [
        ("0.5", "0.3|2.2", (1, 4)),  # 0.5 to 2.0
        ("0.5", "-0.5|1e9", (0, 255)),
        ("-0.5", "-2.2|-0.3", (1, 4)),
        ("0.1", "0.3|0.7", (3, 7)),  # whatever 0.3 / 0.1 is in floats
        ("1", "0.2|0.8", (0, 255)),  # no raw number lies within
    ],
)
def test_raw_numbers_stand_for_values_within_the_range(
    tmp_path: Path, scale: str, span: str, limits: tuple[float, float]
) -> None:
    path = tmp_path / "one.dbc"
    path.write_text(f'BU_: A B\nBO_ 1 One: 1 A\n SG_ x : 0|8@1+ ({scale},0) [{span}] "" B\n')
    _, signal = database.load(path).signal("x")
    assert raw_limits(signal) == limits


def test_a_frame_that_comes_twice_counts_once_also_between_two_feeds(base: Database) -> None:
    decoder, batch = Decoder(LogDatabase(base)), sent(base, [0.0, 1.0], voltage=[1.0, 2.0])
    other = sent(base, [0.0, 1.0], voltage=[1.0, 3.0])[1:]  # at the same time, but not the same frame
    values = [
        by_message(decoder.feed(part))["Command"].values["voltage"].tolist()
        for part in (batch, frames.concatenated([batch[1:], other]))
    ]
    assert values == [pytest.approx([1.0, 2.0]), pytest.approx([3.0])]
    assert decoder.feed(other) == {}
    assert decoder.statistics.duplicates == {"Command": 2}


def test_a_value_that_is_no_number_is_not_sent(base: Database) -> None:
    with pytest.raises(TraceError, match=r"voltage: is not finite at t = 0.5 s \(1 samples\)"):
        sent(base, [0.0, 0.5], voltage=[1.0, math.nan])


def test_no_frame_is_lost_when_the_clock_is_set_back(base: Database) -> None:
    first = sent(base, [0.0, 1.0, 2.0], 5000.0, voltage=[1, 2, 3])
    later = sent(base, [0.0, 1.0, 2.0], 40.0, voltage=[4, 5, 6])
    decoded = decoding.trace([frames.concatenated([first, later])], LogDatabase(base), ["voltage"])
    np.testing.assert_allclose(decoded.trace["voltage"], [1, 2, 3, 4, 5, 6])
    np.testing.assert_allclose(decoded.trace.time, [0, 1, 2, 2, 3, 4], atol=1e-5)
    assert [str(setback) for setback in decoded.statistics.setbacks] == ["at frame 3 from 5002.000000 s to 40.000000 s"]


def test_a_float_signal_that_is_no_number_is_counted_and_the_last_value_held(base: Database) -> None:
    out = sent(base, [0.0, 1.0, 2.0], voltage=[1, 2, 3], current=[0.5, 1.5, 2.5])
    out.data[1, 4:] = np.frombuffer(np.float32(np.nan).tobytes(), np.uint8)
    decoded = decoding.trace([out], LogDatabase(base))
    assert decoded.trace["current"].tolist() == [0.5, 0.5, 2.5]
    assert decoded.statistics.not_finite == {"current": 1}


def test_frames_of_a_wrong_length_are_counted_and_only_longer_ones_decoded(base: Database) -> None:
    out = sent(base, [0.0, 1.0, 2.0], first=[1, 2, 3])
    out.length[0], out.length[1] = 3, 8
    decoded = decoding.trace([out], LogDatabase(base))
    assert (decoded.statistics.short, decoded.statistics.long) == ({"Muxed": 1}, {"Muxed": 1})
    assert decoded.trace["first"].tolist() == [2, 3]


def test_error_remote_and_unknown_frames_are_counted(base: Database) -> None:
    out = sent(base, [0.0, 1.0, 2.0, 3.0, 4.0], voltage=[1, 2, 3, 4, 5])
    out.flags[0], out.flags[1] = Flag.ERROR, Flag.REMOTE
    out.id[2], out.flags[3] = 0x7AB, Flag.EXTENDED
    decoder = Decoder(LogDatabase(base))
    series = by_message(decoder.feed(out))
    assert decoder.statistics.errors == decoder.statistics.remotes == 1
    assert decoder.statistics.unknown == {"7AB": 1, "00000065": 1}
    assert series["Command"].values["voltage"].tolist() == [5.0]
    assert decoder.statistics.frames == 5


@given(st.integers(0, 10**6), st.integers(1, 400), st.booleans())
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_frame_is_refused_with_an_exception_and_each_is_accounted_for(
    base: Database, seed: int, count: int, fd: bool
) -> None:
    rng = np.random.default_rng(seed)
    width = 64 if fd else 8
    time = rng.choice([0.0, 1.0, -5.0, 1e18, math.nan, math.inf, 1.7e9, 3.5], count) + rng.normal(size=count)
    batch = Frames(
        time,
        rng.choice([100, 101, 102, 103, 2047, 2048, 2**29 - 1, 2**32 - 1], count).astype(np.uint32),
        rng.integers(0, 128, count).astype(np.uint8),
        rng.integers(0, 256, count).astype(np.uint8),
        rng.integers(0, width + 1, count).astype(np.uint8),
        rng.integers(0, 256, (count, width)).astype(np.uint8),
    )
    decoder = Decoder(LogDatabase(base))
    parts = [decoder.feed(batch[begin : begin + 100]) for begin in range(0, count, 100)]
    statistics = decoder.statistics
    accounted = statistics.errors + statistics.remotes + statistics.unknown.total() + statistics.messages.total()
    assert accounted == statistics.frames == count
    decoded = sum(len(series) for part in parts for series in part.values())
    assert decoded == statistics.messages.total() - statistics.short.total() - statistics.duplicates.total()
    merger = Merger(["angle", "voltage"])
    rows = [merger.feed(part) for part in parts] + [merger.finish()]
    for name in ("angle", "voltage"):
        known = np.isfinite(np.concatenate([trace[name] for trace in rows]))
        assert np.all(known[1:] >= known[:-1])  # once seen it is held
    assert statistics.document()["frames"] == count
