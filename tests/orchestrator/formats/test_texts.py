"""Tables of text as people have them are read as pandas reads them once it is told how; what is seen is told, and what
may be read two ways is asked for.
"""

from __future__ import annotations

import io
import json
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fmus.errors import TraceError
from orchestrator.formats import Layout, Recording, read
from orchestrator.formats.layout import spelled
from orchestrator.formats.schema import LayoutBlock
from orchestrator.trace import Trace

TIME = np.array([0.0, 0.5, 1.5, 2.0])
SPEED = np.array([1.5, 1234.25, -0.125, 7.0])


def written(folder: Path, text: str, encoding: str = "utf-8", name: str = "log.csv") -> Path:
    path = folder / name
    path.write_bytes(text.encode(encoding))
    return path


def table(separator: str = ",", decimal: str = ".", head: str = "time [s]{0}speed [rpm]") -> str:
    rows = (f"{t}{separator}{v}".replace(".", decimal) for t, v in zip(TIME, SPEED, strict=True))
    return "\n".join([head.format(separator), *rows]) + "\n"


def again(recording: Recording) -> Trace:
    """The trace that the layout gives which is printed for a recording."""
    assert recording.layout is not None
    block = LayoutBlock.model_validate(json.loads(json.dumps(spelled(recording.layout, Layout()))))
    back = read(recording.path, block.layout(recording.path.parent))
    assert not [note for note in back.notes if "time" in note]
    return back.trace


@pytest.mark.parametrize("separator", [",", ";", "\t", "|"])
@pytest.mark.parametrize("decimal", [".", ","])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "utf-16", "utf-16-le"])
def test_separator_decimal_mark_and_encoding_are_seen(
    tmp_path: Path, separator: str, decimal: str, encoding: str
) -> None:
    if separator == decimal:
        return
    path = written(tmp_path, table(separator, decimal, "Zeit [ms]{0}Winkel [°]"), encoding)
    recording = read(path)
    frame = pandas.read_csv(path, sep=separator, decimal=decimal, encoding=encoding)
    assert recording.trace.time.tolist() == (frame["Zeit [ms]"] / 1000).tolist()
    assert recording.trace["Winkel"].tolist() == frame["Winkel [°]"].tolist()
    assert recording.trace.units == {"Winkel": "°"}
    assert any("'Zeit'" in note for note in recording.notes)
    assert (decimal == ",") == any("decimal commas" in note for note in recording.notes)
    assert again(recording) == recording.trace


@pytest.mark.parametrize("encoding", ["gbk", "gb18030"])
def test_chinese_headings_are_seen(tmp_path: Path, encoding: str) -> None:
    recording = read(written(tmp_path, table(head="时间{0}转速 [rpm]"), encoding))
    assert recording.trace.names == ("转速",)
    assert "its text is gb18030" in recording.notes


def test_an_encoding_that_may_be_two_is_asked_for_and_taken(tmp_path: Path) -> None:
    path = written(tmp_path, table(head="time{0}скорость"), "cp1251")
    with pytest.raises(TraceError, match="say its `encoding`"):
        read(path)
    assert read(path, Layout(encoding="cp1251")).trace.names == ("скорость",)
    with pytest.raises(TraceError, match="'zip' is no encoding of text"):
        read(path, Layout(encoding="zip"))


PREAMBLE = "Recorder;X-7\nRate;1000\nOperator;Ms Smith; left early\n\n"


@pytest.mark.parametrize(
    "head",
    [
        "Zeit;Drehzahl\ns;1/min",
        "Zeit;Drehzahl\n[s];[1/min]",
        PREAMBLE + "Zeit;Drehzahl\ns;1/min",
        "Zeit;Drehzahl\n;1/min",
    ],
)
def test_lines_above_the_headings_and_a_row_of_units_are_seen(tmp_path: Path, head: str) -> None:
    recording = read(written(tmp_path, table(";", ",", head)))
    assert recording.trace["Drehzahl"].tolist() == SPEED.tolist()
    assert recording.trace.units == {"Drehzahl": "1/min"}
    assert any("their units" in note for note in recording.notes)
    assert head.startswith("Zeit") or "lines above the samples that are skipped: 1, 2, 3" in recording.notes
    assert again(recording) == recording.trace


