"""Files of named arrays and workbooks: a vector a channel, structures, groups; nothing in them is run or followed."""

from __future__ import annotations

import datetime
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas
import pytest
from scipy.io import savemat

from fmus.errors import TraceError
from orchestrator.formats import READ, Layout, read, write
from orchestrator.trace import Trace

TIME = np.arange(20) * 0.01
SPEED = np.sin(TIME)
BEGIN = datetime.datetime(2026, 11, 28, 9, 15)


def v5(path: Path, content: dict[str, Any]) -> None:
    savemat(path, content, do_compression=True)


def v73(path: Path, content: dict[str, Any]) -> None:
    """As MATLAB writes it: dimensions the other way round, classes as attributes, texts as numbers of letters."""
    import h5py

    def put(group: Any, name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, part in value.items():
                put(group.require_group(name), key, part)
            group[name].attrs["MATLAB_class"] = np.bytes_(b"struct")
        elif isinstance(value, np.ndarray) and value.dtype.names:
            for field in value.dtype.names:
                cells = []
                for number, one in enumerate(value[field]):
                    put(group.file.require_group("#refs#"), f"{name}{field}{number}", one)
                    cells.append(group.file["#refs#"][f"{name}{field}{number}"].ref)
                group.require_group(name)[field] = np.array([cells], dtype=h5py.ref_dtype)
        else:
            letters = isinstance(value, str)
            numbers = (
                np.array([list(map(ord, value))], dtype="u2")
                if letters
                else np.atleast_2d(np.asarray(value, dtype=float))
            )
            group[name] = numbers.T
            group[name].attrs["MATLAB_class"] = np.bytes_(b"char" if letters else b"double")

    with h5py.File(path, "w", userblock_size=512) as file:
        for key, value in content.items():
            put(file, key, value)
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


MATLAB = [v5, pytest.param(v73, marks=pytest.mark.needs("formats"))]


def records(**fields: list[Any]) -> np.ndarray[Any, Any]:
    """A struct array."""
    rows = list(zip(*fields.values(), strict=True))
    return np.array(rows, dtype=[(name, "O") for name in fields])


@pytest.mark.parametrize("save", MATLAB)
@pytest.mark.parametrize("shape", [(1, 20), (20, 1)])
def test_a_vector_a_channel_is_a_recording(tmp_path: Path, save: Callable[..., None], shape: tuple[int, int]) -> None:
    save(tmp_path / "x.mat", {"time": TIME.reshape(shape), "speed": SPEED.reshape(shape), "gain": 3.0})
    recording = read(tmp_path / "x.mat")
    assert recording.trace == Trace(TIME, {"speed": SPEED}, name="x")
    assert recording.notes == ("column 'gain' holds 1 samples where the time has 20 and is left out",)
    layout = Layout(time="time", columns={"n": "speed"})
    assert read(tmp_path / "x.mat", layout).trace["n"].tolist() == SPEED.tolist()
    with pytest.raises(TraceError, match=r"time: is one channel; leave `variable` out|has no column 1"):
        read(tmp_path / "x.mat", Layout("time", 0, {"torque": 1}))


@pytest.mark.parametrize("save", MATLAB)
def test_a_capture_is_its_curves_over_their_axes(tmp_path: Path, save: Callable[..., None]) -> None:
    capture = {
        "X": records(Name=["", ""], Data=[TIME, TIME * 2], Unit=["s", "s"]),
        "Y": records(Name=["Model/speed", "Model/slow"], Data=[SPEED, -SPEED], Unit=["rpm", "V"], XIndex=[1.0, 2.0]),
        "Description": "first try",
    }
    save(tmp_path / "x.mat", {"exp_001": capture})
    recording = read(tmp_path / "x.mat")
    assert recording.trace == Trace(TIME, {"Model/speed": SPEED}, {"Model/speed": "rpm"}, "x")
    assert any("'Model/slow' holds 20 samples at the stamps of 'time_2'" in note for note in recording.notes)
    other = read(tmp_path / "x.mat", Layout(time="time_2")).trace
    assert other == Trace(TIME * 2, {"Model/slow": -SPEED}, {"Model/slow": "V"}, "x")


@pytest.mark.parametrize("save", MATLAB)
@pytest.mark.parametrize("name", ["", "elapsed"])
def test_the_axis_of_a_capture_may_be_in_milliseconds(tmp_path: Path, save: Callable[..., None], name: str) -> None:
    axis = records(Name=[name, "other"], Data=[TIME * 1000, TIME], Unit=["ms", "s"])
    curves = records(Name=["n", "slow"], Data=[SPEED, -SPEED], Unit=["rpm", "V"], XIndex=[1.0, 2.0])
    save(tmp_path / "x.mat", {"exp_001": {"X": axis, "Y": curves}})
    assert np.allclose(read(tmp_path / "x.mat").trace.time, TIME, rtol=1e-12)


@pytest.mark.parametrize("save", MATLAB)
def test_a_structure_with_time_is_its_signals(tmp_path: Path, save: Callable[..., None]) -> None:
    both = np.column_stack([SPEED, -SPEED])
    save(
        tmp_path / "x.mat",
        {"out": {"time": TIME, "signals": records(label=["n", "phi"], values=[SPEED, both.tolist()])}},
    )
    trace = read(tmp_path / "x.mat").trace
    if save is v5:
        assert trace == Trace(TIME, {"n": SPEED, "phi_0": SPEED, "phi_1": -SPEED}, name="x")
    assert trace["n"].tolist() == SPEED.tolist()


def test_what_is_no_channel_is_left_out_and_told(tmp_path: Path) -> None:
    odd = {"z": TIME + 1j, "cube": np.zeros((20, 2, 2)), "c": np.array([SPEED, 1.0], dtype=object), "name": "run 1"}
    told = ("'z' holds 1 x 20 complex double", "'cube' holds 20 x 2 x 2 double", "'c' holds cell of 2")
    savemat(tmp_path / "x.mat", {"time": TIME, "speed": SPEED, **odd})
    savemat(tmp_path / "m.mat", {"D": np.column_stack([TIME, SPEED]), **odd})
    for recording in (read(tmp_path / "x.mat"), read(tmp_path / "m.mat", Layout(time=0))):
        (name,) = recording.trace.names
        assert recording.trace[name].tolist() == SPEED.tolist()
        for what in told:
            assert any(f"{what} and is left out" in note for note in recording.notes)
        assert not any("'name'" in note for note in recording.notes)


@pytest.mark.parametrize("save", [*MATLAB, lambda file, content: np.savez(file.with_suffix(".npz"), **content)])
def test_the_columns_of_a_matrix_beside_a_time_are_channels(tmp_path: Path, save: Callable[..., None]) -> None:
    save(tmp_path / "x.mat", {"tout": TIME, "yout": np.column_stack([SPEED, -SPEED])})
    (file,) = tmp_path.iterdir()
    assert read(file).trace == Trace(TIME, {"yout_0": SPEED, "yout_1": -SPEED}, name="x")


def test_structures_without_end_and_fields_that_are_not_there_are_refused(tmp_path: Path) -> None:
    deep: Any = TIME
    for _ in range(40):
        deep = {"a": deep}
    savemat(tmp_path / "x.mat", {"s": deep})
    with pytest.raises(TraceError, match="too deep inside each other"):
        read(tmp_path / "x.mat")


def test_arrays_of_numpy_are_read_and_pickles_never_loaded(tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self) -> Any:
            return Path.touch, (tmp_path / "sprung",)

    np.savez_compressed(tmp_path / "x.npz", t=TIME, speed=SPEED, trap=np.array([Trap()], dtype=object))
    recording = read(tmp_path / "x.npz")
    assert recording.trace == Trace(TIME, {"speed": SPEED}, name="x")
    assert not (tmp_path / "sprung").exists()
    np.save(tmp_path / "x.npy", np.array(list(zip(TIME, SPEED, strict=True)), dtype=[("time", "f8"), ("n", "f8")]))
    assert read(tmp_path / "x.npy").trace == Trace(TIME, {"n": SPEED}, name="x")
    np.savez(tmp_path / "d.npz", time=np.datetime64(BEGIN, "us") + (TIME * 1e6).astype("m8[us]"), n=SPEED)
    assert read(tmp_path / "d.npz").start == pandas.Timestamp(BEGIN, tz="UTC").timestamp()


def test_stamps_of_numpy_that_are_missing_are_refused_and_durations_are_times(tmp_path: Path) -> None:
    instants = np.datetime64(BEGIN, "us") + (TIME * 1e6).astype("m8[us]")
    for lost in (np.datetime64("NaT"), np.datetime64("0001-01-01")):
        np.savez(tmp_path / "x.npz", time=np.append(instants[:-1], lost), n=SPEED)
        with pytest.raises(TraceError, match="1 time stamps are missing, or before 1678"):
            read(tmp_path / "x.npz")
    np.savez(tmp_path / "x.npz", time=np.round(TIME * 1e6).astype("m8[us]"), n=SPEED)
    assert read(tmp_path / "x.npz").trace == Trace(TIME, {"n": SPEED}, name="x")


@pytest.mark.needs("formats")
def test_formulas_without_values_are_told(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    for row in (["time", "n", "twice"], [0, 1.5, "=2*B2"], [1, 2.5, "=2*B3"]):
        book.active.append(row)
    book.save(tmp_path / "x.xlsx")
    (note,) = read(tmp_path / "x.xlsx").notes
    assert note.startswith("has no value of twice; those of formulas come when")


@pytest.mark.needs("formats")
def test_packed_numbers_of_hdf5_are_what_they_stand_for(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["time"], file["packed"] = TIME, np.arange(20, dtype="i2")
        file["packed"].attrs.update({"scale_factor": 0.5, "add_offset": [-10.0], "_FillValue": np.int16(3)})
    packed = read(tmp_path / "x.h5").trace["packed"]
    assert np.array_equal(packed, np.where(np.arange(20) == 3, np.nan, np.arange(20) / 2 - 10), equal_nan=True)


def test_an_array_that_claims_more_than_it_holds_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.npz", "w") as archive:
        head = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000,), }".ljust(117) + b"\n"
        archive.writestr("time.npy", b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head)
    with pytest.raises(TraceError, match="an array claims 1000000000000 values"):
        read(tmp_path / "x.npz")


@pytest.mark.needs("formats")
def test_links_and_storage_outside_of_an_hdf5_file_are_left_alone(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "other.h5", "w") as other:
        other["secret"] = SPEED
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["time"], file["n"] = TIME, SPEED
        file["n"].attrs["unit"] = "rpm"
        file["linked"] = h5py.ExternalLink("other.h5", "secret")
        file["soft"] = h5py.SoftLink("/n")
        file.create_dataset("raw", (20,), "u1", external=[("/etc/passwd", 0, 20)])
        virtual = h5py.VirtualLayout((20,), "f8")
        virtual[:] = h5py.VirtualSource(str(tmp_path / "other.h5"), "secret", (20,))
        file.create_virtual_dataset("virtual", virtual)
        file.create_dataset("bomb", (10**12,), "f8", chunks=(10**6,), compression="gzip")
        file["loop"] = file["/"]
    with pytest.raises(TraceError, match="too many things inside each other"):
        read(tmp_path / "x.h5")
    with h5py.File(tmp_path / "x.h5", "r+") as file:
        del file["loop"]
    assert read(tmp_path / "x.h5").trace == Trace(TIME, {"n": SPEED}, {"n": "rpm"}, "x")


@pytest.mark.needs("formats")
def test_groups_of_tdms_that_share_their_sampling_are_read_together(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    even = {"wf_increment": 0.5}
    with TdmsWriter(tmp_path / "x.tdms") as file:
        file.write_segment([ChannelObject(group, "n", k * SPEED, properties=even) for k, group in enumerate("ab", 1)])
    trace = read(tmp_path / "x.tdms").trace
    assert trace == Trace(0.5 * np.arange(len(SPEED)), {"a/n": SPEED, "b/n": 2 * SPEED}, name="x")


@pytest.mark.needs("formats")
def test_channels_of_tdms_are_read_by_group_with_their_units_and_waveforms(tmp_path: Path) -> None:
    from nptdms import ChannelObject, TdmsWriter

    began = np.datetime64("2026-03-01T12:00:00.25")
    wave = {"wf_start_time": began, "wf_increment": 0.01, "wf_start_offset": 0.0, "unit_string": "rpm"}
    with TdmsWriter(tmp_path / "x.tdms") as file:
        file.write_segment([ChannelObject("daq", "n", SPEED, wave), ChannelObject("slow", "T", SPEED[:5], {})])
        file.write_segment([ChannelObject("slow", "t", TIME[:5], {"unit_string": "ms"})])
    recording = read(tmp_path / "x.tdms")
    assert recording.trace == Trace(TIME, {"n": SPEED}, {"n": "rpm"}, "x")
    assert recording.start == pandas.Timestamp(began, tz="UTC").timestamp()
    assert read(tmp_path / "x.tdms", Layout(variable="slow")).trace == Trace(
        TIME[:5] * 1e-3, {"T": SPEED[:5]}, name="x"
    )
    with pytest.raises(TraceError, match="has no group 'fast'; it holds 'daq', 'slow'"):
        read(tmp_path / "x.tdms", Layout(variable="fast"))


@pytest.mark.needs("formats")
def test_a_sheet_is_read_with_its_units_dates_and_flags(tmp_path: Path) -> None:
    import openpyxl

    book = openpyxl.Workbook()
    sheet = book.active
    rows: list[list[Any]] = [["Run 3"], ["Timestamp", "n", "on", "twice"], ["", "rpm", "", ""]]
    rows += [[BEGIN + datetime.timedelta(milliseconds=20 * k), 1.5 * k, k > 1, f"=B{k}*2"] for k in range(4)]
    for row in rows:
        sheet.append(row)
    book.create_sheet("empty")
    book.save(tmp_path / "x.xlsx")
    recording = read(tmp_path / "x.xlsx")
    assert "its sheet 'Sheet' is read, not 'empty'" in recording.notes
    frame = pandas.read_excel(tmp_path / "x.xlsx", skiprows=[0, 2])
    assert recording.trace["n"].tolist() == frame["n"].tolist() and recording.trace.units == {"n": "rpm"}
    assert recording.trace["on"].tolist() == [0, 0, 1, 1]
    assert np.isnan(recording.trace["twice"]).all()
    assert recording.trace.time == pytest.approx([0, 0.02, 0.04, 0.06], abs=3e-6)
    assert recording.start == pytest.approx(pandas.Timestamp(BEGIN, tz="UTC").timestamp(), abs=3e-6)
    book["empty"].append(["time", "n"])
    book["empty"].append([0, 1])
    book["empty"].append([1, 2])
    book.save(tmp_path / "y.xlsx")
    with pytest.raises(TraceError, match=r"holds 2 sheets \(Sheet, empty\); name one as `variable`"):
        read(tmp_path / "y.xlsx")
    assert read(tmp_path / "y.xlsx", Layout(variable="empty")).trace == Trace([0, 1], {"n": [1, 2]}, name="y")  # type: ignore[arg-type,dict-item]


def samples(folder: Path, suffix: str) -> Path:
    """A file of a format that is read alone."""
    path = folder / f"x{suffix}"
    if suffix in (".h5", ".hdf5"):
        import h5py

        with h5py.File(path, "w") as file:
            file["time"], file["n"] = TIME, SPEED
    elif suffix == ".npy":
        np.save(path, np.column_stack([TIME, SPEED]))
    elif suffix == ".npz":
        np.savez(path, time=TIME, n=SPEED)
    elif suffix == ".tdms":
        from nptdms import ChannelObject, TdmsWriter

        with TdmsWriter(path) as file:
            file.write_segment([ChannelObject("g", "time", TIME), ChannelObject("g", "n", SPEED)])
    elif suffix in (".dat", ".lvm", ".prn"):
        np.savetxt(path, np.column_stack([TIME, SPEED]), header="time n")
    else:
        pandas.DataFrame({"time": TIME, "n": SPEED}).to_excel(path, index=False)
    return path


@pytest.mark.needs("formats")
@pytest.mark.parametrize("suffix", sorted(set(READ) - {".mdf", ".mf4"}))
def test_any_damage_ends_in_a_trace_error_or_a_trace(tmp_path: Path, suffix: str) -> None:
    content, rng = samples(tmp_path, suffix).read_bytes(), np.random.default_rng(8)
    path = tmp_path / f"damaged{suffix}"
    for _ in range(40):
        damaged = bytearray(content[: int(rng.integers(1, len(content) + 1))])
        for place in rng.integers(0, len(damaged), 4):
            damaged[place] = rng.integers(0, 256)
        path.write_bytes(damaged)
        try:
            read(path, Layout(time=0))
        except TraceError as error:
            assert str(path) in str(error)
            assert "\n" not in str(error)


def measured(path: Path, version: str) -> Path:
    """An MDF file with three groups of channels, two of them at the same stamps."""
    from asammdf import MDF, Signal

    with MDF(version=version) as file:
        file.append([Signal(SPEED, TIME, name="n", unit="rpm"), Signal(np.arange(20, dtype="u1"), TIME, name="count")])
        file.append([Signal(SPEED[:5], TIME[:5] * 4, name="slow", unit="V")])
        file.append([Signal(-SPEED, TIME, name="phi", unit="deg")])
        saved: Path = file.save(path, overwrite=True)
    return Path(saved)


@pytest.mark.slow
@pytest.mark.needs("mf4")
@pytest.mark.parametrize(("suffix", "version"), [(".mf4", "4.10"), (".mdf", "3.30"), (".dat", "3.30")])
def test_measurements_in_mdf_files_are_read_at_their_first_stamps(tmp_path: Path, suffix: str, version: str) -> None:
    path = measured(tmp_path / ("x" + suffix.replace("dat", "mdf")), version).rename(tmp_path / f"y{suffix}")
    recording = read(path)
    signals = {"n": SPEED, "count": np.arange(20.0), "phi": -SPEED}
    assert recording.trace == Trace(TIME, signals, {"n": "rpm", "phi": "deg"}, "y")
    assert any(
        "'slow' holds 5 samples at the stamps of 'time_2' (`time: time_2` reads those)" in note
        for note in recording.notes
    )
    assert any("read as .mdf" in note for note in recording.notes) == (suffix == ".dat")
    assert read(path, Layout(time="time_2")).trace == Trace(TIME[:5] * 4, {"slow": SPEED[:5]}, {"slow": "V"}, "y")
    path.write_bytes(path.read_bytes()[:900])
    with pytest.raises(TraceError, match=r"is damaged: asammdf cannot read it|holds no measured channels"):
        read(path)


@pytest.mark.slow
@pytest.mark.needs("mf4")
def test_numbers_of_an_mdf_that_stand_for_texts_are_told(tmp_path: Path) -> None:
    from asammdf import MDF, Signal

    half = {"a": 2.0, "b": 0.0, "conversion_type": 1}
    texts = {"lower_0": 0, "upper_0": 4, "text_0": b"starting", "default_addr": half}
    with MDF(version="4.10") as file:
        file.append([Signal(np.arange(20, dtype="u1"), TIME, name="state", conversion=texts)])
        path = Path(file.save(tmp_path / "x.mf4"))
    recording = read(path)
    assert np.array_equal(recording.trace["state"], [*[np.nan] * 5, *range(10, 40, 2)], equal_nan=True)
    assert recording.notes == ("channel 'state': 5 samples stand for texts, and have no value",)


@pytest.mark.slow
@pytest.mark.needs("mf4")
def test_samples_that_an_mdf_marks_invalid_have_no_value_and_move_no_other(tmp_path: Path) -> None:
    from asammdf import MDF, Signal

    invalid = {"early": np.arange(20) < 5, "late": np.arange(20) >= 15, "sound": np.zeros(20, bool)}
    with MDF(version="4.10") as file:
        file.append([Signal(TIME.copy(), TIME, name=name, invalidation_bits=bits) for name, bits in invalid.items()])
        path = Path(file.save(tmp_path / "x.mf4"))
    recording = read(path)
    assert np.array_equal(recording.trace.time, TIME)
    for name, bits in invalid.items():
        assert np.array_equal(recording.trace[name], np.where(bits, np.nan, TIME), equal_nan=True)
    assert recording.notes == tuple(
        f"channel '{name}': 5 samples are marked invalid and have no value" for name in ("early", "late")
    )


def test_the_first_bytes_tell_the_format_where_the_suffix_does_not(tmp_path: Path) -> None:
    np.save(tmp_path / "x.npy", np.array([(0.0, 1.0), (1.0, 2.0)], dtype=[("time", "f8"), ("n", "f8")]))
    recording = read((tmp_path / "x.npy").rename(tmp_path / "x.bin"))
    assert recording.notes == ("is read as .npy, by its first bytes",)
    with pytest.raises(TraceError, match="holds no CAN frames; leave out the database"):
        read(tmp_path / "x.bin", Layout(database=tmp_path / "x.dbc"))


@pytest.mark.parametrize("suffix", READ)
def test_what_is_read_alone_is_not_written(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(TraceError, match=rf"format '{suffix}' is read, not written; use \.csv, \.mat"):
        write(Trace(TIME, {}), tmp_path / f"x{suffix}")


@pytest.mark.needs("formats")
def test_a_workbook_that_is_packed_too_tightly_is_not_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "x.xlsx", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("xl/sharedStrings.xml", bytes(2**26 + 1))
    with pytest.raises(TraceError, match=r"is 67108865 bytes when it is unpacked; export it as \.csv"):
        read(tmp_path / "x.xlsx")
