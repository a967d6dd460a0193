"""Recordings survive their way through every format, and no damaged file gets past its reader."""

from __future__ import annotations

import hashlib
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyarrow import csv, parquet
from scipy.io import loadmat, savemat, whosmat
from scipy.sparse import csc_array

from fmus.errors import TraceError
from fmus.files import atomic_write, sha256
from orchestrator.formats import FORMATS, Layout, Recording, read, write
from orchestrator.formats.arrays import mat5
from orchestrator.trace import Trace

FINITE = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=True)
EXTREMES = [-0.0, 0.0, 5e-324, -2.2e-308, 1.7976931348623157e308, -1.7976931348623157e308, 0.1, 1 / 3, 1e23]
CELL = np.array([[1.0, "a"]], dtype=object)
SQUARE = np.eye(3)
NAMES = [
    "pendulum.angle",
    "$\\theta$",
    "torque, filtered",
    'so-called "speed"',
    "größe Δ",
    "flag[3]",
    "#5",
    "7",
]


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    stamps = draw(st.lists(st.floats(-1e9, 1e9), min_size=2, max_size=12, unique=True).map(sorted))
    column = st.lists(FINITE, min_size=len(stamps), max_size=len(stamps)).map(np.array)
    names = draw(st.lists(st.sampled_from(NAMES), min_size=1, max_size=4, unique=True))
    units = draw(st.dictionaries(st.sampled_from(names), st.sampled_from(["rad", "N·m", "rad/s^2", "µm", "1"])))
    return Trace(np.array(stamps), {name: draw(column) for name in names}, units, "drawn")


def bits(values: object) -> bytes:
    return np.asarray(values, dtype=float).tobytes()