@pytest.mark.parametrize(
    "heading", ["speed [rpm]", "speed (rpm)", "speed / rpm", "speed in rpm", "speed[rpm]", '"speed, rpm"']
)
def test_units_in_headings_are_units(tmp_path: Path, heading: str) -> None:
    recording = read(written(tmp_path, table(head=f"t (ms){{0}}{heading}")))
    assert recording.trace.units == {"speed": "rpm"}
    assert recording.trace.time.tolist() == (TIME / 1000).tolist()


@pytest.mark.parametrize("heading", ["speed (filtered)", "speed[3]", "in / out", "flag [ "])
def test_what_is_no_unit_stays_in_the_name(tmp_path: Path, heading: str) -> None:
    assert read(written(tmp_path, table(head=f"time{{0}}{heading}"))).trace.names == (heading.strip(),)


def test_a_time_zone_says_when_the_clock_was_read(tmp_path: Path) -> None:
    path = written(tmp_path, "time,a\n2026-10-25 01:59:59,1\n2026-10-25 03:00:00,2\n")
    recording = read(path, Layout(time_zone="Europe/Berlin"))
    assert recording.trace.time.tolist() == [0.0, 7201.0]
    assert recording.start == pandas.Timestamp("2026-10-25 01:59:59", tz="Europe/Berlin").timestamp()
    with pytest.raises(TraceError, match="none of `time_zone: Mars/Olympus`"):
        read(path, Layout(time_zone="Mars/Olympus"))
    written(tmp_path, "time,a\n2026-03-29 02:30:00,1\n2026-03-29 02:30:01,2\n")
    with pytest.raises(TraceError, match="none of `time_zone: Europe/Berlin`"):
        read(path, Layout(time_zone="Europe/Berlin"))


def test_times_that_come_twice_as_clocks_are_put_back_are_told_apart_by_their_order(tmp_path: Path) -> None:
    hours = [f"2026-10-25 02:{minute:02}:00" for minute in (0, 20, 40)]
    berlin = Layout(time_zone="Europe/Berlin")
    twice = written(tmp_path, "time,a\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(hours + hours)))
    recording = read(twice, berlin)
    assert recording.trace.time.tolist() == [0.0, 1200.0, 2400.0, 3600.0, 4800.0, 6000.0]
    assert recording.start == pandas.Timestamp("2026-10-25 00:00", tz="UTC").timestamp()
    assert "clocks are put back at sample 3" in recording.notes
    once = written(tmp_path, "time,a\n" + "".join(f"{stamp},{k}\n" for k, stamp in enumerate(hours)))
    with pytest.raises(TraceError, match="come twice in Europe/Berlin, as clocks are put back; write them with their"):
        read(once, berlin)


def test_times_of_day_go_on_after_midnight(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "Uhrzeit;a\n23:59:59,5;1\n00:00:00,5;2\n00:00:01,25;3\n"))
    assert recording.trace.time.tolist() == [0.0, 1.0, 1.75]
    assert any("midnight" in note for note in recording.notes)


ASKED = [
    ("time;a\n0;1,234\n1;2,345\n", {}, "'1,234' may be 1234 or 1.234; say `decimal", {"decimal": ","}, [1.234, 2.345]),
    ("time;a\n0;1,234\n1;2,345\n", {}, "'1,234' may be 1234 or 1.234; say `decimal", {"decimal": "."}, [1234, 2345]),
    ("time;a\n0;1.234\n1;2.345\n", {}, "'1.234' may be 1234 or 1.234; say `decimal", {"decimal": "."}, [1.234, 2.345]),
    ('time,a\n0,"1,234"\n1,"2,345"\n', {}, "'1,234' may be 1234", {"decimal": "."}, [1234, 2345]),
    ("time;a\n0;1,5\n1;2.5\n", {}, "decimal points and decimal commas", {"columns": {"a": "a"}, "decimal": ","}, None),
    ("time,a\n03/04/2026 1:00,1\n03/04/2026 1:01,2\n", {}, "03/04/2026, may be read two", {"dates": "dmy"}, [1, 2]),
    ("time,a\n03/04/26 1:00,1\n03/14/26 1:01,2\n", {}, "two ways; say `dates`", {"dates": "mdy"}, [1, 2]),
    ("a,b\n0,1\n1,2\n2,3\n", {}, "no column 'time'; it holds 'a', 'b'; say which", {"time": "b"}, None),
    ("time,a\n46354.1,1\n46354.10000001,2\n", {}, "look like days since 1900", {"units": {"time": "d"}}, [1, 2]),
    ("time,a\n46354.1,1\n46354.1000115741,2\n", {}, "look like days since 1900", {"units": {"time": "d"}}, [1, 2]),
    ("time,a\n1764321300123,1\n1764321300124,2\n", {}, "look like millis", {"units": {"time": "ms"}}, [1, 2]),
    ("time,a\n1764321300123000,1\n1764321300124000,2\n", {}, "look like micro", {"units": {"time": "us"}}, [1, 2]),
    ("time,a\n1764321300123000000,1\n1764321300124000000,2\n", {}, "like nano", {"units": {"time": "ns"}}, [1, 2]),
    ("time,a\n739949.5,1\n739949.50000001,2\n", {}, "as MATLAB counts them", {"units": {"time": "d"}}, [1, 2]),
]  # fmt: skip


@pytest.mark.parametrize(("text", "said", "problem", "fix", "values"), ASKED)
def test_what_may_be_read_two_ways_is_asked_for(
    tmp_path: Path, text: str, said: dict[str, object], problem: str, fix: dict[str, object], values: list[float] | None
) -> None:
    path = written(tmp_path, text)
    with pytest.raises(TraceError, match=problem):
        read(path)
    if values is not None:
        assert read(path, replace(Layout(), **fix)).trace["a"].tolist() == values  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("text", "start"),
    [
        ("Date;Time;speed\n31.12.2023;23:59:59,5;1,5\n01.01.2024;00:00:00,25;2,5\n", "2023-12-31T23:59:59.5"),
        ("Time,Date,speed\n23:59:59.500,2023-12-31,1.5\n00:00:00.250,2024-01-01,2.5\n", "2023-12-31T23:59:59.5"),
        ("12/31/2023\t11:59:59.5 PM\t1.5\n01/01/2024\t12:00:00.25 AM\t2.5\n", "2023-12-31T23:59:59.5"),
        ("2023-12-31 23:59:59.5 1.5\n2024-01-01 00:00:00.25 2.5\n", "2023-12-31T23:59:59.5"),
        ("Date,Time,speed\n31-Dec-2023,23:59:59.5,1.5\n01-Jan-2024,00:00:00.25,2.5\n", "2023-12-31T23:59:59.5"),
    ],
)
def test_dates_in_a_column_of_their_own_are_those_of_the_times(tmp_path: Path, text: str, start: str) -> None:
    recording = read(written(tmp_path, text))
    assert recording.trace.time.tolist() == [0.0, 0.75]
    assert next(iter(recording.trace.signals.values())).tolist() == [1.5, 2.5]
    assert recording.start == pandas.Timestamp(start).timestamp()
    assert any(note.startswith("its dates are those of column ") for note in recording.notes)
    assert recording.layout is not None and read(recording.path, recording.layout).trace.time.tolist() == [0.0, 0.75]