def through(trace: Trace, suffix: str) -> Recording:
    """The recording that a written trace comes back as."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "trace" + suffix)
        write(trace, path)
        return read(path)


class RoundTrip:
    """What every format must hold to; each subclass names its suffix."""

    suffix: str

    @pytest.mark.slow
    @settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.differing_executors])
    @given(trace=traces())
    def test_stamps_values_names_and_units_come_back_bit_for_bit(self, trace: Trace) -> None:
        back = through(trace, self.suffix).trace
        assert (back.names, back.units) == (trace.names, trace.units)
        assert bits(back.time) == bits(trace.time)
        assert all(bits(back[name]) == bits(trace[name]) for name in trace.names)

    def test_extreme_numbers_come_back_bit_for_bit(self) -> None:
        trace = Trace(np.arange(float(len(EXTREMES))), {"a": np.array(EXTREMES)})
        assert bits(through(trace, self.suffix).trace["a"]) == bits(EXTREMES)

    def test_missing_and_infinite_samples_come_back(self) -> None:
        values = [np.nan, np.inf, -np.inf, 1.0]
        trace = Trace(np.arange(4.0), {"a": np.array(values)})
        assert np.array_equal(through(trace, self.suffix).trace["a"], values, equal_nan=True)

    def test_one_trace_gives_the_same_bytes_at_any_time(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        trace = Trace(np.arange(3.0), {"a": np.ones(3)}, {"a": "rad"})
        write(trace, tmp_path / f"first{self.suffix}")
        monkeypatch.setattr(time, "asctime", lambda *_: "Thu Jan  1 00:00:00 1970")
        write(trace, tmp_path / f"second{self.suffix}")
        assert sha256(tmp_path / f"first{self.suffix}") == sha256(tmp_path / f"second{self.suffix}")

    def test_columns_can_be_chosen_renamed_and_given_units(self, tmp_path: Path) -> None:
        trace = Trace(np.arange(3.0), {"a": np.arange(3.0), "b": np.array([5.0, 6.0, 9.0])}, {"b": "deg"})
        write(trace, tmp_path / f"x{self.suffix}")
        layout = Layout(time=0, columns={"angle": "b", "again": 2}, units={"angle": "rad"})
        chosen = read(tmp_path / f"x{self.suffix}", layout).trace
        assert chosen["angle"].tolist() == chosen["again"].tolist() == [5.0, 6.0, 9.0]
        assert chosen.units == {"angle": "rad", "again": "deg"}

    def test_any_damage_ends_in_a_trace_error_or_a_trace(self, tmp_path: Path) -> None:
        whole, path = tmp_path / f"whole{self.suffix}", tmp_path / f"damaged{self.suffix}"
        stamps = np.linspace(0.0, 1.0, 40)
        write(Trace(stamps, {"a": np.sin(9 * stamps), "b": np.cos(stamps)}, {"a": "rad"}), whole)
        content, rng = whole.read_bytes(), np.random.default_rng(8)
        for _ in range(150):
            damaged = bytearray(content[: int(rng.integers(1, len(content) + 1))])
            for place in rng.integers(0, len(damaged), 4):
                damaged[place] = rng.integers(0, 256)
            path.write_bytes(damaged)
            try:
                read(path)
            except TraceError as error:
                assert str(path) in str(error)
                assert "\n" not in str(error)

    def test_stamps_without_signals_come_back(self) -> None:
        assert np.array_equal(through(Trace(np.arange(5.0), {}), self.suffix).trace.time, np.arange(5.0))

    def test_a_missing_file_and_a_folder_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(TraceError, match="no such file"):
            read(tmp_path / f"absent{self.suffix}")
        (tmp_path / f"folder{self.suffix}").mkdir()
        with pytest.raises(TraceError, match="is a folder"):
            read(tmp_path / f"folder{self.suffix}")

    def test_a_signal_named_time_cannot_be_written(self, tmp_path: Path) -> None:
        trace = Trace(np.arange(3.0), {"time": np.ones(3)})
        with pytest.raises(TraceError, match="named 'time'"):
            write(trace, tmp_path / f"x{self.suffix}")
        assert list(tmp_path.iterdir()) == []


class TestCsv(RoundTrip):
    suffix = ".csv"


class TestText(RoundTrip):
    suffix = ".txt"


class TestTsv(RoundTrip):
    suffix = ".tsv"


class TestMat(RoundTrip):
    suffix = ".mat"


class TestParquet(RoundTrip):
    suffix = ".parquet"

    def test_the_name_comes_back(self) -> None:
        assert through(Trace(np.arange(2.0), {}, name="bench 7"), self.suffix).trace.name == "bench 7"


def test_every_format_is_tested() -> None:
    assert {form.suffix for form in RoundTrip.__subclasses__()} == set(FORMATS)


def test_a_recording_knows_its_file_and_what_was_done_to_its_stamps(tmp_path: Path) -> None:
    path = tmp_path / "Run 3.CSV"
    path.write_bytes(b"time [ms],a [rad]\n0,1\n2,3\n1,2\n1,4\n")
    recording = read(path)
    assert recording.trace.time.tolist() == [0.0, 0.001, 0.002]
    assert recording.trace["a"].tolist() == [1.0, 4.0, 3.0]
    assert (recording.trace.name, recording.trace.units) == ("Run 3", {"a": "rad"})
    assert (recording.stamps.repeated, recording.stamps.backward) == (1, 1)
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_columns_that_are_not_wanted_may_hold_anything(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    path.write_text('\ufefftime, a ,remark\r\n0, 1.5,"start, slowly"\r\n1,,x\r\n', encoding="utf-8", newline="")
    values = read(path, Layout(columns={"a": "a"})).trace["a"]
    assert np.array_equal(values, [1.5, np.nan], equal_nan=True)


def test_a_table_without_headings_is_read_by_number_without_losing_its_first_row(tmp_path: Path) -> None:
    layout = Layout(time=0, columns={"a": 1})
    (tmp_path / "log.csv").write_text("0,1\n1,2\n")
    (tmp_path / "log.txt").write_text("0 1\n1 2\n")
    for name in ("log.csv", "log.txt"):
        assert read(tmp_path / name, layout).trace["a"].tolist() == [1.0, 2.0]


def test_headings_of_text_may_be_separated_by_blanks(tmp_path: Path) -> None:
    path = tmp_path / "log.txt"
    path.write_text("# a rig\n#time [s] a [rad]  b\n0 1 2\n1 2 3\n")
    trace = read(path).trace
    assert (trace.names, trace.units) == (("a", "b"), {"a": "rad"})


def test_a_matrix_of_matlab_is_read_by_variable_and_column_number(tmp_path: Path) -> None:
    matrix = np.column_stack([np.arange(5.0), np.arange(5) ** 2, np.ones(5)])
    savemat(tmp_path / "x.mat", {"D": matrix, "E": matrix[:, :1], "note": "hello"}, do_compression=True)
    recording = read(tmp_path / "x.mat", Layout("D", 0, {"square": 1}, {"square": "m^2"}))
    assert recording.trace["square"].tolist() == [0.0, 1.0, 4.0, 9.0, 16.0]
    assert recording.trace.unit("square") == "m^2"


@pytest.mark.parametrize("kind", ["f8", "f4", "i2", "u1", "i4", ">f8"])
@pytest.mark.parametrize("compressed", [False, True])
def test_numbers_of_a_matlab_file_are_those_that_scipy_reads(tmp_path: Path, kind: str, compressed: bool) -> None:
    matrix = np.random.default_rng(4).uniform(-100, 100, (50, 3)).astype(kind)
    matrix[:, 0] = np.arange(50)
    others = {"s": {"x": [1, 2]}, "sparse": csc_array(np.eye(3)), "c": CELL, "flag": np.array([[True]]), "t": "µ"}
    savemat(tmp_path / "x.mat", {**others, "D": matrix, "e": np.zeros((0, 0))}, do_compression=compressed)
    trace = read(tmp_path / "x.mat", Layout("D", 0, {"a": 1, "b": 2})).trace
    expected = loadmat(tmp_path / "x.mat")["D"].astype(float)
    assert bits(np.column_stack([trace.time, trace["a"], trace["b"]])) == bits(expected)


def test_every_variable_of_a_matlab_file_is_listed_as_scipy_lists_it(tmp_path: Path) -> None:
    content = {
        "D": SQUARE,
        "cell": CELL,
        "struct": {"x": 1},
        "n": np.int16(3),
        "deep": np.zeros((2, 3, 4)),
    }
    savemat(tmp_path / "x.mat", content)
    with (tmp_path / "x.mat").open("rb") as file:
        listed = [(variable.name, variable.shape, variable.kind) for variable in mat5.variables(file)]
    assert listed == whosmat(tmp_path / "x.mat")


def mat(content: dict[str, object]) -> Callable[[BinaryIO], object]:
    return lambda file: savemat(file, content)


def frame(**columns: object) -> Callable[[BinaryIO], object]:
    return lambda file: parquet.write_table(pa.table(columns), file)


TWO = Layout(time=0, columns={"a": 1})
MALFORMED: list[tuple[str, bytes | Callable[[BinaryIO], object], Layout | None, str]] = [
    ("x.csv", b"", None, "is empty"),
    ("x.csv", b"\n1,2\n", None, "names no columns, and none is surely the time"),
    ("x.csv", b"time,a\n", None, "holds no numbers"),
    ("x.csv", b"time,a\n0,1\n", None, "fewer than two distinct"),
    ("x.csv", b"time,a\n0,1\n1,abc\n2,3\n", None, "line 3, column 'a': 'abc'"),
    ("x.csv", b"time,a\n0,1\n1\n", None, "Expected 2 columns, got 1"),
    ("x.csv", b"time,a\n0,1\nnan,2\n2,3\n", None, "time stamp 2 is nan"),
    ("x.csv", b"time,a\n0,1\n,2\n2,3\n", None, "time stamp 2 is nan"),
    ("x.csv", b"time;a\n0;1\n1;2\n", Layout(separator=","), "holds no numbers"),
    (
        "x.csv",
        b"time,a,a\n0,1,2\n1,2,3\n",
        Layout(columns={"a": "a"}),
        "has 2 columns named 'a'; give the column's number",
    ),
    ("x.csv", b"time,time\n0,1\n1,2\n", None, "2 columns that may be the time: 0, 1"),
    ("x.csv", b"0,1\n1,2\n", None, "names no columns"),
    ("x.csv", b"time [V],a\n0,1\n1,2\n", None, "time is in 'V'"),
    ("x.csv", b"time,a\n0,1\n1,2\n", Layout(columns={"b": "b"}), "no column 'b'; it holds 'time', 'a'"),
    ("x.csv", b"time,a\n0,1\n1,2\n", Layout(columns={"b": 2}), "no column 2; it has 2, counted from 0"),
    ("x.csv", b"time,a\n0,1\n1,2\n", Layout(columns={"b": -1}), "no column -1"),
    ("x.csv", b"time,a\n0,1\n1,2\n", Layout(units={"b": "rad"}), "units are given for 'b'"),
    ("x.csv", b"x" * 10**6, None, "header line is longer than"),
    ("x.csv", b"time,\xff\xfe\n0,1\n", None, "not UTF-8 text, nor surely cp1252 or gbk; say its `encoding`"),
    ("x.csv", b'time,"a\n0,1\n', None, "header line: unexpected end"),
    ("x.txt", b"# time a\n", None, "holds no numbers"),
    ("x.txt", b"0 1\n1 2\n", None, "names no columns"),
    ("x.txt", b"# time a\n0 1\n1 2 3\n", None, "Expected 2 columns, got 3"),
    ("x.txt", b"# time a\n0 1\n1 zwei\n", None, "'zwei'"),
    ("x.txt", b"#" * 10**6, None, "header line is longer than"),
    ("x.txt", b"# time a\n0 1\n1 \xff\n", None, "not UTF-8"),
    ("x.mat", b"nothing of the kind", None, "not a MATLAB v5 or v7.3 file"),
    ("x.mat", b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF", None, "is damaged|needs h5py"),
    (
        "x.mat",
        b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM" + b"\x0e\0\0\0\xff\xff\xff\x7f",
        None,
        "damaged",
    ),
    ("x.mat", mat({"E": SQUARE}), Layout("D", 0, {"a": 1}), r"no variable 'D'; it holds E \(3 x 3 double\)"),
    ("x.mat", mat({"D": SQUARE, "E": SQUARE}), TWO, "holds 2 numeric matrices"),
    ("x.mat", mat({"D": CELL}), TWO, r"holds no numeric matrices and no vectors \(D \(cell of 2\)\)"),
    ("x.mat", mat({"D": CELL}), Layout("D", 0, {"a": 1}), "D: is cell of 2, not a numeric matrix"),
    ("x.mat", mat({"D": {"time": "now"}}), Layout("D", 0, {"a": 1}), "struct, not a numeric matrix"),
    ("x.mat", mat({"D": "text"}), Layout("D", 0, {"a": 1}), "char, not a numeric matrix"),
    ("x.mat", mat({"D": np.zeros((3, 3, 3))}), Layout("D", 0, {"a": 1}), "3 x 3 x 3 double"),
    ("x.mat", mat({"D": np.zeros((0, 4))}), TWO, "claims 0 x 4 values"),
    ("x.mat", mat({"D": np.ones((2, 9))}), TWO, "fewer samples than columns; transpose it"),
    ("x.mat", mat({"D": SQUARE * 1j}), TWO, r"no vectors \(D \(3 x 3 complex double\)\)"),
    ("x.mat", mat({"D": SQUARE}), Layout(time=0, columns={"a": 3}), "no column 3"),
    ("x.mat", mat({"D": SQUARE}), None, "names no columns, and none is surely the time"),
    ("x.mat", mat({"D": np.full((5, 2), np.nan)}), TWO, "time stamp 1 is nan"),
    ("x.parquet", b"PAR1 and no more", None, "not a readable Parquet file"),
    ("x.parquet", frame(x=[0.0, 1.0]), None, "no column 'time'; it holds 'x'"),
    (
        "x.parquet",
        frame(time=[0.0, 1.0], a=["x", "y"]),
        Layout(columns={"a": "a"}),
        "column 'a': holds string, not numbers",
    ),
    ("x.parquet", frame(time=[0.0, 1.0], a=[[1.0], [2.0]]), Layout(columns={"a": "a"}), "column 'a': holds list"),
    ("x.parquet", frame(time=[0.0, None], a=[1, 2]), None, "time stamp 2 is nan"),
    ("x.wav", b"RIFF", None, "format '.wav' is not known; use .csv, .mat, .parquet, .tsv, .txt, .arrows, .dat"),
]


@pytest.mark.parametrize(("name", "content", "layout", "problem"), MALFORMED)
def test_a_malformed_file_is_refused_with_one_line_that_names_it(
    tmp_path: Path,
    name: str,
    content: bytes | Callable[[BinaryIO], object],
    layout: Layout | None,
    problem: str,
) -> None:
    path = atomic_write(tmp_path / name, content)
    with pytest.raises(TraceError, match=problem) as caught:
        read(path, layout)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    assert "; " in str(caught.value)


@pytest.mark.parametrize(("name", "unit"), [("two\nlines", ""), (" padded", ""), ("", ""), ("a", "m]"), ("a", "[m")])
def test_a_heading_that_would_not_come_back_is_not_written(tmp_path: Path, name: str, unit: str) -> None:
    trace = Trace(np.arange(2.0), {name: np.zeros(2)}, {name: unit})
    for suffix in (".csv", ".txt"):
        try:
            write(trace, tmp_path / f"x{suffix}")
        except TraceError:
            assert list(tmp_path.iterdir()) == []
        else:
            assert read(tmp_path / f"x{suffix}").trace.units == trace.units


def test_the_robots_recordings_are_read_with_what_is_wrong_in_their_stamps(butterfly_data: Path) -> None:
    layout = Layout("D", 0, {"voltage": 1, "angle": 2, "speed": 3}, {"angle": "rad", "speed": "rad/s"})
    recordings = [read(path, layout) for path in sorted(butterfly_data.glob("*.mat"))]
    assert len(recordings) == 32
    assert any(not recording.stamps.clean for recording in recordings)
    for recording in recordings:
        assert 1.0e-3 < recording.stamps.mean_step < 1.3e-3
        assert np.all(np.abs(recording.trace["angle"] - 0.996) < 2.0)
        assert len(recording.trace) == recording.stamps.samples - recording.stamps.repeated


def test_the_flexible_links_recordings_are_read_by_their_header(butterfly_data: Path) -> None:
    folder = butterfly_data.parent / "flexible-link"
    if not folder.is_dir():
        pytest.skip(f"real recordings not found: {folder} (set SERVOTWIN_DATA to their folder)")
    layout = Layout(time="t", columns={"motor": "$\\theta$", "drive": "v"}, units={"motor": "count"})
    for path in folder.glob("*.txt"):
        recording = read(path, layout)
        assert recording.stamps.mean_step == pytest.approx(0.002)
        assert recording.trace.names == ("motor", "drive")


@pytest.mark.parametrize("suffix", [".parquet", ".csv"])
def test_whole_numbers_that_doubles_do_not_hold_are_noted(suffix: str, tmp_path: Path) -> None:
    numbers = pa.table({"time": [0.0, 0.1], "id": pa.array([2**60 + 1, 5]), "count": pa.array([-(2**53) + 1, 1])})
    numbers = numbers.append_column("far", pa.array([np.inf, 2.0**62]))
    file = tmp_path / f"numbers{suffix}"
    parquet.write_table(numbers, file) if suffix == ".parquet" else csv.write_csv(numbers, file)
    recording = read(file)
    assert recording.trace["far"][0] == np.inf
    assert recording.trace["id"][0] == 2.0**60 and recording.trace["count"][0] == 1 - 2.0**53
    assert recording.notes[-1] == "whole numbers beyond 2^53 are rounded, as doubles are: 'id' to 256, 'far' to 1024"


def test_columns_of_one_name_are_all_read(tmp_path: Path) -> None:
    columns = [pa.array([0.0, 0.1]), pa.array([1, 2]), pa.array([3.5, 4.5])]
    parquet.write_table(pa.Table.from_arrays(columns, names=["time", "n", "n"]), tmp_path / "twins.parquet")
    recording = read(tmp_path / "twins.parquet")
    assert {name: recording.trace[name].tolist() for name in recording.trace.names} == {"n": [1, 2], "n_2": [3.5, 4.5]}
    assert recording.notes == ("column 2, 'n', is called 'n_2'",)


def test_infinite_and_huge_doubles_are_no_whole_numbers(tmp_path: Path) -> None:
    signals = {"far": np.array([np.inf, 1.0]), "huge": np.array([1e300, 0.0]), "none": np.array([np.nan, np.nan])}
    write(Trace(np.array([0.0, 1.0]), signals), tmp_path / "far.parquet")
    assert read(tmp_path / "far.parquet").notes == ()