def test_dates_that_belong_to_no_times_are_left_out_and_told(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "time,day,speed\n0,2024-01-01,1.5\n1,2024-01-01,2.5\n"))
    assert list(recording.trace.signals) == ["speed"]
    assert "column 'day' holds dates and is left out" in recording.notes
    two = read(
        written(tmp_path, "Time,made,seen,v\n10:00:00,2024-01-01,2024-01-02,1\n10:00:01,2024-01-01,2024-01-02,2\n")
    )
    assert two.start is None and two.trace.time.tolist() == [0.0, 1.0]
    assert [note for note in two.notes if "holds dates and is left out" in note]


def test_marks_of_thousands_are_taken_out(tmp_path: Path) -> None:
    path = written(tmp_path, "time;a;b\n0;1.234,5;1\n1;-12,25;2\n2;1.000.000;3\n")
    trace = read(path).trace
    assert trace["a"].tolist() == pandas.read_csv(path, sep=";", decimal=",", thousands=".")["a"].tolist()


@pytest.mark.parametrize("blank", [" ", "\u00a0", "\u2009", "\u202f"])
def test_blanks_between_thousands_and_typeset_minuses_are_parts_of_numbers(tmp_path: Path, blank: str) -> None:
    rows = f"0;1{blank}234,5;\u22121,5\n1;-12,25;2\n2;1{blank}000{blank}000;\u22120,5\n"
    trace = read(written(tmp_path, "time;a;b\n" + rows)).trace
    assert trace["a"].tolist() == [1234.5, -12.25, 1e6]
    assert trace["b"].tolist() == [-1.5, 2.0, -0.5]


def test_a_mark_that_closes_each_row_shifts_no_column(tmp_path: Path) -> None:
    for head in ("time,a", "time,a,"):
        trace = read(written(tmp_path, head + "\n0,1,\n1,2,\n2,4,\n")).trace
        assert trace.time.tolist() == [0.0, 1.0, 2.0]
        assert {name: trace[name].tolist() for name in trace.names} == {"a": [1.0, 2.0, 4.0]}


def test_headings_of_more_columns_than_there_are_name_the_first(tmp_path: Path) -> None:
    lines = ("LabVIEW Measurement\t", "Separator\tTab", "***End_of_Header***\t", "", "Channels\t2\t\t\t")
    head = "X_Value\tVoltage_0\tVoltage_1\tComment"
    text = "\r\n".join([*lines, "***End_of_Header***\t\t\t\t", head, *(f"{k}\t{k + 1.5}\t{-k}" for k in range(9))])
    trace = read(written(tmp_path, text, name="log.lvm")).trace
    assert trace.names == ("Voltage_0", "Voltage_1")
    assert trace["Voltage_0"][:2].tolist() == [1.5, 2.5] and trace.time[1] == 1.0


def test_a_line_for_excel_names_the_separator(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "sep=;\ntime;a\n0;1,5\n1;2,5\n"))
    assert recording.trace["a"].tolist() == [1.5, 2.5]
    assert again(recording) == recording.trace


def test_rows_of_numbers_are_no_units_and_units_may_stand_above_names(tmp_path: Path) -> None:
    scope = "Vertical Units,V,A\nVertical Scale,1,1\nPosition,0,0\nTIME,CH1,CH2\n-1,2,3\n0,3,4\n1,5,6\n"
    assert read(written(tmp_path, scope)).trace.units == {"CH1": "V", "CH2": "A"}
    assert read(written(tmp_path, "ms,V\ntime,a\n500,1\n1500,2\n")).trace.time.tolist() == [0.5, 1.5]
    limits = read(written(tmp_path, "time,a\nmin,0\nmax,5\n0,1\n1,2\n2,4\n"))
    assert limits.trace.time.tolist() == [0.0, 1.0, 2.0] and limits.trace.units == {}


def test_a_mark_that_the_headings_are_separated_by_as_well_is_the_separator(tmp_path: Path) -> None:
    rows = "".join(f"Sat Nov 28 09:15:0{k} 2026,{k}\n" for k in range(5))
    with pytest.raises(TraceError, match="column 'time': holds text, no times"):
        read(written(tmp_path, "time,a\n" + rows))


def test_minutes_and_seconds_are_times_that_go_on_after_the_hour(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "Time,a\n59:59.0,1\n59:59.5,2\n00:00.0,4\n00:00.5,3\n"))
    assert recording.trace.time.tolist() == [0.0, 0.5, 1.0, 1.5]
    assert "its times pass the hour 1 times" in recording.notes


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_durations_that_pandas_has_as_index_are_times(tmp_path: Path, suffix: str) -> None:
    index = pandas.to_timedelta([0.0, 0.25, 86400.5], unit="s")
    getattr(pandas.DataFrame({"a": [1.0, 2.0, 3.0]}, index=index), f"to_{suffix}")(tmp_path / f"x.{suffix}")
    trace = read(tmp_path / f"x.{suffix}").trace
    assert trace.time.tolist() == [0.0, 0.25, 86400.5]
    assert trace["a"].tolist() == [1.0, 2.0, 3.0]


def test_what_excel_could_not_compute_is_missing(tmp_path: Path) -> None:
    trace = read(written(tmp_path, "time;a\n0;#DIV/0!\n1;1,5\n2;#WERT!\n")).trace
    assert np.array_equal(trace["a"], [np.nan, 1.5, np.nan], equal_nan=True)


def test_a_time_that_is_named_and_cannot_be_read_is_not_replaced_by_a_column_that_rises(tmp_path: Path) -> None:
    rows = "".join(f"tick {k},{k}\n" for k in range(12))
    with pytest.raises(TraceError, match="column 'Time': holds text, no times"):
        read(written(tmp_path, "Time,angle\n" + rows))


def test_a_bad_row_is_named_by_its_line_in_the_file(tmp_path: Path) -> None:
    text = "# of a bench\n\ntime,a\n0,1\n1,2\n\n2,3\n\nend of file,\n"
    with pytest.raises(TraceError, match="line 9, column 'time': 'end of file' is no number"):
        read(written(tmp_path, text))
    with pytest.raises(TraceError, match="line 5: Expected 2 columns, got 3"):
        read(written(tmp_path, "time,a\n0,1\n1,2\n\n2,3,4\n"))
    with pytest.raises(TraceError, match="line 5: Expected 2 columns, got 1"):
        read(written(tmp_path, "time,a\n0,1\n1,2\n2,3\n\t"))


def test_zero_bytes_at_the_end_are_told_as_such(tmp_path: Path) -> None:
    for rows in (3, 20_000):
        text = "time,a\n" + "".join(f"{k},1\n" for k in range(rows))
        with pytest.raises(TraceError, match=f"zero bytes from byte {len(text)} on"):
            read(written(tmp_path, text + "\0" * 4096))


def test_flags_are_numbers_and_words_are_left_out_and_told(tmp_path: Path) -> None:
    recording = read(written(tmp_path, "time,on,state,a\n0,True,RUN,1\n1,false,STOP,n.a.\n"))
    assert recording.trace.names == ("on", "a")
    assert recording.trace["on"].tolist() == [1.0, 0.0]
    assert np.array_equal(recording.trace["a"], [1, np.nan], equal_nan=True)
    assert recording.notes == ("column 'state' holds text and is left out",)
    with pytest.raises(TraceError, match="column 'state': holds text, not numbers"):
        read(recording.path, Layout(columns={"state": "state"}))


def test_columns_of_one_name_or_none_get_names_of_their_own_and_are_told(tmp_path: Path) -> None:
    recording = read(written(tmp_path, ",time,a,a,\n0,0,1,2,\n1,1,3,4,\n"))
    assert recording.trace.names == ("column_0", "a", "a_2")
    assert recording.trace["a_2"].tolist() == [2.0, 4.0]
    assert len(recording.notes) == 2
    assert again(recording) == recording.trace


def test_a_bad_row_is_refused_and_not_taken_for_a_heading(tmp_path: Path) -> None:
    for text in ("time,a\n0,abc\n1,2\n2,3\n", "time,a\n0,1\n1,abc\n2,3\n", "time,a,b\n0,1,2\n1,2,3\ntime,a,b\n0,1,2\n"):
        with pytest.raises(TraceError, match="correct or cut that row"):
            read(written(tmp_path, text))


def test_columns_of_times_and_words_are_no_signals_and_words_no_time(tmp_path: Path) -> None:
    path = written(tmp_path, "time;clock;state;a\n0;09:15:00;RUN;1,5\n1;09:15:01;RUN; \t1.000,5\n", name="log.txt")
    recording = read(path, Layout(decimal=",", columns=None))
    assert recording.trace.names == ("a",) and recording.trace["a"].tolist() == [1.5, 1000.5]
    assert recording.notes == (
        "column 'clock' holds times and is left out",
        "column 'state' holds text and is left out",
    )
    with pytest.raises(TraceError, match=r"column 'state': holds text, no times; write .* or choose another `time`"):
        read(path, Layout(time="state", decimal=","))


def test_an_export_with_a_column_of_labels_is_seen(tmp_path: Path) -> None:
    text = "version;2\n\nname;t;speed\nunit;ms;rpm\ntrace_values;0,5;1,5\n;1,5;2,5\n;2,5;3,5\n"
    recording = read(written(tmp_path, text))
    assert recording.trace.names == ("speed",) and recording.trace.units == {"speed": "rpm"}
    assert recording.trace.time.tolist() == [0.0005, 0.0015, 0.0025]


@pytest.mark.slow
@given(
    st.lists(st.tuples(st.floats(0, 1e6), st.floats(-1e6, 1e6)), min_size=3, max_size=20, unique_by=lambda row: row[0])
)
def test_what_pandas_writes_for_german_eyes_comes_back(rows: list[tuple[float, float]]) -> None:
    frame = pandas.DataFrame(sorted(rows), columns=["Zeit [s]", "n [1/min]"])
    text = io.StringIO()
    frame.to_csv(text, sep=";", decimal=",", index=False)
    with tempfile.TemporaryDirectory() as folder:
        recording = read(written(Path(folder), text.getvalue()), Layout(decimal=","))
    assert recording.trace.time.tolist() == frame["Zeit [s]"].tolist()
    assert recording.trace["n"].tolist() == frame["n [1/min]"].tolist()


def test_a_recording_without_stamps_is_sampled_as_its_user_says_and_never_else(tmp_path: Path) -> None:
    path = written(tmp_path, "speed [rpm],angle [deg]\n3,5\n1,4\n2,6\n")
    with pytest.raises(TraceError, match=r"or `time: \{step: 0.001\}` where it has none"):
        read(path)
    block = LayoutBlock.model_validate({"time": {"step": "1/500"}})
    recording = read(path, block.layout(tmp_path))
    assert recording.trace.time.tolist() == [0, 0.002, 0.004] and recording.trace["angle"].tolist() == [5, 4, 6]
    assert recording.layout is not None
    again = LayoutBlock.model_validate(spelled(recording.layout, Layout()))
    assert read(path, again.layout(tmp_path)).trace == recording.trace
    np.savez(tmp_path / "a.npz", speed=np.ones(4), angle=np.zeros(4))
    assert read(tmp_path / "a.npz", Layout(step=0.5)).trace.time.tolist() == [0, 0.5, 1, 1.5]
    with pytest.raises(ValueError, match="greater than 0"):
        LayoutBlock.model_validate({"time": {"step": 0}})
